"""Drives of a set, mapped into memory: nothing is read before it is asked for."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.scenarios.sets import INDEX, SPLITS, TRUTH
from cellslam.sim.data_files import text_of
from cellslam.sim.errors import InputError, one_line, unknown_name
from cellslam.sim.recording.packing import SNAPSHOT, Packed, mapped

KEPT = 4096  # drives that stay mapped
MEASURED = ("distance_m", "azimuth_rad", "elevation_rad", "snr_db", "distance_std_m", "azimuth_std_rad",
            "elevation_std_rad")  # fmt: skip


@dataclass(frozen=True)
class Row:
    """A row of a set's index: a file, its split and trial there, how much is in it, its digest and its bound.

    `most_paths`: of a snapshot. `bound_rmse_m`: the Cramér-Rao bound of position, m; empty where it was not computed.
    """

    file: str
    split: str
    trial: int
    snapshots: int
    measurements: int
    most_paths: int
    sha256: str
    bound_rmse_m: str


COLUMNS = tuple(Row.__dataclass_fields__)


class Drive:
    """A drive of a set, mapped when it is first asked for a column. Its digest is checked then, once.

    Raises InputError where the file is missing or not as it was made.
    """

    def __init__(self, path: Path, row: Row) -> None:
        self.path, self.row = path, row

    def __getitem__(self, column: str) -> Packed:
        """Return a column by its path in the file, as 'measurements/distance_m'."""
        return self._columns[column]

    def __contains__(self, column: str) -> bool:
        return column in self._columns

    @cached_property
    def _columns(self) -> dict[str, Packed]:
        try:
            return mapped(self.path)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from error
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            raise InputError(f"{self.path}: cannot be read ({error}); make the set again") from error

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """First measurement row of each snapshot, (T + 1,)."""
        return np.searchsorted(self[SNAPSHOT].codes, np.arange(self.row.snapshots + 1))

    @cached_property
    def dt_s(self) -> NDArray[np.float32]:
        """Time (T,) since the snapshot before, s; 0 at the first."""
        time_s = self["time_s"].codes
        return np.diff(time_s, prepend=time_s[:1]).astype(np.float32)

    @cached_property
    def clock_offsets_m(self) -> NDArray[np.float32]:
        """True clock offsets (T, S) at each snapshot, m."""
        time_s = self["time_s"].codes
        out = np.tile(self["truth/clock_offsets_m"].codes, (len(time_s), 1))
        if "truth/clock_drift_m_s" in self:
            out += np.multiply.outer(time_s - time_s[0], self["truth/clock_drift_m_s"].codes)
        if "truth/clock_wander_m" in self:
            out += self["truth/clock_wander_m"][:]
        return out.astype(np.float32)


def index_of(folder: str | Path) -> list[Row]:
    """Return the rows of a set's index. Raises InputError where there is none, or it is damaged."""
    path = Path(folder) / INDEX
    try:
        rows = list(csv.DictReader(text_of(path).splitlines()))
        return [_row(row) for row in rows]
    except FileNotFoundError as error:
        raise InputError(
            f"{folder}: not a whole set of drives; 'cellslam dataset make NAME --out DIR' makes one"
        ) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: damaged ({error}); 'cellslam dataset make' makes it again") from error


def drives_of(folder: str | Path, split: str = "train") -> list[Drive]:
    """Return the drives of a split of the set in `folder`. Raises InputError."""
    if split not in (*SPLITS, TRUTH):
        raise unknown_name("split", split, (*SPLITS, TRUTH))
    return [_drive(Path(folder).absolute() / row.file, row) for row in index_of(folder) if row.split == split]


@lru_cache(maxsize=KEPT)
def _drive(path: Path, row: Row) -> Drive:
    """Return a drive, the same each time: a set is read again and again, and checked once in a process."""
    return Drive(path, row)


def _row(values: dict[str, Any]) -> Row:
    place = Path(values["file"])
    if place.is_absolute() or ".." in place.parts:
        raise ValueError(f"it names the file {one_line(place)}, outside of the folder of the set")
    counts = {name: int(values[name]) for name in ("trial", "snapshots", "measurements", "most_paths")}
    return Row(**{name: values[name] for name in COLUMNS} | counts)
