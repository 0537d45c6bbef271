"""From weighted particles to an Estimate: moments of pose and clock offsets, and the map of the heaviest particle."""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import VtEstimate
from cellslam.slam.fastslam.map_kernel import map_into
from cellslam.slam.fastslam.particles import Particles

_PLANAR = [0, 1, 3]


def pose_moments(particles: Particles, weights: Floats) -> tuple[Floats, Floats]:
    """Return mean (6,) and covariance (6, 6) of the pose: spread of the particles plus what each leaves
    marginalised."""
    mean = weights @ particles.pose
    centred = particles.pose - mean
    covariance = (centred * weights[:, None]).T @ centred
    g = particles.pose_g.reshape(-1, 3, 2)
    inner = g @ particles.cov[:, -2:, -2:] @ np.swapaxes(g, 1, 2)
    covariance[np.ix_(_PLANAR, _PLANAR)] += np.tensordot(weights, inner, axes=1)
    return mean, covariance


def offset_moments(particles: Particles, weights: Floats, sites: int) -> tuple[Floats, Floats]:
    """Return mean and variance (S,) of the clock offsets."""
    theta = particles.theta[:, :sites]
    mean = weights @ theta
    within = weights @ np.diagonal(particles.cov, axis1=1, axis2=2)[:, :sites]
    return mean, within + weights @ (theta - mean) ** 2


def map_of(particles: Particles, index: int, site_of: Ints, hits: int) -> VtEstimate:
    """Return the VTs of one particle that were detected at least `hits` times, in the world frame."""
    total = int(particles.counts[index].sum())
    out_id, out_link = np.empty(total, np.int64), np.empty(total, np.int64)
    position, covariance = np.empty((total, 3)), np.empty((total, 3, 3))
    live = map_into(
        particles.records[index], particles.counts[index], particles.theta[index], particles.cov[index], site_of,
        float(hits),
        out_id, out_link, position, covariance,
    )  # fmt: skip
    return VtEstimate(out_id[:live], out_link[:live], position[:live], covariance[:live])
