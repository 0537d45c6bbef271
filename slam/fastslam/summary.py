"""From weighted particles to an Estimate: moments of pose and clock offsets, and the map of the heaviest particle."""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import VtEstimate
from cellslam.slam.fastslam.layout import LANES, POSE, POSE_G, THETA
from cellslam.slam.fastslam.map_kernel import map_into
from cellslam.slam.fastslam.particles import Particles

_PLANAR = [0, 1, 3]
_CONFIRMED = 3


def pose_moments(particles: Particles, weights: Floats) -> tuple[Floats, Floats]:
    """Return mean (6,) and covariance (6, 6) of the pose: spread of the particles plus what each leaves
    marginalised."""
    k = particles.nuisances
    pose = particles.columns(POSE, 6)
    mean = weights @ pose
    centred = pose - mean
    covariance = (centred * weights[:, None]).T @ centred
    g = particles.columns(POSE_G, 6).reshape(-1, 3, 2)
    p = particles.columns(THETA + k, k * k).reshape(-1, k, k)[:, -2:, -2:]
    covariance[np.ix_(_PLANAR, _PLANAR)] += np.tensordot(weights, g @ p @ np.swapaxes(g, 1, 2), axes=1)
    return mean, covariance


def offset_moments(particles: Particles, weights: Floats) -> tuple[Floats, Floats]:
    """Return mean and variance (S,) of the clock offsets."""
    k = particles.nuisances
    theta = particles.columns(THETA, k - 2)
    mean = weights @ theta
    within = weights @ particles.columns(THETA + k, k * k)[:, : (k + 1) * (k - 2) : k + 1]
    return mean, within + weights @ (theta - mean) ** 2


def map_of(particles: Particles, index: int, site_of: Ints) -> VtEstimate:
    """Return the confirmed VTs of one particle, in the world frame."""
    block, lane = divmod(index, LANES)
    p = particles
    total = int(p.counts[block].sum())
    out_id, out_link = np.empty(total, np.int64), np.empty(total, np.int64)
    position, covariance = np.empty((total, 3)), np.empty((total, 3, 3))
    live = map_into(
        lane, _CONFIRMED, p.state[block], p.status[block], p.records[block], p.ident[block], p.order[block],
        p.counts[block],
        site_of, out_id, out_link, position, covariance,
    )  # fmt: skip
    return VtEstimate(out_id[:live], out_link[:live], position[:live], covariance[:live])
