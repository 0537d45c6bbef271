"""What may have to be done to the tables of a recording before they tell the same story; and the drive that they then
tell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cellslam.recordings.importing.odometry import Motion, integrate
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.api import odometry_of

Arm = tuple[float, float]


@dataclass(frozen=True)
class Correction:
    """Factors, shifts and delays that make recorded tables right; as it stands, none.

    Factors multiply what is recorded; a table that is late by so much is to be moved back by it; arms, m in the body
    frame: the array from the point that the odometry measures, from the reference's point, from the point of both.
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
    array_arm_m: Arm = (0.0, 0.0)
    reference: float = 1.0
    mirrored: bool = False
    reference_late_s: float = 0.0
    reference_arm_m: Arm = (0.0, 0.0)

    def between_odometry_and(self, table: Literal["measurements", "reference"]) -> Correction:
        """Return what it comes to between the odometry and another table: of delays and arms, only sums show."""
        late, arm = (
            (self.measurements_late_s, self.array_arm_m)
            if table == "measurements"
            else (self.reference_late_s, self.reference_arm_m)
        )
        return Correction(
            speed=self.speed,
            yaw_rate=self.yaw_rate,
            side=self.side,
            odometry_late_s=self.odometry_late_s - late,
            odometry_arm_m=(self.odometry_arm_m[0] + arm[0], self.odometry_arm_m[1] + arm[1]),
        )

    def having(self, field: str, value: Any) -> Correction:
        """Return it with one of its fields, by name, at another value."""
        return replace(self, **{field: value})


class Drive:
    """The odometry in the plane, from the origin, for any correction of it."""

    def __init__(self, recording: Recording) -> None:
        self.time_s = recording.time_s
        self._velocity = odometry_of(recording)[1:, [0, 1, 3]]
        self._made: dict[tuple[float, float, float], Floats] = {}

    def poses(self, times: Floats, c: Correction, arm: Arm) -> Floats:
        """Return x, y (m) and yaw (rad), (..., 3), at `times` (...,) in s, of the point `arm` away; NaN outside."""
        track = self._track(c)
        inside = (times >= self.time_s[0]) & (times <= self.time_s[-1])
        x, y, yaw = (np.where(inside, np.interp(times, self.time_s, column), np.nan) for column in track.T)
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.stack([x + cos * arm[0] - sin * arm[1], y + sin * arm[0] + cos * arm[1], yaw], axis=-1)

    def _track(self, c: Correction) -> Floats:
        key = (c.speed, c.yaw_rate, c.side)
        if key not in self._made:
            dt = np.diff(self.time_s)
            turn = self._velocity[:, 2] * dt * c.yaw_rate
            yaw = np.concatenate([[0.0], np.cumsum(turn)])
            half = 0.5 * (yaw[1:] + yaw[:-1])
            ahead, left = self._velocity[:, 0] * dt * c.speed, self._velocity[:, 1] * dt * c.speed * c.side
            step = np.column_stack(
                [ahead * np.cos(half) - left * np.sin(half), ahead * np.sin(half) + left * np.cos(half)]
            )
            place = np.vstack([np.zeros(2), np.cumsum(step, axis=0)])
            self._made[key] = np.column_stack([place, yaw])
        return self._made[key]


def dead_reckoned(recording: Recording, times: Floats) -> Floats:
    """Return poses (N, 6), in m and rad, of the odometry alone at `times` (N,) in s within the drive."""
    motion = Motion(recording.time_s, odometry_of(recording)[1:], np.ones(6, np.bool_))
    poses, _ = integrate(
        motion,
        np.insert(times, 0, recording.time_s[0]) if times[0] > recording.time_s[0] else times,
        recording.start_pose,
    )
    return poses[-len(times) :]
