"""How well distances alone, each link one beacon, and a trajectory tell the same places of the beacons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellslam.recordings.inspection.corrections import Correction, Drive
from cellslam.recordings.inspection.reference_evidence import stretches
from cellslam.sim.recording import Floats, Recording

ODOMETRY_M, REFERENCE_M = 60.0, 200.0  # stretches of the path from which a beacon is placed: odometry drifts
RANGES, FEWEST = 24, 3
PATHS = 1.25  # a link has hardly more than one path a snapshot
TURNS, ROUNDS = 4, 8
KEPT = 0.8  # the best of the residuals: the others may be anything
FLOOR = 0.005  # of the distance
WORTH = 12.0  # of a stretch's residuals: half of their number


class RangeEvidence:
    """Log-likelihood of distances over stretches of the path, given odometry or reference; its place is free."""

    def __init__(self, recording: Recording, drive: Drive, fixes: tuple[Floats, Floats] | None) -> None:
        """`fixes`: times (R,) and positions (R, 2) of the reference; None: odometry. Raises ValueError if too few."""
        m, self.drive, self.fixes = recording.measurements, drive, fixes
        self.name = "ranges" if fixes is None else "places"
        rows = np.flatnonzero(~np.isnan(m.distance_m))
        at, links = m.snapshot[rows], m.link[rows]
        if not len(rows) or len(rows) > PATHS * len(np.unique(at * len(recording.links) + links)):
            raise ValueError
        known = recording.sites.clock_offset_std_m == 0.0
        if not known.all():
            raise ValueError
        times = recording.time_s[at]
        here = self._points(times, Correction())
        if fixes is not None:
            gap = 3.0 * float(np.median(np.diff(fixes[0])))
            near = np.searchsorted(fixes[0], times).clip(1, len(fixes[0]) - 1)
            times = np.where(fixes[0][near] - fixes[0][near - 1] <= gap, times, np.nan)
        usable = np.isfinite(here).all(axis=1) & np.isfinite(times)
        step = np.hypot(*np.diff(here[usable], axis=0).T)
        travelled = np.full(len(rows), np.nan)
        travelled[usable] = np.concatenate([[0.0], np.cumsum(step)])
        length = ODOMETRY_M if fixes is None else REFERENCE_M
        chosen = []
        for link in range(len(recording.links)):
            mine = np.flatnonzero((links == link) & usable)
            if len(mine) >= 3 * RANGES:
                chosen.append(mine[stretches(travelled[mine] - travelled[mine[0]], length, FEWEST, RANGES)])
        if not chosen:
            raise ValueError
        pick = np.concatenate(chosen)
        mean = recording.sites.clock_offset_mean_m[recording.links.site[links[pick]]]
        self.times, self.distance = times[pick], m.distance_m[rows][pick] - mean
        self.floor = FLOOR * float(np.median(self.distance)) + 0.02
        self.block = np.arange(len(pick)) // 2  # neighbours overlap
        self._plain = self._logs(Correction())

    def seen(self, c: Correction) -> Correction:
        """Return what a correction comes to between distances and the trajectory."""
        mine = Correction(distance=c.distance, distance_zero_m=c.distance_zero_m)
        if self.fixes is not None:
            return replace(mine, reference=c.reference, reference_late_s=c.reference_late_s - c.measurements_late_s)
        return replace(
            mine,
            speed=c.speed,
            yaw_rate=c.yaw_rate,
            side=c.side,
            odometry_late_s=c.odometry_late_s - c.measurements_late_s,
            odometry_arm_m=(c.odometry_arm_m[0] + c.array_arm_m[0], c.odometry_arm_m[1] + c.array_arm_m[1]),
        )

    def change(self, c: Correction) -> Floats:
        """Return by how much a correction as `seen` raises the log-likelihood (n,); NaN outside of the drive."""
        return self._logs(c) - self._plain

    def _logs(self, c: Correction) -> Floats:
        """Return the log-likelihood (n,) of each stretch of a link's distances after a correction as `seen`.

        In units as recorded; NaN outside of the drive.
        """
        points = self._points(self.times, c)
        inside = np.isfinite(points).all(axis=(1, 2))
        rest = np.full(len(points), np.nan)
        distance = self.distance[inside] * c.distance + c.distance_zero_m
        rest[inside] = _rest(points[inside], distance)
        return np.asarray(-WORTH * np.log(np.hypot(rest / c.distance, self.floor)))

    def _points(self, times: Floats, c: Correction) -> Floats:
        if self.fixes is None:
            return self.drive.poses(times + c.odometry_late_s, c, c.odometry_arm_m)[..., :2]
        stamps, places = self.fixes
        when = times + c.reference_late_s
        inside = (when >= stamps[0]) & (when <= stamps[-1])
        return c.reference * np.stack([np.where(inside, np.interp(when, stamps, p), np.nan) for p in places.T], axis=-1)


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
