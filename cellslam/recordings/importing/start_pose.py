"""The start pose of a recording that does not say where it starts, from its reference and its odometry.

The first stretch of odometry is laid onto the fixes by generalised least squares. What both get wrong for long weighs
as such: fixes step by a metre when satellites come and go, and stay so; a turn that the yaw rate misses turns all that
follows. Least squares without it bends the stretch until it fits such a step.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cellslam.benchmarks.scores.alignment import rigid
from cellslam.benchmarks.scores.reference_fixes import outlying
from cellslam.recordings.importing.odometry import Motion, integrate
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Reference

FIRST_PATH_M = 60.0  # the heading is fitted over so much of the path
LEAST_FIXES, MOST_FIXES = 5, 100
# Deviations of wheels, gyros and GNSS in general: a campaign's own data sheet may be wrong.
YAW_RATE_BIAS_RADPS, YAW_RATE_SCALE, SPEED_SCALE = 0.01, 0.05, 0.05
YAW_NOISE, PLACE_NOISE = 0.01, 0.1  # rad, m; each times root second
YAW_STD = math.radians(1.0)  # of a heading that a reference reports
FIX_LASTS_S, FIX_WHITE_SHARE = 20.0, 0.1
FIX_STDS_M = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)  # of satellites; then down to those of cameras
STEPS, SMALL = 6, 1e-4


def start_from_reference(motion: Motion | None, reference: Reference, time_s: float) -> tuple[Floats, Floats]:
    """Return the pose (6,) at `time_s` and its deviations (6,): as the reference says, or so that the first 60 m of
    odometry fit it best.

    Height, pitch and roll are zero where the reference does not know them. Raises InputError where it does not reach
    back to the start.
    """
    known = np.isfinite(reference.position_m[:, :2]).all(axis=1) & ~outlying(reference)
    fixes, times, std = reference.position_m[known], reference.time_s[known], reference.position_std_m[known]
    if not len(times) or times[-1] < time_s:
        raise InputError("the reference has no position at or after the first snapshot: give the start pose instead")
    x, y, z = (np.interp(time_s, times, fixes[:, i]) for i in range(3))
    yaw = reference.yaw_rad[known]
    if np.isfinite(yaw).all():
        psi, place_std = np.interp(time_s, times, np.unwrap(yaw)), np.nan_to_num(np.interp(time_s, times, std))
        deviations = np.array([place_std, place_std, YAW_STD])
    elif motion is None:
        raise InputError("the reference has no heading and there is no odometry: give the start pose")
    else:
        first = _first_stretch(motion, times, time_s)
        (x, y, psi), deviations = fitted_start(motion, times[first], fixes[first, :2], std[first], time_s)
    std_x, std_y, std_psi = deviations
    return np.array([x, y, np.nan_to_num(z), psi, 0.0, 0.0]), np.array([std_x, std_y, 0.0, std_psi, 0.0, 0.0])


def _first_stretch(motion: Motion, times: Floats, time_s: float) -> slice:
    """Return the fixes after `time_s` that lie on the first FIRST_PATH_M of the path, not more than MOST_FIXES."""
    begin = int(np.searchsorted(times, time_s, side="right"))
    poses, _ = integrate(motion, np.insert(times[begin:], 0, time_s), np.zeros(6))
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])[1:]
    count = min(max(int(np.searchsorted(travelled, FIRST_PATH_M)), LEAST_FIXES), len(travelled))
    if len(travelled) < LEAST_FIXES or travelled[count - 1] < 1.0:
        raise InputError(
            "the reference has too few positions while the vehicle moves to tell its heading: give the start pose"
        )
    return slice(begin, begin + count, -(-count // MOST_FIXES))


def fitted_start(motion: Motion, times: Floats, fixes: Floats, std_m: Floats, time_s: float) -> tuple[Floats, Floats]:
    """Return x, y in m and yaw in rad (3,) at `time_s` that lay odometry best onto fixes (N, 2) at times (N,) in s with
    deviations (N,) in m, NaN: not known; and the deviations (3,) of the start.

    Found together with a bias and scale of the yaw rate and a scale of the speed by Gauss-Newton steps on the posterior
    in which the odometry's noise adds up and the errors of fixes fade over FIX_LASTS_S. Where deviations of fixes are
    not known, a first fit takes those of satellites, and what it leaves says which are likeliest.
    """
    stretch = np.insert(times, 0, time_s)
    prior = np.array([0.0, 0.0, 0.0, YAW_RATE_BIAS_RADPS**-2, YAW_RATE_SCALE**-2, SPEED_SCALE**-2])

    def drive(state: Floats) -> Floats:
        """Return the dead-reckoned poses (N + 1, 6) for x, y, yaw, yaw-rate bias and scale, speed scale (6,)."""
        x, y, psi, bias, turn_scale, speed_scale = state
        factor = 1.0 + np.array([speed_scale, speed_scale, 0.0, turn_scale, 0.0, 0.0])
        velocity = motion.velocity * factor + np.array([0.0, 0.0, 0.0, bias, 0.0, 0.0])
        return integrate(replace(motion, velocity=velocity), stretch, np.array([x, y, 0.0, psi, 0.0, 0.0]))[0]

    def covariance(poses: Floats, unknown_m: float) -> Floats:
        return _covariance(stretch, poses, np.where(np.isfinite(std_m), std_m, unknown_m))

    def fit(state: Floats, unknown_m: float) -> tuple[Floats, Floats]:
        """Return the state (6,) after some steps, and its information (6, 6)."""
        for _ in range(STEPS):
            poses = drive(state)
            slope = np.stack([(drive(state + step) - poses)[1:, :2] / SMALL for step in SMALL * np.eye(6)], axis=-1)
            slope = slope.reshape(-1, 6)
            weighted = np.linalg.solve(covariance(poses, unknown_m), slope).T
            information = weighted @ slope + np.diag(prior)
            rest = (fixes - poses[1:, :2]).ravel()
            state = state + np.linalg.solve(information, weighted @ rest - prior * state)
        return state, information

    angle, shift = rigid(drive(np.zeros(6))[1:, :2], fixes)
    state, information = fit(np.array([*shift, angle, 0.0, 0.0, 0.0]), FIX_STDS_M[0])
    if not np.isfinite(std_m).all():
        poses = drive(state)
        rest = (fixes - poses[1:, :2]).ravel()

        def deviance(unknown_m: float) -> float:
            """Return -2 log of the likelihood of what is left, but for a constant."""
            size = covariance(poses, unknown_m)
            return float(np.linalg.slogdet(size)[1] + rest @ np.linalg.solve(size, rest))

        state, information = fit(state, min(FIX_STDS_M, key=deviance))
    return state[:3], np.sqrt(np.diag(np.linalg.inv(information))[:3])


def _covariance(times: Floats, poses: Floats, std_m: Floats) -> Floats:
    """Return the covariance (2N, 2N) in m^2 of fixes minus dead-reckoned places at times[1:], both x and y."""
    dt, places, count = np.diff(times), poses[:, :2], len(times) - 1
    # A turn in an interval swings all later places about the one where it happened.
    arm = places[1:, None] - places[None, :-1]
    swing = np.stack([-arm[..., 1], arm[..., 0]], axis=1) * np.tri(count)[:, None]
    swing = (swing * YAW_NOISE * np.sqrt(dt)).reshape(2 * count, count)
    moved = PLACE_NOISE**2 * (np.minimum.outer(times[1:], times[1:]) - times[0])
    apart = np.abs(np.subtract.outer(times[1:], times[1:]))
    lasting = np.outer(std_m, std_m) * np.exp(-apart / FIX_LASTS_S)
    alone = np.diag((FIX_WHITE_SHARE * std_m) ** 2)
    covariance: Floats = swing @ swing.T + np.kron(moved + lasting + alone, np.eye(2))
    return covariance
