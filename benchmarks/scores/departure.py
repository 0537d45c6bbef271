"""Whether an estimate is worse than the odometry alone: by truth or reference, and where there is neither.

An estimator may correct the odometry by as much as the data sheet leaves open, and as it was uncertain itself. One that
goes on correcting by more follows something else: wrong associations, mirrored VTs, a data sheet that is not so.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 5.4.2:
the normalised innovation squared.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.frames import integrate_pose, wrap_angle
from cellslam.sim.recording import Floats, Recording

WINDOW_S = 10.0
TOO_FAR = 2.0  # root mean square from which a departure is reported
PLANAR = [0, 1, 3]  # x, y and yaw of a pose
SMALLEST = 1e-12  # variance
SAME_M = 1e-3  # positions that differ by no more were changed by nothing that was measured


def departure(recording: Recording, result: TrialResult) -> float:
    """Return by how many standard deviations an estimate moves otherwise than the odometry, root mean square.

    In windows of 10 s: x, y and yaw at the end, less what the odometry makes of the estimate at the beginning, over the
    root of what the claimed covariance becomes meanwhile by the data sheet. Right ones have 1 or less. `recording` has
    the data sheet that the estimator assumes. NaN for a recording of a single snapshot.
    """
    time = recording.time_s
    if len(time) < 2:
        return float("nan")
    edges = np.linspace(time[0], time[-1], max(round((time[-1] - time[0]) / WINDOW_S), 1) + 1)
    squares = []
    for first, last in pairwise(np.unique(np.searchsorted(time, edges)).tolist()):
        pose, s = _carried_on(recording, result.poses[first], result.covariances[first], first, last)
        e = (result.poses[last] - pose)[PLANAR]
        e[2] = wrap_angle(e[2])
        squares.append(e @ np.linalg.solve(s + SMALLEST * np.eye(3), e))
    return float(np.sqrt(np.mean(squares) / len(PLANAR)))


def _carried_on(recording: Recording, pose: Floats, covariance: Floats, first: int, last: int) -> tuple[Floats, Floats]:
    """Return the pose (6,) that the odometry leads to, from snapshot `first` to `last`, and the covariance (3, 3) of x,
    y (m) and yaw (rad) there, of which errors of white noise, bias and scale are part."""
    model, s = recording.odometry_model, covariance[np.ix_(PLANAR, PLANAR)]
    noise, bias, scale = (values[PLANAR] for values in (model.noise_density, model.bias, model.scale))
    by_bias = by_scale = np.zeros((3, 3))
    for t in range(first + 1, last + 1):
        dt_s, u = recording.time_s[t] - recording.time_s[t - 1], np.nan_to_num(recording.odometry[t])
        after = integrate_pose(pose, u, dt_s)
        c, s_ = np.cos(pose[3]), np.sin(pose[3])
        step = np.array([[1.0, 0.0, pose[1] - after[1]], [0.0, 1.0, after[0] - pose[0]], [0.0, 0.0, 1.0]])
        turned = np.array([[c, -s_, 0.0], [s_, c, 0.0], [0.0, 0.0, 1.0]])
        s = step @ s @ step.T + turned * (noise**2 * dt_s) @ turned.T
        by_bias, by_scale = step @ by_bias + turned * dt_s, step @ by_scale + turned * (u[PLANAR] * dt_s)
        pose = after
    return pose, s + by_bias * bias**2 @ by_bias.T + by_scale * scale**2 @ by_scale.T


def worse_than_odometry(
    recording: Recording, result: TrialResult, alone: TrialResult, fitted: bool = False
) -> list[str]:
    """Return lines that say why an estimate is not to be trusted; none where nothing speaks against it.

    `recording` has the data sheet that the estimator assumes, `fitted` if it was learnt from the recording; `alone`:
    what dead reckoning makes of it.
    """
    out, name = [], result.estimator
    if len(recording.time_s) > 1 and np.abs(result.poses - alone.poses)[:, :2].max() < SAME_M:
        why = _why_unchanged(recording, result)
        return [f"{name} is dead reckoning to the millimetre: the measurements changed nothing, since {why}"]
    own, other = (score(recording, each, None)["position_rmse_m"] for each in (result, alone))
    if own is not None and other is not None and own > other:
        out.append(f"{name}: {own:.2f} m is worse than odometry alone, {other:.2f} m")
    away = departure(recording, result)
    if away > TOO_FAR:
        learn = "" if fitted else " (--fit learns it)"
        out.append(
            f"{name} departs from the odometry by {away:.1f} times what the data sheet and its own deviations allow: "
            f"it is wrong, or the data sheet is too tight{learn}"
        )
    return out


def _why_unchanged(recording: Recording, result: TrialResult) -> str:
    """Return why the measurements of a drive changed nothing in an estimate, with the remedy."""
    m, model = recording.measurements, recording.odometry_model
    sheet = np.array([model.noise_density, model.bias, model.bias_walk_density, model.scale])[:, PLANAR]
    if not len(m):
        return "there are none"
    if not sheet.any():
        return "the odometry's data sheet says that it never errs: give its errors (noise.u_x, noise.u_psi)"
    clutter = 0 if result.association is None else int((result.association < 0).sum())
    if 2 * clutter > len(m):
        return f"it took {clutter} of {len(m)} for clutter: they err by more than it assumes, or are too few for a VT"
    return "they weigh nothing beside the odometry: its data sheet is too tight, or they are assumed far too inaccurate"
