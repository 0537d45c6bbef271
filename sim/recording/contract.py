"""The one data contract: a recording, checked as it is made, kept as one HDF5 file.

The first breach is named by table, column and row, with what to do. What each column alone must fulfil stands in
`columns.COLUMNS`; here is what columns must fulfil together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import POSE_COLUMNS, Described, dataframe
from cellslam.sim.errors import InputError
from cellslam.sim.plausible import RANGES, Range
from cellslam.sim.recording.columns import COLUMNS, COMPONENTS, Column, check_shapes
from cellslam.sim.recording.tables import Floats, Ints, Links, Measurements, OdometryModel, Reference, Sites, Truth

if TYPE_CHECKING:
    import pandas as pd

# What each value of a column must fulfil, and what is wrong with one that does not.
RULES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "finite": (np.isfinite, "is not finite: leave the row out, or write the number"),
    "measured": (lambda x: ~np.isinf(x), "is infinite: write NaN where it was not measured"),
    "deviation": (lambda x: (x >= 0) & np.isfinite(x), "is not a standard deviation (must be >= 0, and finite)"),
    "prior": (lambda x: x >= 0, "is not a standard deviation (must be >= 0)"),
    "claim": (lambda x: ~(x <= 0), "is not a standard deviation (must be > 0)"),
    "uncertainty": (lambda x: ~(x < 0), "is negative"),
    "size": (lambda x: x > 0, "is not a size (must be > 0)"),
}
_COUNTED = {"S": "sites", "T": "snapshots", "L": "links", "V": "VTs", "N": "vehicles"}
PLACEHOLDERS = (-9999.0, -99999.0)  # what other programs write for a value that is missing
TIMES = ("time_s", "truth/vehicles/time_s", "reference/time_s")  # of rows that are in order
_COMPARED = ("distance_m", "azimuth_rad", "elevation_rad", "snr_db")


@dataclass(frozen=True, repr=False)
class Recording(Described):
    """A drive as it was measured. `start_pose` (6,) and `start_std` (6,) are the estimator's prior at time_s[0].

    `time_s` (T,), at any intervals; `odometry` (T, 6): mean body velocities from time_s[t-1] to time_s[t], row 0
    zero. NaN: this component was not measured in this interval; where a component never was, its row of
    `odometry_model` describes the motion itself, about zero (noise density 0: the vehicle does not move that way).
    `reference` is what a measured drive is scored by, `truth` what a simulated one is; either may be missing.
    `plane`: array, sources and reflections lie in one horizontal plane, so that all elevations are zero unmeasured.
    `range_scale_std`: deviation of the scale k of range, distance_m = (1 + k) true distance + clock offset; 0: none.
    `scatterers`: whether points may scatter paths, beside walls that mirror them.

    Raises InputError, naming table, column and row, where a column breaks the contract.
    """

    time_s: Floats
    odometry: Floats
    odometry_model: OdometryModel
    links: Links
    sites: Sites
    measurements: Measurements
    start_pose: Floats
    start_std: Floats
    provenance: Mapping[str, Any] = field(default_factory=dict)
    truth: Truth | None = None
    reference: Reference | None = None
    plane: bool = False
    range_scale_std: float = 0.0
    scatterers: bool = False

    def __post_init__(self) -> None:
        values = values_of(self)
        sizes = check_shapes(values)
        if sizes["T"] == 0:
            raise InputError("time_s is empty: a recording needs at least one snapshot")
        if sizes.get("R") == 0:
            raise InputError("reference.time_s is empty: leave the table 'reference' out where there is none")
        for column in COLUMNS:
            if column.path in values:
                _check_values(column, values[column.path], sizes)
        for path in TIMES:
            steps = np.diff(values.get(path, np.empty(0)))
            _require(
                np.asarray(steps > 0),
                path.replace("/", "."),
                "is not after the row before it: sort the rows by time",
                offset=1,
            )
            _check_range(RANGES["interval"], steps, f"{path.replace('/', '.')}, step to row", offset=1)
        _check_measurements(self.measurements, len(self.links))
        surveyed = np.isfinite(self.sites.surveyed_m)
        whole = np.asarray(surveyed.all(axis=1) | ~surveyed.any(axis=1))
        _require(whole, "sites.position_m", "is known in part: write x, y and z, or NaN for all three")
        if self.plane and not np.isnan(self.measurements.elevation_rad).all():
            raise InputError("plane is set, but measurements.elevation_rad has values: leave one of both out")

    @property
    def elapsed_s(self) -> Floats:
        """Time (T,) since the first snapshot."""
        return np.asarray(self.time_s - self.time_s[0])

    @property
    def rows(self) -> Ints:
        """First measurement row of each snapshot, (T + 1,): snapshot t has rows[t]:rows[t + 1]."""
        return np.searchsorted(self.measurements.snapshot, np.arange(len(self.time_s) + 1)).astype(np.int64)

    def to_dataframe(self) -> pd.DataFrame:
        """Return a pandas table, a row a snapshot: time_s, of a simulated drive the true pose (x_m, y_m, z_m,
        yaw_rad, pitch_rad, roll_rad), and the odometry (u_x and so on, in m/s and rad/s).
        """
        odometry = dict(zip(COMPONENTS, self.odometry.T, strict=True))
        pose = {} if self.truth is None else dict(zip(POSE_COLUMNS, self.truth.poses.T, strict=True))
        return dataframe({"time_s": self.time_s, **pose, **odometry})

    def save(self, path: str | Path, pack: bool = False) -> None:
        """Write the recording to one HDF5 file, atomically. `pack`: in a fifth of the bytes, rounded, by far less than
        it was measured, and without the true deviations.

        Raises InputError when that is impossible.
        """
        from cellslam.sim.recording.hdf5 import save

        save(values_of(self), Path(path), pack)

    @staticmethod
    def load(path: str | Path, accept_changed: bool = False) -> Recording:
        """Read and check a recording. `accept_changed`: also one that was changed on purpose since it was written.

        Raises InputError naming file, table and row of what is wrong.
        """
        from cellslam.sim.recording.hdf5 import load

        return load(Path(path), Recording, accept_changed)

    def __repr__(self) -> str:
        parts = [f"{len(self.time_s)} snapshots", f"{self.elapsed_s[-1]:.1f} s", f"sites={', '.join(self.sites.name)}"]
        parts += [f"{len(self.links)} links", f"{len(self.measurements)} measurements"]
        parts += [] if self.truth is None else [f"truth with {len(self.truth.vts)} VTs"]
        parts += [] if self.reference is None else ["reference"]
        return f"Recording({', '.join(parts)})"


def values_of(recording: Recording) -> dict[str, Any]:
    """Return the value of every column that a recording has, by path."""
    out: dict[str, Any] = {}
    for column in COLUMNS:
        value: Any = recording
        for name in column.path.split("/"):
            value = None if value is None else getattr(value, name)
        if value is not None:
            out[column.path] = value
    return out


def _check_values(column: Column, values: NDArray[Any], sizes: Mapping[str, int]) -> None:
    """Raise InputError, naming the row, where a value breaks its column's rule."""
    values = np.atleast_1d(values)
    if column.rule:
        fulfilled, problem = RULES[column.rule]
        _require(fulfilled(values), column.name, problem)
    if column.rule == "measured":
        for text in PLACEHOLDERS:
            _require(values != text, column.name, f"is {text:g}, which stands for a missing value: write NaN")
    for span, part in column.parts(values):
        _check_range(span, part, f"{column.name}, row")
    if column.index:
        for number, symbol in zip(values.reshape(-1, len(column.index)).T, column.index, strict=True):
            inside = (number >= (-1 if column.none else 0)) & (number < sizes[symbol])
            _require(inside, column.name, f"is not one of the {sizes[symbol]} {_COUNTED[symbol]}")


def _check_measurements(m: Measurements, links: int) -> None:
    key = m.snapshot * max(links, 1) + m.link
    _require(np.diff(key) >= 0, "measurements", "is not sorted by (snapshot, link)", offset=1)
    for name, limit, words in (("azimuth_rad", np.pi, "[-pi, pi]"), ("elevation_rad", np.pi / 2, "[-pi/2, pi/2]")):
        inside = ~(np.abs(getattr(m, name)) > limit + 1e-9)
        _require(inside, f"measurements.{name}", f"is outside {words}: radians are expected; are these degrees?")
    nothing = np.isnan(m.distance_m) & np.isnan(m.azimuth_rad) & np.isnan(m.elevation_rad)
    _require(~nothing, "measurements", "measures neither distance nor angle: leave the row out")
    # Rows that repeat an earlier one: equal codes stand beside each other in the order of the codes.
    code = key.astype(np.uint64)
    for name in _COMPARED:
        bits = np.ascontiguousarray(getattr(m, name)).view(np.uint64)
        code = (code ^ bits) * np.uint64(0x9E3779B97F4A7C15)
        code ^= code >> np.uint64(29)
    ordered = np.sort(code)
    if not (ordered[1:] == ordered[:-1]).any():
        return  # as nearly always; a stable order takes ten times as long
    order = np.argsort(code, kind="stable")
    same = np.flatnonzero(code[order[1:]] == code[order[:-1]])
    one, other = (np.array([c[order[i]] for c in (key, *(getattr(m, n) for n in _COMPARED))]) for i in (same, same + 1))
    repeats = order[1:][same[((one == other) | (np.isnan(one) & np.isnan(other))).all(axis=0)]]
    if len(repeats):
        raise InputError(
            f"measurements, row {repeats.min()}: repeats an earlier row of its snapshot and link; remove one of them"
        )


def _check_range(span: Range, values: NDArray[Any], what: str, offset: int = 0) -> None:
    beyond = (values < span.possible[0]) | (values > span.possible[1])
    if beyond.any():
        at = np.argwhere(beyond)[0]
        raise span.impossible(float(values[tuple(at)]), f"{what} {at[0] + offset}")


def _require(ok: NDArray[np.bool_], name: str, problem: str, offset: int = 0) -> None:
    if not ok.all():
        row = int(np.argmin(ok.reshape(len(ok), -1).all(axis=1))) + offset
        raise InputError(f"{name}, row {row}: {problem}")
