"""Mean and covariance of mixtures: of Gaussians, and of weighted poses.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 1.4
(moments of a mixture).
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats


def pose_moments(poses: Floats, weights: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Return mean (6,) and covariance (6, 6) of poses (N, 6), in m and rad, with weights (N,) that sum to 1.

    Angles are averaged as differences, wrapped to (-pi, pi], from those of the pose `centre` (6,), one that is likely.
    """
    mean = weights @ poses
    mean[3:] = centre[3:] + weights @ wrap_angle(poses[:, 3:] - centre[3:])
    centred = np.concatenate([poses[:, :3] - mean[:3], wrap_angle(poses[:, 3:] - mean[3:])], axis=1)
    mean[3:] = wrap_angle(mean[3:])
    return mean, (centred * weights[:, None]).T @ centred


def mixture_moments(weight: Floats, x: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Return mean (n,) and covariance (n, n) of a mixture of K Gaussians: weights (K,) that sum to 1, means (K, n),
    covariances (K, n, n). Angles must not wrap between the means."""
    mean = weight @ x
    apart = x - mean
    return mean, np.einsum("k,kij->ij", weight, p) + (apart * weight[:, None]).T @ apart
