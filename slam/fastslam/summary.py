"""From weighted particles to an Estimate: moments of pose and clock offsets, and the map of the heaviest particle."""

from __future__ import annotations

import numpy as np
from numba import njit

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import VtEstimate
from cellslam.slam.fastslam.layout import BIAS0, GAIN, HITS, IDENTITY, OFFSET0, SCALE0, SIGMA
from cellslam.slam.fastslam.particles import Particles
from cellslam.slam.fastslam.predict_kernel import position_into

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
    live = _map_into(
        particles.records[index], particles.counts[index], particles.theta[index], particles.cov[index], site_of,
        float(hits),
        out_id, out_link, position, covariance,
    )  # fmt: skip
    return VtEstimate(out_id[:live], out_link[:live], position[:live], covariance[:live])


@njit(cache=True)
def _map_into(records, counts, theta, cov, site_of, hits, out_id, out_link, position, covariance):  # type:
ignore[no-untyped-def]
    """Write confirmed VTs of one particle: x = x(mu), cov = J (Sigma + G P G^T) J^T; return their number."""
    n = 0
    sites = theta.shape[0] - 2
    jacobian = np.empty((3, 3))
    inner = np.empty((3, 3))
    gain = np.empty((3, 3))
    block = np.empty((3, 3))
    for link in range(counts.shape[0]):
        index = (site_of[link], sites, sites + 1)
        for r in range(3):
            for c in range(3):
                block[r, c] = cov[index[r], index[c]]
        for j in range(counts[link]):
            vt = records[link, j]
            if vt[HITS] < hits:
                continue
            db, dg, ds = (
                theta[index[0]] - vt[OFFSET0],
                theta[sites] - vt[BIAS0],
                theta[sites + 1] - vt[SCALE0],
            )
            position_into(position[n], jacobian, vt, db, dg, ds)
            for r in range(3):
                for c in range(3):
                    gain[r, c] = vt[GAIN + 3 * r + c]
            inner[:, :] = gain @ block @ gain.T
            k = 0
            for r in range(3):
                for c in range(r, 3):
                    inner[r, c] += vt[SIGMA + k]
                    if c > r:
                        inner[c, r] += vt[SIGMA + k]
                    k += 1
            covariance[n] = jacobian @ inner @ jacobian.T
            out_id[n], out_link[n] = int(vt[IDENTITY]), link
            n += 1
    return n
