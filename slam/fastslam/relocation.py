"""Where a vehicle may be that was put down anywhere in a remembered map: a Gaussian sum over its start pose.

The start N(m, diag(sigma^2)) of x, y and yaw is too wide for one linearisation, so it is a sum of components of width
s, and the first snapshot tells which of them may be:

    p(r)       = sum_k exp(l_k) N(r; m_k, diag(s^2))
    l_k       += sum_i log(c + P_D sum_v N(z_i; h(m_k, v), S_iv))
    S_iv       = R_i + H diag(s^2) H^T + H P_v H^T,    of each of distance, azimuth and elevation alone; of a distance d
                 (sigma_k d)^2 besides, for the scale k of range
    z_i        measurements of the snapshot, R_i its variances;  c  density of clutter, and of VTs not in the map
    v          VTs of the map on the measurement's link that were seen from near m_k, P_v their covariances

The likeliest components are the groups of particles with which the filter begins. Their weights are those of the
prior: the filter uses the first snapshot, too.

Sources: Sorenson and Alspach, "Recursive Bayesian estimation using Gaussian sums", Automatica 7, 1971; Thrun, Fox,
Burgard and Dellaert, "Robust Monte Carlo localization for mobile robots", Artificial Intelligence 128, 2001, for poses
by measurements.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats
from cellslam.slam.joint.map_states import REACH_M, Remembered
from cellslam.slam.joint.start import REACH, components
from cellslam.slam.joint.state.layout import Measured
from cellslam.slam.model.measurement_model import predict

PLANE = np.array([0, 1, 3])  # x, y and yaw of a pose
DETECTED = 0.5  # probability that a VT is detected which was detected from there before
AT_A_TIME = 1000  # components, so that memory is bounded


def components_of_pose(std: Floats, widths: Floats, step: float) -> tuple[Floats, Floats, Floats]:
    """Return offsets (K, 3) from the mean of x, y (m) and yaw (rad), log-weights (K,) and deviations (3,) of the
    components of N(0, diag(std^2)), std and widths (3,), whose centres are a `step` of their widths apart."""
    axes = [components(float(one), float(width), step) for one, width in zip(std, widths, strict=True)]
    offsets, log_weights = (
        np.stack(np.meshgrid(*(axis[part] for axis in axes), indexing="ij"), axis=-1).reshape(-1, 3) for part in (0, 1)
    )
    log_weight = log_weights.sum(axis=1)
    kept = (np.abs(offsets[:, 2]) <= np.pi) & (log_weight >= log_weight.max() - REACH**2 / 2.0)
    return offsets[kept], log_weight[kept], np.array([axis[2] for axis in axes])


def log_likelihood(
    poses: Floats, std: Floats, offset_m: Floats, range_scale_std: float, remembered: Remembered, measured: Measured
) -> Floats:
    """Return the log-likelihood (K,) of a snapshot from poses (K, 6) that are as uncertain as `std` (3,) says, with
    clock offsets (S,) in m and a scale of range of this deviation."""
    parts = [
        _log_likelihood(poses[k : k + AT_A_TIME], std, offset_m, range_scale_std, remembered, measured)
        for k in range(0, len(poses), AT_A_TIME)
    ]
    return np.concatenate(parts)


def _log_likelihood(
    poses: Floats, std: Floats, offset_m: Floats, range_scale_std: float, remembered: Remembered, measured: Measured
) -> Floats:
    known, total = remembered.known, np.zeros(len(poses))
    low, high = np.swapaxes(known.seen_m, 0, 1)
    spread2 = np.trace(known.covariance_m2, axis1=1, axis2=2) / 3.0
    for link, (start, stop) in enumerate(zip(measured.first[:-1], measured.first[1:], strict=True)):
        here = np.flatnonzero(remembered.link == link)
        z = measured.z[start:stop] - [offset_m[measured.site_of[link]], 0.0, 0.0]
        variance = measured.noise.single[start:stop]
        if start == stop:
            continue
        place = poses[:, None, :2]
        away = np.maximum(np.maximum(low[here] - place, place - high[here]), 0.0).max(axis=2, initial=0.0)  # (K, v)
        h = predict(poses[:, None], known.position_m[here])  # (K, v, 3)
        flat2 = (h[..., 0] * np.cos(h[..., 2])) ** 2
        moved2 = max(std[0], std[1]) ** 2 + spread2[here]
        of_pose = np.stack(
            [moved2 + (range_scale_std * h[..., 0]) ** 2, moved2 / flat2 + std[2] ** 2, moved2 / h[..., 0] ** 2],
            axis=-1,
        )
        e = z[None, None] - h[:, :, None]  # (K, v, m, 3)
        e[..., 1] = wrap_angle(e[..., 1])
        s = variance + of_pose[:, :, None]
        there = np.isfinite(z)
        logs = np.where(there, -0.5 * (e * e / s + np.log(2.0 * np.pi * s)), 0.0).sum(axis=-1)
        density = np.where(away[..., None] <= REACH_M, DETECTED * np.exp(logs), 0.0).sum(axis=1)  # (K, m)
        clutter = np.exp(measured.rules.association.log_clutter + measured.gap[start:stop])
        total += np.log(clutter + density).sum(axis=1)
    return total
