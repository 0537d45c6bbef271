"""How well the reference and the odometry tell the same path: short stretches of both, laid onto each other."""

from __future__ import annotations

import numpy as np

from cellslam.recordings.inspection.corrections import Correction, Drive
from cellslam.sim.recording import Floats, Ints

STRETCH_M = 30.0  # of the path, for one comparison
FEWEST, MOST = 16, 80  # stretches
SHORTEST_M = 2.0
FIXES = 6  # of a stretch
DEGREES_OF_FREEDOM = 5.0  # of their residuals, which are not independent
FLOOR = 0.01  # of a stretch: nobody's odometry agrees better than so


class ReferenceEvidence:
    """Log-likelihood of stretches of the reference, given the odometry: a rigid motion of each is free.

    A stretch's scale of residuals is free as well: an outlier spoils no more than its own stretch.
    """

    name = "reference"

    def __init__(self, drive: Drive, times: Floats, position_m: Floats) -> None:
        """`times` (R,) in s and `position_m` (R, 2) of the fixes. Raises ValueError where they are too few."""
        self.drive = drive
        here = drive.poses(times, Correction(), (0.0, 0.0))[:, :2]
        travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(here, axis=0).T))])
        chosen = stretches(travelled, STRETCH_M, FEWEST, FIXES)
        self.times, self.fixes = times[chosen], position_m[chosen]
        size = np.hypot(*(self.fixes.max(axis=1) - self.fixes.min(axis=1)).T)
        moving = size > 0.3 * np.median(size)
        self.times, self.fixes, self.floor = self.times[moving], self.fixes[moving], FLOOR * float(np.median(size))
        if not moving.any() or self.floor == 0.0:
            raise ValueError
        self.block = np.arange(len(self.times)) // 2  # neighbours overlap
        self._plain = self._logs(Correction())

    def seen(self, c: Correction) -> Correction:
        """Return what a correction comes to between odometry and reference."""
        return Correction(
            speed=c.speed,
            yaw_rate=c.yaw_rate,
            side=c.side,
            odometry_late_s=c.odometry_late_s - c.reference_late_s,
            odometry_arm_m=(c.odometry_arm_m[0] + c.reference_arm_m[0], c.odometry_arm_m[1] + c.reference_arm_m[1]),
            reference=c.reference,
            mirrored=c.mirrored,
        )

    def change(self, c: Correction) -> Floats:
        """Return by how much a correction as `seen` raises the log-likelihood (n,); NaN outside of the drive."""
        return self._logs(c) - self._plain

    def _logs(self, c: Correction) -> Floats:
        """Return the log-likelihood (n,) of each stretch after a correction as `seen`; NaN outside of the drive.

        In the reference's own units.
        """
        points = self.drive.poses(self.times + c.odometry_late_s, c, c.odometry_arm_m)[..., :2] / c.reference
        if c.mirrored:
            points = points[..., ::-1]
        a = points - points.mean(axis=1, keepdims=True)
        b = self.fixes - self.fixes.mean(axis=1, keepdims=True)
        dot = (a * b).sum(axis=(1, 2))
        cross = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
        square = (a**2 + b**2).sum(axis=(1, 2)) - 2.0 * np.hypot(dot, cross)  # after the best turn
        rms = np.sqrt(np.maximum(square, 0.0) / FIXES + self.floor**2)
        return np.asarray(-DEGREES_OF_FREEDOM * np.log(rms))


def stretches(travelled: Floats, length_m: float, fewest: int, points: int) -> Ints:
    """Return rows (n, points), spread evenly over overlapping stretches of a distance `travelled` (R,) in m, each about
    as long, at least `fewest` one after the other.

    Raises ValueError where the rows do not suffice.
    """
    count = int(np.clip(travelled[-1] / length_m, fewest, MOST))
    count = min(count, len(travelled) // points, int(travelled[-1] / SHORTEST_M))
    if count < 2 or travelled[-1] <= 0.0:
        raise ValueError
    first = np.linspace(0.0, travelled[-1] * (1.0 - 1.0 / count), 2 * count - 1)
    wanted = first[:, None] + np.linspace(0.0, travelled[-1] / count, points)
    rows = np.minimum(np.searchsorted(travelled, wanted), len(travelled) - 1)
    usable = (np.diff(rows, axis=1) > 0).sum(axis=1) >= points // 2
    if usable.sum() < 3:
        raise ValueError
    return np.asarray(rows[usable])
