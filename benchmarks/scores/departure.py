"""Whether an estimate is worth less than the odometry alone: by truth or reference, and where there is neither.

An estimator may correct the odometry by as much as the data sheet leaves open, and as it was uncertain itself. One that
goes on correcting by more follows something else: wrong associations, mirrored VTs, a data sheet that is not so.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 5.4.2:
the normalised innovation squared.
"""

from __future__ import annotations

import numpy as np

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.frames import mean_velocity, rotation
from cellslam.sim.recording import Floats, Recording

WINDOW_S = 10.0
TOO_FAR = 2.0  # root mean square from which a departure is said
PLANAR = [0, 1, 3]  # x, y and yaw of a pose
SMALLEST = 1e-12  # variance


def departure(recording: Recording, result: TrialResult) -> float:
    """Return by how many standard deviations an estimate moves otherwise than the odometry, root mean square.

    In windows of 10 s: along, across and yaw, over the root of the variance of the odometry's data sheet in the window
    and the covariance that the estimator claims at its beginning. Right ones have 1 or less. `recording` has the data
    sheet that the estimator was told. NaN for a recording of a single snapshot.
    """
    time, model = recording.time_s, recording.odometry_model
    dt_s = np.diff(time)
    if not len(dt_s):
        return float("nan")
    u = np.nan_to_num(recording.odometry[1:])
    more = ((mean_velocity(result.poses[:-1], result.poses[1:], dt_s) - u) * dt_s[:, None])[:, PLANAR]
    way = (np.abs(u) * dt_s[:, None])[:, PLANAR]
    edges = np.linspace(time[0], time[-1], max(round((time[-1] - time[0]) / WINDOW_S), 1) + 1)[:-1]
    first = np.unique(np.searchsorted(time, edges))
    lasts_s = np.add.reduceat(dt_s, first)[:, None]
    noise, bias, scale = (values[PLANAR] for values in (model.noise_density, model.bias, model.scale))
    variance = noise**2 * lasts_s + (bias * lasts_s) ** 2 + (scale * np.add.reduceat(way, first)) ** 2
    s = _in_body(result.poses[first], result.covariances[first]) + (variance + SMALLEST)[:, :, None] * np.eye(3)
    e = np.add.reduceat(more, first)
    return float(np.sqrt(np.mean(np.einsum("ni,nij,nj->n", e, np.linalg.inv(s), e)) / len(PLANAR)))


def _in_body(poses: Floats, covariances: Floats) -> Floats:
    """Return covariances (n, 3, 3) of x and y in the body frame, m, and yaw, rad, of such (n, 6, 6) in the world."""
    turn = np.zeros((len(poses), 3, 3))
    turn[:, :2, :2] = rotation(poses[:, 3], 0.0, 0.0)[:, :2, :2]
    turn[:, 2, 2] = 1.0
    return np.asarray(np.swapaxes(turn, 1, 2) @ covariances[:, PLANAR][:, :, PLANAR] @ turn)


def worse_than_odometry(recording: Recording, result: TrialResult, alone: TrialResult) -> list[str]:
    """Return lines that say why an estimate is not to be trusted; none where nothing speaks against it.

    `recording` has the data sheet that the estimator was told; `alone`: what dead reckoning makes of it.
    """
    out, name = [], result.estimator
    own, other = (score(recording, each, None)["position_rmse_m"] for each in (result, alone))
    if own is not None and other is not None and own > other:
        out.append(f"{name}: {own:.2f} m is worse than odometry alone, {other:.2f} m")
    away = departure(recording, result)
    if away > TOO_FAR:
        out.append(
            f"{name} departs from the odometry by {away:.1f} times what the data sheet and its own deviations allow: "
            "it is wrong, or the data sheet is too tight (--fit learns it)"
        )
    return out
