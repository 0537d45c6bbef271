"""The one data contract: what a measurement campaign leaves behind, simulated or real.

Everything is a frozen dataclass of arrays. Estimators see the observable part through `slam.api.Setup` and
`slam.api.Snapshot`; only scoring reads `truth`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
SCHEMA_VERSION = 1
COMPONENTS = ("u_x", "u_y", "u_z", "u_psi", "u_theta", "u_phi")


@dataclass(frozen=True)
class OdometryModel:
    """The odometry's data sheet, per component of u = [u_x, u_y, u_z (m/s), u_psi, u_theta, u_phi (rad/s)].

    A measured component is (1 + scale) u + bias + walk + white. All fields have shape (6,) and are standard deviations:
    `noise_density` of the white noise in unit * sqrt(s) (an interval's mean has noise_density / sqrt(dt)), `bias` in
    the unit of u, `bias_walk_density` in unit / sqrt(s), `scale` without unit. Zero: this error does not exist.
    """

    noise_density: Floats
    bias: Floats
    bias_walk_density: Floats
    scale: Floats


@dataclass(frozen=True)
class Links:
    """One row a link (base station, cell, CRS port): `site` indexes `Sites`; all (L,)."""

    site: Ints
    cell_id: Ints
    port: Ints

    def __len__(self) -> int:
        return len(self.site)


@dataclass(frozen=True)
class Sites:
    """Base-station sites: names and the prior of the clock offset, in metres (std 0: known); no positions."""

    name: tuple[str, ...]
    clock_offset_mean_m: Floats
    clock_offset_std_m: Floats

    def __len__(self) -> int:
        return len(self.name)


@dataclass(frozen=True)
class Measurements:
    """Path parameters, one row a path, sorted by (snapshot, link); all columns (M,).

    `distance_m` is c tau with the site's clock offset in it; azimuth and elevation are in the body frame; `snr_db` is
    rho,
    per sample. NaN: this component was not measured. The standard deviations are those that the front end
    claims, and None where it claims none.
    """

    snapshot: Ints
    link: Ints
    distance_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    snr_db: Floats
    distance_std_m: Floats | None = None
    azimuth_std_rad: Floats | None = None
    elevation_std_rad: Floats | None = None

    def __len__(self) -> int:
        return len(self.snapshot)


@dataclass(frozen=True)
class VirtualTransmitters:
    """The VTs that the drive meets. A line-of-sight transmitter is one too, of order 0.

    `position_m` (V, 3); `site` (V,); `order` (V,); `facets` (V, 2), -1 where there is none; `visible` (I, 3): rows of
    VT,
    first and last snapshot of an interval in which the path exists (detected or not).
    """

    position_m: Floats
    site: Ints
    order: Ints
    facets: Ints
    visible: Ints

    def __len__(self) -> int:
        return len(self.site)


@dataclass(frozen=True)
class Truth:
    """What really happened: for scoring and oracles only.

    `poses` (T, 6); `measurement_vt` (M,), -1 for clutter; `measurement_std` (M, 3): the true standard
    deviations of distance (m), azimuth, elevation (rad), NaN for clutter; `persisting_std` (M, 3): their part that is
    alike over links and changes slowly (None: all errors are white); `site_positions_m` (S, 3); `clock_offsets_m`
    (S,): b of d = norm(v - r) + b; `odometry_bias` (T, 6): bias plus walk at each snapshot; `odometry_scale` (6,).
    """

    poses: Floats
    measurement_vt: Ints
    measurement_std: Floats
    vts: VirtualTransmitters
    site_positions_m: Floats
    clock_offsets_m: Floats
    odometry_bias: Floats
    odometry_scale: Floats
    persisting_std: Floats | None = None


@dataclass(frozen=True)
class Recording:
    """A drive as it was measured. `start_pose` (6,) and `start_std` (6,) are the estimator's prior at time_s[0].

    `time_s` (T,); `odometry` (T, 6): mean body velocities from time_s[t-1] to time_s[t], row 0 zero.
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

    def __post_init__(self) -> None:
        check(self)

    @property
    def rows(self) -> Ints:
        """First measurement row of each snapshot, (T + 1,): snapshot t has rows[t]:rows[t + 1]."""
        return np.searchsorted(self.measurements.snapshot, np.arange(len(self.time_s) + 1)).astype(np.int64)

    def save(self, path: str | Path) -> None:
        """Write the recording to one HDF5 file, atomically. Raises InputError when that is impossible."""
        from cellslam.sim.recording_hdf5 import save

        save(self, Path(path))

    @staticmethod
    def load(path: str | Path) -> Recording:
        """Read and check a recording. Raises InputError naming file, table and row of what is wrong."""
        from cellslam.sim.recording_hdf5 import load

        return load(Path(path))


def check(recording: Recording) -> None:
    """Raise InputError, naming table, column and row, where a recording breaks the contract."""
    r, m = recording, recording.measurements
    count = len(r.time_s)
    _shape("time_s", r.time_s, (count,))
    if count == 0:
        raise InputError("time_s is empty: a recording needs at least one snapshot")
    _finite("time_s", r.time_s)
    _require(
        np.diff(r.time_s) > 0,
        "time_s",
        "is not after the row before it: sort the snapshots by time",
        offset=1,
    )
    _shape("odometry", r.odometry, (count, 6))
    _shape("start_pose", r.start_pose, (6,))
    _shape("start_std", r.start_std, (6,))
    _finite("start_pose", r.start_pose)
    for name in ("noise_density", "bias", "bias_walk_density", "scale"):
        column = getattr(r.odometry_model, name)
        _shape(f"odometry_model.{name}", column, (6,))
        _require(column >= 0, f"odometry_model.{name}", "is not a standard deviation (must be >= 0)")
    _check_links(r)
    _check_measurements(m, count, len(r.links))
    if r.truth is not None:
        _check_truth(r.truth, r)


def _check_links(r: Recording) -> None:
    for name in ("site", "cell_id", "port"):
        _shape(f"links.{name}", getattr(r.links, name), (len(r.links),))
    _shape("sites.clock_offset_mean_m", r.sites.clock_offset_mean_m, (len(r.sites),))
    _shape("sites.clock_offset_std_m", r.sites.clock_offset_std_m, (len(r.sites),))
    _require(r.sites.clock_offset_std_m >= 0, "sites.clock_offset_std_m", "is negative")
    _require(
        (r.links.site >= 0) & (r.links.site < len(r.sites)),
        "links.site",
        f"is not one of the {len(r.sites)} sites",
    )


def _check_measurements(m: Measurements, snapshots: int, links: int) -> None:
    for name in ("link", "distance_m", "azimuth_rad", "elevation_rad", "snr_db"):
        _shape(f"measurements.{name}", getattr(m, name), (len(m),))
    _require(
        (m.snapshot >= 0) & (m.snapshot < snapshots),
        "measurements.snapshot",
        f"is not one of the {snapshots} snapshots",
    )
    _require((m.link >= 0) & (m.link < links), "measurements.link", f"is not one of the {links} links")
    key = m.snapshot * max(links, 1) + m.link
    _require(np.diff(key) >= 0, "measurements", "is not sorted by (snapshot, link)", offset=1)
    _require(
        ~(np.abs(m.azimuth_rad) > np.pi + 1e-9),
        "measurements.azimuth_rad",
        "is outside [-pi, pi]: radians are expected",
    )
    _require(
        ~(np.abs(m.elevation_rad) > np.pi / 2 + 1e-9),
        "measurements.elevation_rad",
        "is outside [-pi/2, pi/2]",
    )
    for name in ("distance_std_m", "azimuth_std_rad", "elevation_std_rad"):
        column = getattr(m, name)
        if column is not None:
            _shape(f"measurements.{name}", column, (len(m),))
            _require(~(column <= 0), f"measurements.{name}", "is not a standard deviation (must be > 0)")


def _check_truth(truth: Truth, r: Recording) -> None:
    vts = len(truth.vts)
    _shape("truth.poses", truth.poses, (len(r.time_s), 6))
    _shape("truth.measurement_vt", truth.measurement_vt, (len(r.measurements),))
    _shape("truth.measurement_std", truth.measurement_std, (len(r.measurements), 3))
    if truth.persisting_std is not None:
        _shape("truth.persisting_std", truth.persisting_std, (len(r.measurements), 3))
    _shape("truth.vts.position_m", truth.vts.position_m, (vts, 3))
    _shape("truth.site_positions_m", truth.site_positions_m, (len(r.sites), 3))
    _shape("truth.clock_offsets_m", truth.clock_offsets_m, (len(r.sites),))
    _require(
        (truth.measurement_vt >= -1) & (truth.measurement_vt < vts),
        "truth.measurement_vt",
        f"is not one of the {vts} VTs",
    )


def _shape(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}, expected {shape}")


def _finite(name: str, array: Floats) -> None:
    _require(np.isfinite(array), name, "is not finite")


def _require(ok: NDArray[np.bool_], name: str, problem: str, offset: int = 0) -> None:
    if not ok.all():
        row = int(np.argmin(ok.reshape(len(ok), -1).all(axis=1))) + offset
        raise InputError(f"{name}, row {row}: {problem}")
