"""What is kept of a trial beside its row: trajectory, error curves and map, as one compressed file."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from cellslam.benchmarks.scores.map_scores import vt_nees
from cellslam.benchmarks.scores.metrics import NO_ERRORS, Errors, Scored
from cellslam.sim.data_files import arrays_of
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.benchmarks.bound.cramer_rao import BoundResult
    from cellslam.benchmarks.scores.trial_result import TrialResult
    from cellslam.sim.recording import Floats, Recording

Singles = NDArray[np.float32]


@dataclass(frozen=True)
class Trajectory:
    """Columns in single precision, with their sizes; a column that does not apply is empty.

    T: snapshots, S: sites, V: final VTs, K: those that stand for a true one with a bound. `time_s` begins with 0;
    `error_m`, `nees`, `std_m` (claimed), `bound_std_m`: horizontal. `vt_first`: snapshot of the first measurement that
    was associated with the VT, -1 where that is not known; `vt_nees`: its normalised error squared (3 is right), NaN
    where it stands for no true VT. `horizontal_m`: estimate less truth; `covariance_m2`: xx, xy and yy of its claim.
    `map_times_seen`: in how many snapshots the true VT was seen.
    """

    time_s: Annotated[Singles, "T"]
    poses: Annotated[Singles, "T6"]
    error_m: Annotated[Singles, "T"]
    nees: Annotated[Singles, "T"]
    std_m: Annotated[Singles, "T"]
    bound_std_m: Annotated[Singles, "T"]
    offset_error_m: Annotated[Singles, "TS"]
    offset_std_m: Annotated[Singles, "TS"]
    vt_m: Annotated[Singles, "V3"]
    vt_first: Annotated[NDArray[np.int32], "V"]
    vt_nees: Annotated[Singles, "V"]
    horizontal_m: Annotated[Singles, "T2"]
    covariance_m2: Annotated[Singles, "T3"]
    heading_error_rad: Annotated[Singles, "T"]
    heading_std_rad: Annotated[Singles, "T"]
    map_error_m: Annotated[Singles, "K"]
    map_bound_m: Annotated[Singles, "K"]
    map_times_seen: Annotated[NDArray[np.int32], "K"]

    @property
    def errors(self) -> Errors:
        """The errors and what was claimed of them; none where an older version kept no covariances."""
        if not len(self.covariance_m2):
            return NO_ERRORS
        covariance = self.covariance_m2[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        columns = (self.horizontal_m, covariance, self.poses[:, 3], self.heading_error_rad, self.heading_std_rad**2)
        return Errors(*(np.asarray(column, np.float64) for column in columns))


SHAPES = {name: hint.__metadata__[0] for name, hint in get_type_hints(Trajectory, include_extras=True).items()}


def trajectory(recording: Recording, result: TrialResult, limit: BoundResult | None) -> Trajectory:
    """Return what is kept of one result."""
    truth, empty = recording.truth, np.empty(0)
    offset, variance = result.clock_offset_m, result.clock_offset_variance_m2
    scored = Scored(recording, result, limit)
    elapsed_s, vts = recording.elapsed_s, result.vts
    errors = NO_ERRORS if truth is None else scored.errors

    def single(column: Any) -> Singles:
        return np.asarray(column, np.float32)

    return Trajectory(
        time_s=single(elapsed_s),
        poses=single(result.poses),
        error_m=single(errors.position),
        nees=single(errors.squared),
        std_m=single(result.position_std_m),
        bound_std_m=single(empty if limit is None else limit.horizontal_std_m),
        offset_error_m=single(empty if truth is None or offset is None else offset - truth.clock_offsets_at(elapsed_s)),
        offset_std_m=single(empty if variance is None else np.sqrt(np.maximum(variance, 0.0))),
        vt_m=single(np.empty((0, 3)) if vts is None else vts.position_m),
        vt_first=_first_associated(recording, result),
        vt_nees=single(_vt_nees(recording, result)),
        horizontal_m=single(errors.horizontal),
        covariance_m2=single(errors.covariance.reshape(-1, 4)[:, [0, 1, 3]]),
        heading_error_rad=single(errors.heading),
        heading_std_rad=single(np.sqrt(np.maximum(errors.heading_variance, 0.0))),
        map_error_m=single(scored.mapped[0]),
        map_bound_m=single(scored.mapped[1]),
        map_times_seen=scored.mapped[2].astype(np.int32),
    )


def pack(kept: Trajectory) -> bytes:
    """Return the compressed file of a trajectory, in NumPy's npz format."""
    file = io.BytesIO()
    np.savez_compressed(file, **{name: getattr(kept, name) for name in SHAPES})
    return file.getvalue()


def unpack(path: Path) -> Trajectory:
    """Return the trajectory of a file. Raises InputError when it cannot be read."""
    try:
        held = dict.fromkeys(SHAPES, np.empty(0, np.float32)) | arrays_of(path)  # older files lack some columns
        _check_shapes(held)
        return Trajectory(**{name: held[name] for name in SHAPES})
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a trajectory file ({' '.join(str(error).split())})") from error


def _check_shapes(held: Mapping[str, NDArray[Any]]) -> None:
    """Raise ValueError unless columns are numbers, and each empty or of the size of the others."""
    sizes = {"2": 2, "3": 3, "6": 6}
    for name, letters in SHAPES.items():
        column = held[name]
        fits = not column.size or (
            len(letters) == column.ndim
            and all(sizes.setdefault(x, n) == n for x, n in zip(letters, column.shape, strict=True))
        )
        if column.dtype.kind not in "fiu" or not fits or (name == "time_s" and not column.size):
            raise ValueError(f"its column '{name}' has the shape {column.shape}, of {column.dtype}")


def _vt_nees(recording: Recording, result: TrialResult) -> Floats:
    if result.vts is None or result.association is None or recording.truth is None:
        return np.full(0 if result.vts is None else len(result.vts.id), np.nan)
    return vt_nees(recording, result.vts, result.association)


def _first_associated(recording: Recording, result: TrialResult) -> NDArray[np.int32]:
    ids = [] if result.vts is None else result.vts.id.tolist()
    known, row = np.unique([] if result.association is None else result.association, return_index=True)
    first = dict(zip(known.tolist(), recording.measurements.snapshot[row].tolist(), strict=True))
    return np.array([first.get(one, -1) for one in ids], np.int32)
