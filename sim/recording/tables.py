"""The tables of a recording: what a measurement campaign leaves behind, simulated or real.

Everything is a frozen dataclass of arrays. Estimators see the observable part through `slam.api.Setup` and
`slam.api.Snapshot`; only scoring reads `truth`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import POSITION_COLUMNS, Described, dataframe

if TYPE_CHECKING:
    import pandas as pd

SAME_PLACE_M = 1e-6  # rounding of positions
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, repr=False)
class OdometryModel(Described):
    """The odometry's data sheet, per component of u = [u_x, u_y, u_z (m/s), u_psi, u_theta, u_phi (rad/s)].

    A measured component is (1 + scale) u + bias + walk + white. All fields have shape (6,) and are standard deviations:
    `noise_density` of the white noise in unit * sqrt(s) (an interval's mean has noise_density / sqrt(dt)), `bias` in
    the unit of u, `bias_walk_density` in unit / sqrt(s), `scale` without unit. Zero: this error does not exist.
    `time_constant_s`: of odometry that is what the vehicle was commanded, which it follows as a system of the first
    order, s; zero: at once, or nobody knows. None: odometry was measured.
    """

    noise_density: Floats
    bias: Floats
    bias_walk_density: Floats
    scale: Floats
    time_constant_s: float | None = None


@dataclass(frozen=True, repr=False)
class Links(Described):
    """One row a link (base station, cell, CRS port): `site` indexes `Sites`; all (L,).

    `cell_id` and `port` are -1 where the campaign has no such thing. `azimuth_rad` (L,): where the sector's antenna
    points, counter-clockwise from east; NaN, or None for all: not known.
    """

    site: Ints
    cell_id: Ints
    port: Ints
    azimuth_rad: Floats | None = None

    def __len__(self) -> int:
        return len(self.site)


# The columns of a site that say what is known of its clock before the drive; from the third on they may be None.
CLOCK_PRIOR = (
    "clock_offset_mean_m", "clock_offset_std_m", "clock_drift_std_m_s", "clock_walk_m_sqrt_s",
    "clock_drift_walk_m_s_sqrt_s", "clock_step_std_m",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class Sites(Described):
    """Base-station sites: names and the prior of the clock offset, in metres (std 0: known).

    `clock_drift_std_m_s` (S,): deviation of the rate at which an offset changes, m/s (None: offsets are constant).
    `clock_walk_m_sqrt_s` and `clock_drift_walk_m_s_sqrt_s` (S,): densities of the random walks of offset and rate, in m
    and m/s per square root of a second (None: they do not walk). `clock_step_std_m` (S,): deviation of the size of
    steps that happen at unknown times, m (None, 0: none do).
    `position_m` (S, 3): where the transmitters stand that were surveyed before the drive; NaN, or None for all: not
    known. `position_std_m` (S, 3): deviations of the survey's errors in x, y and z, which are independent (None: 0).
    """

    name: tuple[str, ...]
    clock_offset_mean_m: Floats
    clock_offset_std_m: Floats
    clock_drift_std_m_s: Floats | None = None
    position_m: Floats | None = None
    clock_walk_m_sqrt_s: Floats | None = None
    clock_drift_walk_m_s_sqrt_s: Floats | None = None
    clock_step_std_m: Floats | None = None
    position_std_m: Floats | None = None

    def __len__(self) -> int:
        return len(self.name)

    @property
    def surveyed_m(self) -> Floats:
        """Positions (S, 3) of the surveyed sites, m: NaN where a site was not surveyed."""
        return np.full((len(self), 3), np.nan) if self.position_m is None else self.position_m

    @property
    def survey_std_m(self) -> Floats:
        """Deviations (S, 3) of the errors of `surveyed_m`, m: zero where the survey is exact."""
        return np.zeros((len(self), 3)) if self.position_std_m is None else self.position_std_m

    @property
    def drift_std_m_s(self) -> Floats:
        """Deviation (S,) of each offset's rate, m/s: zero where it is constant."""
        return np.zeros(len(self)) if self.clock_drift_std_m_s is None else self.clock_drift_std_m_s

    @property
    def walk_densities(self) -> Floats:
        """Densities (2, S) of the random walks of offset and rate, in m and m/s per sqrt(s): zero where none is."""
        given = (self.clock_walk_m_sqrt_s, self.clock_drift_walk_m_s_sqrt_s)
        return np.array([np.zeros(len(self)) if column is None else column for column in given])

    @property
    def step_std_m(self) -> Floats:
        """Deviation (S,) of the size of steps, m: zero where a clock does not step."""
        return np.zeros(len(self)) if self.clock_step_std_m is None else self.clock_step_std_m


@dataclass(frozen=True, repr=False)
class Measurements(Described):
    """Path parameters, one row a path, sorted by (snapshot, link); all columns (M,).

    `distance_m` is c tau with the site's clock offset in it; azimuth and elevation are in the body frame; `snr_db` is
    rho, per sample. NaN: this component was not measured. The standard deviations are those that the front end claims,
    and None where it claims none.
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

    def to_dataframe(self) -> pd.DataFrame:
        """Return a pandas table, a row a path, with these columns."""
        return dataframe(vars(self))


@dataclass(frozen=True, repr=False)
class VirtualTransmitters(Described):
    """The VTs that the drive meets. A line-of-sight transmitter is one too, of order 0.

    `position_m` (V, 3); `site` (V,); `order` (V,); `facets` (V, 2), -1 where there is none; `visible` (I, 3): rows of
    VT, first and last snapshot of an interval in which the path exists (detected or not). `scatterer` (V,): 1 for
    points that scatter what the site sends, 0 for mirror images (None: there are no scatterers);
    the site of a scatterer is a VT, too.
    """

    position_m: Floats
    site: Ints
    order: Ints
    facets: Ints
    visible: Ints
    scatterer: Ints | None = None

    @property
    def scatters(self) -> NDArray[np.bool_]:
        """Which VTs (V,) are scatterers."""
        return np.zeros(len(self), np.bool_) if self.scatterer is None else self.scatterer == 1

    def __len__(self) -> int:
        return len(self.site)

    def to_dataframe(self) -> pd.DataFrame:
        """Return a pandas table, a row a VT: site, order, x_m, y_m, z_m."""
        position = dict(zip(POSITION_COLUMNS, self.position_m.T, strict=True))
        return dataframe({"site": self.site, "order": self.order, **position})


@dataclass(frozen=True, repr=False)
class ClockSteps(Described):
    """Steps of clock offsets, sorted by time: `site` (C,), `time_s` (C,) since the first snapshot, `size_m` (C,)."""

    site: Ints
    time_s: Floats
    size_m: Floats

    def __len__(self) -> int:
        return len(self.site)


@dataclass(frozen=True, repr=False)
class Vehicles(Described):
    """Other vehicles of a drive, as boxes on the ground, and what they blocked.

    `kind` (N,) in words; `size_m` (N, 3): length, width, height; `time_s` (K,), equidistant, since the first snapshot;
    `poses` (K, N, 4): x, y, ground of the box's centre (m), yaw (rad), linear in between unless a vehicle leaves and
    comes in again; `blocked` (B, 4): row of the VT, vehicle, first and last snapshot of each time that it blocks a
    path; `reflected` (M,): the vehicle whose side a measurement was reflected by, -1 none; such a measurement has no
    VT.
    """

    kind: tuple[str, ...]
    size_m: Floats
    time_s: Floats
    poses: Floats
    blocked: Ints
    reflected: Ints

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(frozen=True, repr=False)
class Truth(Described):
    """What really happened: for scoring and oracles only.

    `poses` (T, 6); `measurement_vt` (M,), -1 for clutter; `measurement_std` (M, 3): the true standard
    deviations of distance (m), azimuth, elevation (rad), NaN for clutter; `persisting_std` (M, 3): their part that is
    alike over links and changes slowly (None: all errors are white); `merging_shift` (M, 3): by how much paths that
    were not resolved from it moved it (m, rad, rad), NaN for clutter (None: not known); `site_positions_m` (S, 3);
    `clock_offsets_m` (S,): b of d = norm(v - r) + b at the first snapshot; `clock_drift_m_s` (S,): its rate (None:
    constant); `odometry_bias` (T, 6): bias plus walk and steps at each snapshot; `odometry_scale` (6,).

    What is None where it does not happen: `vehicles`, traffic; `clock_wander_m` (T, S), what walk and steps have added
    to the offsets since the first snapshot, with the steps `clock_steps`; `odometry_slip` (T,), factor by which the
    speed of an interval is measured too large; `age_s` (T,), how much older than their time stamp a snapshot's
    measurements are.
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
    merging_shift: Floats | None = None
    clock_drift_m_s: Floats | None = None
    clock_wander_m: Floats | None = None
    clock_steps: ClockSteps | None = None
    odometry_slip: Floats | None = None
    age_s: Floats | None = None
    vehicles: Vehicles | None = None

    @property
    def site_vts(self) -> Ints:
        """Row (S,) of the VT that is the site itself, which the line of sight leads to; -1: no path of it exists."""
        itself = np.linalg.norm(self.vts.position_m - self.site_positions_m[self.vts.site], axis=1) < SAME_PLACE_M
        out = np.full(len(self.site_positions_m), -1)
        out[self.vts.site[itself]] = np.flatnonzero(itself)
        return out

    def clock_offsets_at(self, elapsed_s: Floats) -> Floats:
        """Return the clock offsets (T, S) at all snapshots, so long (T,) after the first one."""
        rate = np.zeros_like(self.clock_offsets_m) if self.clock_drift_m_s is None else self.clock_drift_m_s
        offsets = np.asarray(self.clock_offsets_m + np.multiply.outer(elapsed_s, rate))
        return offsets if self.clock_wander_m is None else offsets + self.clock_wander_m


@dataclass(frozen=True, repr=False)
class Reference(Described):
    """The trajectory as another sensor saw it (GNSS, total station), at its own times: what a real drive has for truth.

    `time_s` (R,), increasing, on the clock of the snapshots; `position_m` (R, 3) of the array in the world frame;
    `yaw_rad` (R,); `position_std_m` (R,). NaN: not known. `odometry` (R, 6), where there is one: mean body velocities
    in m/s and rad/s from the last snapshot before each fix to the fix, NaN where they were not measured.
    """

    time_s: Floats
    position_m: Floats
    yaw_rad: Floats
    position_std_m: Floats
    odometry: Floats | None = None

    def __len__(self) -> int:
        return len(self.time_s)
