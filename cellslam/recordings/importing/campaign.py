"""A measured campaign in SI units, each table at its own times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import ArrayLike

QUANTITIES = ("distance_m", "azimuth_rad", "elevation_rad", "snr_db")
CLAIMS = ("distance_std_m", "azimuth_std_rad", "elevation_std_rad")
NO_NOISE = tuple([0.0] * 6)


@dataclass(frozen=True)
class OdometryTable:
    """Velocities at their own times (N,): components of u by name ("u_x" in m/s, "u_psi" in rad/s, ...), each (N,).

    `hold`: "next", a row is valid until the next row; "before", since the row before; "linear", in between
    interpolate. A component that is left out was not measured. `lever_arm_m`: the array in the body frame of the
    point whose velocity this is.
    """

    time_s: ArrayLike
    components: Mapping[str, ArrayLike]
    hold: str = "next"
    lever_arm_m: Sequence[float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ReferenceTable:
    """Known positions (R, 2) or (R, 3) of the array in metres at times (R,); yaw and deviation (R,) where known."""

    time_s: ArrayLike
    position_m: ArrayLike
    yaw_rad: ArrayLike | None = None
    std_m: ArrayLike | float | None = None


@dataclass(frozen=True)
class Campaign:
    """What was measured: each table with its own times, all on one clock, in metres, radians, seconds, dB.

    `time_s` (M,) and `columns`: a row a path; those of `QUANTITIES` and `CLAIMS` that exist; `link` (M,) indexes
    `link_sites`, the site of each link. `site_offsets`: by site, the prior of the clock offset (mean, std) in
    metres and as many as there are of the further columns of `CLOCK_PRIOR`; a site whose clock is known has (0, 0).
    `start_pose`: None takes it from the reference. `snapshots_s`: times of all snapshots, empty ones too; None: the
    times of the measurements. `noise`: OdometryModel's fields by name, each (6,).
    """

    time_s: ArrayLike
    columns: Mapping[str, ArrayLike]
    odometry: OdometryTable | None = None
    link: ArrayLike | None = None
    link_sites: Sequence[str] = ("site",)
    link_cells: Sequence[int] | None = None
    link_ports: Sequence[int] | None = None
    site_offsets: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    noise: Mapping[str, Sequence[float]] = field(default_factory=dict)
    start_pose: Sequence[float] | None = None
    start_std: Sequence[float] = NO_NOISE
    reference: ReferenceTable | None = None
    snapshots_s: ArrayLike | None = None
    plane: bool = False
    about: Mapping[str, Any] = field(default_factory=dict)
