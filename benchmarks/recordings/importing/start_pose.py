"""The start pose of a recording that does not say where it starts, from its reference and its odometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellslam.benchmarks.recordings.importing.odometry_resampling import Motion, at_array, integrate
from cellslam.benchmarks.scores.alignment import rigid
from cellslam.benchmarks.scores.reference_fixes import outlying
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Reference

FIRST_PATH_M = 60.0  # the heading is fitted over so much of the way
LEAST_FIXES = 5
# A gyro or steering bias bends the first stretch: the heading is fitted for each of these, and the best taken.
BIASES_RADPS = np.linspace(-0.02, 0.02, 41)
BIAS_STD_RADPS = 0.01


def start_from_reference(motion: Motion | None, reference: Reference, time_s: float) -> Floats:
    """Return the pose (6,) at `time_s`: as the reference says, or so that the first 60 m of odometry, freed
    from a constant error of the yaw rate, fit it best.

    Height, pitch and roll are zero where the reference does not know them. Raises InputError where it does not reach
    back to the start.
    """
    known = np.isfinite(reference.position_m[:, :2]).all(axis=1) & ~outlying(reference)
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
    times, fixes = times[:count], fixes[:count, :2]
    fits = []
    for bias in BIASES_RADPS if motion.measured[3] else (0.0,):
        points = _driven(motion, np.insert(times, 0, time_s), float(bias))
        angle, shift = rigid(points, fixes)
        c, s = np.cos(angle), np.sin(angle)
        rest = fixes - shift - points @ np.array([[c, s], [-s, c]])
        fits.append((float((rest**2).sum(axis=1).mean()), float(bias), angle, *shift))
    noise = max(min(fit[0] for fit in fits), 1e-4)
    _, _, angle, x, y = min(fits, key=lambda fit: len(times) * fit[0] / noise + (fit[1] / BIAS_STD_RADPS) ** 2)
    return np.array([x, y, height_m, angle, 0.0, 0.0])


def _driven(motion: Motion, times: Floats, bias_radps: float) -> Floats:
    """Return the positions (N, 2) at times[1:] from the origin, with a yaw rate lower by `bias_radps`."""
    freed = replace(motion, velocity=motion.velocity - np.array([0.0, 0.0, 0.0, bias_radps, 0.0, 0.0]))
    return integrate(freed, times, np.zeros(6))[0][1:, :2]
