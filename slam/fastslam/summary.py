"""From weighted particles to an Estimate: moments of pose and clock offsets, and the map of the heaviest particle."""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import VtEstimate
from cellslam.slam.fastslam.layout import LANES
from cellslam.slam.fastslam.map_kernel import map_into
from cellslam.slam.fastslam.moments_kernel import moments
from cellslam.slam.fastslam.particles import Particles
from cellslam.slam.fastslam.parts import Parts
from cellslam.slam.fastslam.tracks_kernel import CONFIRMED


def belief(particles: Particles, weights: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return mean (6,) and covariance (6, 6) of the pose, mean and variance (S,) of the clock offsets.

    Covariances: the spread of the particles plus what each leaves marginalised. weights (N,): sum to 1.
    """
    sites = particles.nuisances - 2
    mean, covariance = np.zeros(6), np.zeros((6, 6))
    offset, variance = np.zeros(sites), np.zeros(sites)
    moments(particles.state, weights.reshape(-1, LANES), particles.nuisances, mean, covariance, offset, variance)
    return mean, covariance, offset, variance


def map_of(particles: Particles, index: int, parts: Parts, site_of: Ints, link_of: Ints, origin: Floats) -> VtEstimate:
    """Return the confirmed VTs of one particle, in the world frame; `origin` (3,): where the filter's lies.

    site_of, link_of: site of each map, and the link that its VTs are reported for.
    """
    block, lane = divmod(index, LANES)
    p = particles
    total = int(p.counts[block].sum())
    out_id, out_link = np.empty(total, np.int64), np.empty(total, np.int64)
    position, covariance = np.empty((total, 3)), np.empty((total, 3, 3))
    live = map_into(parts)(
        parts, lane, CONFIRMED, p.nuisances, p.state[block], p.status[block], p.records[block], p.ident[block],
        p.order[block], p.counts[block], site_of, link_of, out_id, out_link, position, covariance,
    )  # fmt: skip
    return VtEstimate(out_id[:live], out_link[:live], position[:live] + origin, covariance[:live])
