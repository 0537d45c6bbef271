"""The start pose of a recording that does not say where it starts, from its reference and its odometry."""

from __future__ import annotations

import numpy as np

from cellslam.benchmarks.recordings.resample import Motion, at_array, integrate
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Reference

FIRST_PATH_M = 30.0  # the heading is fitted over so much of the way
LEAST_FIXES = 5


def start_from_reference(motion: Motion | None, reference: Reference, time_s: float) -> Floats:
    """Return the pose (6,) at `time_s`: as the reference says, or so that the first 30 m of odometry fit it best.

    Height, pitch and roll are zero where the reference does not know them. Raises InputError where it does not reach
    back to the start.
    """
    known = np.isfinite(reference.position_m[:, :2]).all(axis=1)
    fixes, times = reference.position_m[known], reference.time_s[known]
    if not len(times) or times[-1] < time_s:
        raise InputError("the reference has no position at or after the first snapshot: give the start pose instead")
    at_start = [np.interp(time_s, times, fixes[:, i]) for i in range(3)]
    yaw = reference.yaw_rad[known]
    if np.isfinite(yaw).all():
        return np.array([*np.nan_to_num(at_start), np.interp(time_s, times, np.unwrap(yaw)), 0.0, 0.0])
    if motion is None:
        raise InputError("the reference has no heading and there is no odometry: give the start pose")
    return _fitted(at_array(motion), fixes, times, time_s, float(np.nan_to_num(at_start[2])))


def _fitted(motion: Motion, fixes: Floats, times: Floats, time_s: float, height_m: float) -> Floats:
    later = times > time_s
    fixes, times = fixes[later], times[later]
    poses, _ = integrate(motion, np.insert(times, 0, time_s), np.zeros(6))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])[1:]
    count = max(int(np.searchsorted(way, FIRST_PATH_M)), LEAST_FIXES)
    if len(times) < LEAST_FIXES or way[min(count, len(way)) - 1] < 1.0:
        raise InputError(
            "the reference has too few positions while the vehicle moves to tell its heading: give the start pose"
        )
    angle, shift = rigid(poses[1 : count + 1, :2], fixes[:count, :2])
    return np.array([*shift, height_m, angle, 0.0, 0.0])


def rigid(points: Floats, onto: Floats) -> tuple[float, Floats]:
    """Return angle and shift (2,) of the rigid motion in the plane that takes points (N, 2) best onto others.

    Source: S. Umeyama, Least-squares estimation of transformation parameters, 1991, in two dimensions without scale.
    """
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    angle = float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))
    c, s = np.cos(angle), np.sin(angle)
    return angle, onto.mean(axis=0) - np.array([[c, -s], [s, c]]) @ points.mean(axis=0)
