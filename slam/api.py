"""The estimator contract: what an estimator is given, what it answers.

An estimator sees copies of observables only. `Setup` and `Snapshot` hold no reference to the recording.

Source: paper, sections II and III: body velocities (eq. 14), distance, azimuth and elevation of each path (eq. 7), SNR
(eq. 8), clock offsets (eq. 5).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import POSITION_COLUMNS, Described, dataframe
from cellslam.sim.frames import followed, held, rotation
from cellslam.sim.recording import Floats, Ints, Links, OdometryModel, Recording, Sites, Truth
from cellslam.slam.model.vt_map import VtMap
from cellslam.slam.model.walls import normals

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Setup(Described):
    """What is known before the drive: links, sites with offset priors and surveys, odometry data sheet, start pose and
    deviations (6,).

    `range_scale_std`: deviation of the scale k by which all distances are measured too long, measured = (1 + k) true +
    clock offset; 0: there is no such error. `scatterers`: whether points may scatter paths, beside walls that mirror
    them. `map`: of VTs, as earlier drives left it; None: none is known. `truth` is None but for an estimator that
    declares `requires_truth`, `future` but for one that declares `requires_future`: all steps of the drive that begins.
    """

    links: Links
    sites: Sites
    odometry_model: OdometryModel
    start_pose: Floats
    start_std: Floats
    truth: Truth | None = None
    map: VtMap | None = None
    future: tuple[Step, ...] | None = None
    range_scale_std: float = 0.0
    scatterers: bool = False

    @property
    def surveyed(self) -> tuple[Ints, Floats, Floats]:
        """The links (n,) of surveyed sites, where these stand (n, 3), and the deviations (n, 3) of the survey, in m.

        Links of one site share the error of its survey.
        """
        place, std = (column[self.links.site] for column in (self.sites.surveyed_m, self.sites.survey_std_m))
        link = np.flatnonzero(np.isfinite(place).all(axis=1))
        return link, place[link], std[link]


@dataclass(frozen=True, repr=False)
class Snapshot(Described):
    """The measurements of one snapshot, read-only columns (m,), sorted by link; NaN: component not measured.

    `odometry_held_s` (6,): where odometry has a gap, for how long each component's last value has been held (None: all
    are measured, or never were).
    `row` is the measurement's row in the recording: oracles look truth up by it, others need not look at it.
    """

    index: int
    row: Ints
    link: Ints
    distance_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    snr_db: Floats
    distance_std_m: Floats | None = None
    azimuth_std_rad: Floats | None = None
    elevation_std_rad: Floats | None = None
    odometry_held_s: Floats | None = None

    def __len__(self) -> int:
        return len(self.link)


Step = tuple[float, Floats, Snapshot]  # the arguments of `Estimator.step`


@dataclass(frozen=True, repr=False)
class VtEstimate(Described):
    """Estimated VTs: `id` (V,), `link` (V,), `position_m` (V, 3), `covariance` (V, 3, 3), in the world frame.

    `scatterer` (V,): 1 for scatterers, points where paths bend, 0 for mirror images. None: there are no scatterers.
    """

    id: Ints
    link: Ints
    position_m: Floats
    covariance: Floats
    scatterer: Ints | None = None

    @property
    def scatters(self) -> NDArray[np.bool_]:
        """Which VTs (V,) are scatterers."""
        return np.zeros(len(self.id), np.bool_) if self.scatterer is None else self.scatterer == 1

    def to_dataframe(self) -> pd.DataFrame:
        """Return a pandas table, a row a VT: id, link, x_m, y_m, z_m."""
        return dataframe(
            {"id": self.id, "link": self.link, **dict(zip(POSITION_COLUMNS, self.position_m.T, strict=True))}
        )


@dataclass(frozen=True, repr=False)
class WallEstimate(Described):
    """Estimated vertical walls: `id` (W,); `azimuth_rad` (W,) of the normal, which points away from the sites, and
    `distance_m` (W,) of the plane from the world's origin along it, with their `covariance` (W, 2, 2).

    `extent_m` (W, 2): of the part that paths were reflected by, least and greatest x along (-sin a, cos a), a being the
    azimuth.
    """

    id: Ints
    azimuth_rad: Floats
    distance_m: Floats
    covariance: Floats
    extent_m: Floats

    def __len__(self) -> int:
        return len(self.id)

    @property
    def ends_m(self) -> Floats:
        """The ends (W, 2, 2) of the visible parts: wall, end, east and north."""
        across, along = normals(self.azimuth_rad)
        return np.asarray(self.distance_m[:, None, None] * across[:, None] + self.extent_m[..., None] * along[:, None])


@dataclass(frozen=True, repr=False)
class Estimate(Described):
    """The belief after one snapshot.

    `pose` (6,) and `covariance` (6, 6); where the estimator has them: `association` (m,), VT id per measurement, -1
    for none;
    `clock_offset_m` (S,) and `clock_offset_variance_m2` (S,); `vts`, which may be None in all but the last
    snapshot of a drive and those for which it is cheap; `walls`, of which the last ones that were given count.
    """

    pose: Floats
    covariance: Floats
    association: Ints | None = None
    clock_offset_m: Floats | None = None
    clock_offset_variance_m2: Floats | None = None
    vts: VtEstimate | None = None
    walls: WallEstimate | None = None


@runtime_checkable
class Estimator(Protocol):
    """The methods of an estimator, which the runner calls.

    These are optional. `warm_up()` compiles; it is not timed. After the drive `finish()` returns a smoother's poses
    (T, 6), `calibration()` a `Calibration` of the array or None, `vt_map()` a `VtMap` of the VTs, those of `Setup.map`
    included, or None, and `remarks()` lines of text about the drive.
    """

    name: ClassVar[str]
    requires_truth: ClassVar[bool] = False
    requires_future: ClassVar[bool] = False

    def __init__(self, options: Any) -> None: ...

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Begin a drive at the first snapshot."""
        ...

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Advance by `dt_s` with mean body velocities `odometry` (6,) in m/s and rad/s, then use `snapshot`.

        First call: dt_s = 0.
        """
        ...


def setup_of(
    recording: Recording, with_truth: bool = False, known: VtMap | None = None, with_future: bool = False
) -> Setup:
    """Return copies of what an estimator may know before the drive; `known`: the map that it begins with."""
    return Setup(
        links=_frozen_copy(recording.links),
        sites=_frozen_copy(recording.sites),
        odometry_model=_frozen_copy(recording.odometry_model),
        start_pose=_frozen(recording.start_pose),
        start_std=_frozen(_start_std(recording)),
        truth=_frozen_copy(recording.truth) if with_truth else None,
        map=known,
        future=tuple(steps_of(recording)) if with_future else None,
        range_scale_std=recording.range_scale_std,
        scatterers=recording.scatterers,
    )


def steps_of(recording: Recording) -> list[Step]:
    """Return what `step` is called with, of every snapshot of a recording."""
    dt_s = np.diff(recording.time_s, prepend=recording.time_s[0])
    return list(zip(dt_s.tolist(), odometry_of(recording), snapshots_of(recording), strict=True))


def odometry_of(recording: Recording) -> Floats:
    """Return odometry (T, 6) in m/s and rad/s as estimators take it, read-only.

    A component that was never measured is zero (its data sheet then says how the vehicle moves that way); in a gap the
    last measured value holds. Commands are followed with the time constant of the data sheet.
    """
    time_constant_s = recording.odometry_model.time_constant_s
    out = _followed(recording, time_constant_s)[0] if time_constant_s else held(recording.odometry)
    out.setflags(write=False)
    return out


def snapshots_of(recording: Recording) -> list[Snapshot]:
    """Return every snapshot of a recording, each with its own copies of the columns.

    In a recording of one plane the elevation is zero: known, though not measured.
    """
    m, rows = recording.measurements, recording.rows
    every_row = np.arange(len(m))
    elevation = np.zeros(len(m)) if recording.plane else m.elevation_rad
    columns = (every_row, m.link, m.distance_m, m.azimuth_rad, elevation, m.snr_db)
    claimed = (m.distance_std_m, m.azimuth_std_rad, m.elevation_std_rad)
    out, held_s = [], _held_s(recording)
    for t in range(len(recording.time_s)):
        part = slice(rows[t], rows[t + 1])
        snapshot = Snapshot(
            t,
            *(_frozen(c[part]) for c in columns),
            *(None if c is None else _frozen(c[part]) for c in claimed),
        )
        if held_s[t].any():
            snapshot = replace(snapshot, odometry_held_s=_frozen(held_s[t]))
        out.append(snapshot)
    return out


def _followed(recording: Recording, time_constant_s: float) -> tuple[Floats, Floats]:
    """Return `followed` (T, 6) of a recording's odometry, which is commands."""
    dt_s = np.diff(recording.time_s, prepend=recording.time_s[0])
    return followed(held(recording.odometry), dt_s, time_constant_s)


def _start_std(recording: Recording) -> Floats:
    """Return the deviations (6,) of the start pose in m and rad, for steps whose odometry is `odometry_of`.

    A vehicle that follows commands u with the time constant tau, and moves with v as the drive begins, comes to stand
    tau (v - u) from where it would with v = u. Nobody knows v: it is as far from u as at other times of the drive.
    """
    time_constant_s = recording.odometry_model.time_constant_s
    if not time_constant_s:
        return recording.start_std
    aside2 = time_constant_s**2 * np.mean(_followed(recording, time_constant_s)[1] ** 2, axis=0)
    aside2[:3] = rotation(*recording.start_pose[3:]) ** 2 @ aside2[:3]
    return np.asarray(np.sqrt(recording.start_std**2 + aside2))


def _held_s(recording: Recording) -> Floats:
    """Return for how long (T, 6), in s, each component of odometry that is measured at all has not been."""
    missing = np.isnan(recording.odometry)
    missing &= ~missing[1:].all(axis=0)
    row = np.arange(len(missing))[:, None]
    last = np.maximum.accumulate(np.where(missing, 0, row), axis=0)
    return np.asarray(recording.time_s[:, None] - recording.time_s[last])


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def _frozen_copy(value: Any) -> Any:
    """Return a dataclass with its arrays as read-only copies, at any depth."""
    if isinstance(value, np.ndarray):
        return _frozen(value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{f.name: _frozen_copy(getattr(value, f.name)) for f in fields(value)})
    return value
