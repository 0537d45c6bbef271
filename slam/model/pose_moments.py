"""Mean and covariance of mixtures: of Gaussians, and of weighted poses; covariance of what several estimates know.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 1.4
(moments of a mixture); Grime and Durrant-Whyte, "Data fusion in decentralized sensor networks", Control Engineering
Practice 2, 1994 (estimates that have something in common).
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats

TINY = 1e-9  # a variance, or a share of one, that is none


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


def known_together(p: Floats, prior: Floats) -> Floats:
    """Return the covariance (n, n) of what K estimates know together, of covariances p (K, n, n), each from a prior
    (n, n) that is the same, and from measurements that are not.

    The information of each beyond the prior's is added up: (prior^-1 + sum of (p^-1 - prior^-1))^-1. Where an estimate
    knows less than the prior, what it lacks counts for one part in K: so the sum stays positive, and one estimate alone
    keeps its own covariance.
    """
    jitter = TINY * np.eye(len(prior))
    root = np.linalg.cholesky(prior + jitter)
    whiten = np.linalg.inv(root)
    share, axes = np.linalg.eigh(whiten @ (p + jitter) @ whiten.T)  # of the prior's variance, what is left of it
    gain = 1.0 / np.maximum(share, TINY) - 1.0
    gain = np.where(gain < 0.0, gain / len(p), gain)
    information = np.eye(len(prior)) + np.einsum("kij,kj,klj->il", axes, gain, axes)
    return np.asarray(root @ np.linalg.inv(information) @ root.T)
