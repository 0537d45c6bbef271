"""What may have to be done to the tables of a recording before they agree; and the drive that the odometry gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.recordings.importing.odometry import Motion, integrate
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import odometry_of

Arm = tuple[float, float]
PLANE = [0, 1, 3]  # x, y, yaw of a pose
OF_TABLE = {"odometry": ("speed", "yaw_rate", "side"), "reference": ("reference", "mirrored")}  # fields of Correction
GAP = 3.0  # median intervals: between fixes further apart than so nobody knows where the vehicle was


@dataclass(frozen=True)
class Correction:
    """Factors, shifts and delays that make recorded tables right; as it stands, none.

    Factors multiply what is recorded; a table that is late by so much is to be moved back by it; arms, m in the body
    frame: the array from the point that the odometry measures, from the reference's point, from the point of both
    (`measurements_arm_m`).
    """

    speed: float = 1.0
    yaw_rate: float = 1.0
    side: float = 1.0
    odometry_late_s: float = 0.0
    odometry_arm_m: Arm = (0.0, 0.0)
    azimuth: float = 1.0  # after wrapping: -1 counts the other way round
    azimuth_zero_rad: float = 0.0
    distance: float = 1.0
    distance_zero_m: float = 0.0
    measurements_late_s: float = 0.0
    measurements_arm_m: Arm = (0.0, 0.0)
    reference: float = 1.0
    mirrored: bool = False
    yaw_mirrored: bool = False  # yaws count from north, clockwise, as those of a reference north-east-down do
    reference_late_s: float = 0.0
    reference_arm_m: Arm = (0.0, 0.0)

    def effect(self, own: str, other: str, fields: Sequence[str]) -> Correction:
        """Return what shows of it between the table `own`, odometry or reference, and another one, which alone has
        `fields`: of delays and arms only differences show, or, of the array from the point of both, sums.
        """
        (x, y), (other_x, other_y) = getattr(self, f"{own}_arm_m"), getattr(self, f"{other}_arm_m")
        sign = -1.0 if other == "reference" else 1.0
        shown: dict[str, Any] = {field: getattr(self, field) for field in (*OF_TABLE[own], *fields)}
        shown[f"{own}_late_s"] = getattr(self, f"{own}_late_s") - getattr(self, f"{other}_late_s")
        shown[f"{own}_arm_m"] = (x + sign * other_x, y + sign * other_y)
        return Correction(**shown)

    def having(self, field: str, value: Any) -> Correction:
        """Return it with one of its fields, by name, at another value."""
        return replace(self, **{field: value})


class Drive:
    """The odometry in the plane, from the origin, for any correction of it."""

    table = "odometry"

    def __init__(self, recording: Recording) -> None:
        self.time_s = recording.time_s
        self._velocity = odometry_of(recording)[1:]
        self._tracks: dict[tuple[float, float, float], Floats] = {}

    def poses(self, times: Floats, c: Correction) -> Floats:
        """Return x, y (m) and yaw (rad), (..., 3), of the array at `times` (...,) in s; NaN outside."""
        key, when = (c.speed, c.yaw_rate, c.side), times + c.odometry_late_s
        if key not in self._tracks:
            self._tracks[key] = self._track(*key)
        x, y, yaw = (np.interp(when, self.time_s, column, np.nan, np.nan) for column in self._tracks[key].T)
        return away(x, y, yaw, c.odometry_arm_m)

    def places(self, times: Floats, c: Correction) -> Floats:
        """Return x, y (..., 2) in m of the array at `times` (...,) in s; NaN outside."""
        return self.poses(times, c)[..., :2]

    def _track(self, speed: float, yaw_rate: float, side: float) -> Floats:
        velocity = self._velocity * np.array([speed, speed * side, 0.0, yaw_rate, 0.0, 0.0])
        motion = Motion(self.time_s, velocity, np.ones(6, np.bool_))
        return integrate(motion, self.time_s, np.zeros(6))[0][:, PLANE]


class Fixes:
    """Where the vehicle is known to have been: times (R,) in s, places (R, 2) in m, yaws (R,) in rad, None if unknown.

    Between fixes that are further apart than usual nothing is known.
    """

    table = "reference"

    def __init__(self, time_s: Floats, position_m: Floats, yaw_rad: Floats | None) -> None:
        self.time_s, self.position_m = time_s, position_m
        self.yaw_rad = None if yaw_rad is None else np.unwrap(yaw_rad)
        self._gap = GAP * float(np.median(np.diff(time_s)))

    def known(self, times: Floats) -> NDArray[np.bool_]:
        """Return whether a place is known at `times` (...,) in s."""
        after = np.searchsorted(self.time_s, times).clip(1, len(self.time_s) - 1)
        near = self.time_s[after] - self.time_s[after - 1] <= self._gap
        return np.asarray(near & (times >= self.time_s[0]) & (times <= self.time_s[-1]))

    def places(self, times: Floats, c: Correction) -> Floats:
        """Return x, y (..., 2) in m at `times` (...,) in s, for a correction of the reference; NaN outside."""
        when, columns = times + c.reference_late_s, self.position_m.T[::-1] if c.mirrored else self.position_m.T
        return c.reference * np.stack([np.interp(when, self.time_s, p, np.nan, np.nan) for p in columns], -1)

    def poses(self, times: Floats, c: Correction) -> Floats:
        """Return x, y (m) and yaw (rad), (..., 3), of the array at `times` (...,) in s; NaN outside."""
        assert self.yaw_rad is not None
        x, y = np.moveaxis(self.places(times, c), -1, 0)
        yaw = np.interp(times + c.reference_late_s, self.time_s, self.yaw_rad)
        return away(x, y, 0.5 * np.pi - yaw if c.yaw_mirrored else yaw, c.reference_arm_m)


def away(x: Floats, y: Floats, yaw: Floats, arm: Arm) -> Floats:
    """Return poses (..., 3) of the point `arm` away, in m in the body frame, from one at x, y (m) with a yaw (rad)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([x + cos * arm[0] - sin * arm[1], y + sin * arm[0] + cos * arm[1], yaw], axis=-1)


def displacement(a: Floats, b: Floats) -> Floats:
    """Return forward, left (m) and turn (rad), (n, 3), from poses a to b (n, 3) of x, y and yaw, in the frame of a."""
    step = b[:, :2] - a[:, :2]
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.column_stack([c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1], b[:, 2] - a[:, 2]])


def moved_on(range_m: Floats, azimuth: Floats, elevation: Floats, moved: Floats) -> tuple[Floats, Floats]:
    """Return the change of the range in m and the azimuth in rad (n,) of sources that stay where they are, after a
    `displacement` (n, 3); before it they are seen at `range_m`, azimuth and elevation (n,) in rad.
    """
    flat, high = range_m * np.cos(elevation), range_m * np.sin(elevation)
    x, y = flat * np.cos(azimuth) - moved[:, 0], flat * np.sin(azimuth) - moved[:, 1]
    return np.sqrt(x * x + y * y + high * high) - np.abs(range_m), wrap_angle(np.arctan2(y, x) - moved[:, 2])


def dead_reckoned(recording: Recording, times: Floats) -> Floats:
    """Return poses (N, 6), in m and rad, of the odometry alone at `times` (N,) in s within the drive."""
    motion = Motion(recording.time_s, odometry_of(recording)[1:], np.ones(6, np.bool_))
    first = recording.time_s[:1] if times[0] > recording.time_s[0] else times[:0]
    return integrate(motion, np.append(first, times), recording.start_pose)[0][len(first) :]
