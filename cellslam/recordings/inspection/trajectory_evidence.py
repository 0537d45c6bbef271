"""How well two tables tell the same trajectory, stretch by stretch.

`ReferenceEvidence` lays stretches of reference and odometry onto each other. `RangeEvidence` takes each link as one
beacon: its place is fitted to the distances measured along a stretch of odometry or reference.
"""

from __future__ import annotations

import numpy as np

from cellslam.recordings.inspection.corrections import Correction, Drive, Fixes
from cellslam.sim.recording import Floats, Ints, Recording

STRETCH_M = 30.0  # of the path, for one comparison
FEWEST, MOST = 16, 80  # stretches
SHORTEST_M = 2.0
FIXES = 6  # of a stretch
DEGREES_OF_FREEDOM = 5.0  # of their residuals, which are not independent
FLOOR = 0.01  # of a stretch: nobody's odometry agrees better than so

ODOMETRY_M, REFERENCE_M = 60.0, 200.0  # stretches of the path from which a beacon is placed: odometry drifts
RANGES, FEWEST_OF_RANGES = 24, 3
PATHS = 1.25  # a link has hardly more than one path a snapshot
TURNS, ROUNDS = 4, 8
KEPT = 0.8  # the best of the residuals: the others may be anything
RANGE_FLOOR = 0.005  # of the distance
RANGE_DEGREES_OF_FREEDOM = 12.0  # of a stretch's residuals: half of their number


class ReferenceEvidence:
    """Log-likelihood of stretches of the reference, given the odometry: a rigid motion of each is free.

    A stretch's scale of residuals is free as well: an outlier spoils no more than its own stretch.
    """

    name = "reference and odometry"

    def __init__(self, drive: Drive, fixes: Fixes) -> None:
        """Raise ValueError where the fixes are too few."""
        self.drive, times, position_m = drive, fixes.time_s, fixes.position_m
        here = drive.places(times, Correction())
        travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(here, axis=0).T))])
        chosen = _stretches(travelled, STRETCH_M, FEWEST, FIXES)
        self.times, self.fixes = times[chosen], position_m[chosen]
        size = np.hypot(*(self.fixes.max(axis=1) - self.fixes.min(axis=1)).T)
        moving = size > 0.3 * np.median(size)
        self.times, self.fixes, self.floor = self.times[moving], self.fixes[moving], FLOOR * float(np.median(size))
        if not moving.any() or self.floor == 0.0:
            raise ValueError
        self.block = np.arange(len(self.times)) // 2  # neighbours overlap
        self._plain = self._logs(Correction())

    def effect_of(self, c: Correction) -> Correction:
        """Return what a correction comes to between odometry and reference."""
        return c.effect("odometry", "reference", ("reference", "mirrored"))

    def change(self, c: Correction) -> Floats:
        """Return by how much an effect raises the log-likelihood (n,); NaN outside of the drive."""
        return self._logs(c) - self._plain

    def _logs(self, c: Correction) -> Floats:
        """Return the log-likelihood (n,) of each stretch after an effect; NaN outside of the drive.

        In the reference's own units.
        """
        points = self.drive.places(self.times, c) / c.reference
        if c.mirrored:
            points = points[..., ::-1]
        a = points - points.mean(axis=1, keepdims=True)
        b = self.fixes - self.fixes.mean(axis=1, keepdims=True)
        dot = (a * b).sum(axis=(1, 2))
        cross = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
        square = (a**2 + b**2).sum(axis=(1, 2)) - 2.0 * np.hypot(dot, cross)  # after the best turn
        rms = np.sqrt(np.maximum(square, 0.0) / FIXES + self.floor**2)
        return np.asarray(-DEGREES_OF_FREEDOM * np.log(rms))


def _stretches(travelled: Floats, length_m: float, fewest: int, points: int) -> Ints:
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


class RangeEvidence:
    """Log-likelihood of distances over stretches of the path, given odometry or reference; its place is free."""

    def __init__(self, recording: Recording, motion: Drive | Fixes) -> None:
        """Raise ValueError where ranges or fixes are too few."""
        m, self.motion = recording.measurements, motion
        self.name = f"distances and {motion.table}"
        rows = np.flatnonzero(~np.isnan(m.distance_m))
        at, links = m.snapshot[rows], m.link[rows]
        if not len(rows) or len(rows) > PATHS * len(np.unique(at * len(recording.links) + links)):
            raise ValueError
        known = recording.sites.clock_offset_std_m == 0.0
        if not known.all():
            raise ValueError
        times = recording.time_s[at]
        here = motion.places(times, Correction())
        if isinstance(motion, Fixes):
            times = np.where(motion.known(times), times, np.nan)
        usable = np.isfinite(here).all(axis=1) & np.isfinite(times)
        step = np.hypot(*np.diff(here[usable], axis=0).T)
        travelled = np.full(len(rows), np.nan)
        travelled[usable] = np.concatenate([[0.0], np.cumsum(step)])
        length = REFERENCE_M if isinstance(motion, Fixes) else ODOMETRY_M
        chosen = []
        for link in range(len(recording.links)):
            mine = np.flatnonzero((links == link) & usable)
            if len(mine) >= 3 * RANGES:
                chosen.append(mine[_stretches(travelled[mine] - travelled[mine[0]], length, FEWEST_OF_RANGES, RANGES)])
        if not chosen:
            raise ValueError
        pick = np.concatenate(chosen)
        mean = recording.sites.clock_offset_mean_m[recording.links.site[links[pick]]]
        self.times, self.distance = times[pick], m.distance_m[rows][pick] - mean
        self.floor = RANGE_FLOOR * float(np.median(self.distance)) + 0.02
        self.block = np.arange(len(pick)) // 2  # neighbours overlap
        self._plain = self._logs(Correction())

    def effect_of(self, c: Correction) -> Correction:
        """Return what a correction comes to between distances and the trajectory."""
        return c.effect(self.motion.table, "measurements", ("distance", "distance_zero_m"))

    def change(self, c: Correction) -> Floats:
        """Return by how much an effect raises the log-likelihood (n,); NaN outside of the drive."""
        return self._logs(c) - self._plain

    def _logs(self, c: Correction) -> Floats:
        """Return the log-likelihood (n,) of each stretch of a link's distances after an effect.

        In units as recorded; NaN outside of the drive.
        """
        points = self.motion.places(self.times, c)
        inside = np.isfinite(points).all(axis=(1, 2))
        rest = np.full(len(points), np.nan)
        distance = self.distance[inside] * c.distance + c.distance_zero_m
        rest[inside] = _rest(points[inside], distance)
        return np.asarray(-RANGE_DEGREES_OF_FREEDOM * np.log(np.hypot(rest / c.distance, self.floor)))


def _rest(points: Floats, distance: Floats) -> Floats:
    """Return the root mean square (n,) of what distances (n, R) from points (n, R, 2) leave, the beacon best placed."""
    angle = 2.0 * np.pi * np.arange(TURNS) / TURNS
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    reach = np.abs(distance).mean(axis=1)
    place = points.mean(axis=1)[:, None] + reach[:, None, None] * ring  # (n, TURNS, 2)
    keep = int(KEPT * distance.shape[1])
    weight = np.ones(())
    for _ in range(ROUNDS):
        away = place[:, :, None] - points[:, None]
        length = np.maximum(np.hypot(away[..., 0], away[..., 1]), 1e-6)
        unit, error = away / length[..., None], length - distance[:, None]
        scale = np.median(np.abs(error), axis=-1, keepdims=True) + 1e-9
        weight = 1.0 / (1.0 + (error / (3.0 * scale)) ** 2)
        xx = (weight * unit[..., 0] ** 2).sum(-1) + 1e-3
        yy = (weight * unit[..., 1] ** 2).sum(-1) + 1e-3
        xy = (weight * unit[..., 0] * unit[..., 1]).sum(-1)
        gx, gy = (weight * unit[..., 0] * error).sum(-1), (weight * unit[..., 1] * error).sum(-1)
        step = np.stack([yy * gx - xy * gy, xx * gy - xy * gx], axis=-1) / (xx * yy - xy * xy)[..., None]
        size = np.hypot(step[..., 0], step[..., 1])[..., None]
        place = place - step * np.minimum(1.0, 0.5 * reach[:, None, None] / np.maximum(size, 1e-9))
    away = place[:, :, None] - points[:, None]
    error = np.sort((np.hypot(away[..., 0], away[..., 1]) - distance[:, None]) ** 2, axis=-1)[..., :keep]
    return np.asarray(np.sqrt(error.mean(axis=-1)).min(axis=1))
