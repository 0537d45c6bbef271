"""Parts of one's own for each slot of FastSLAM: copy what you need, change it, and name it `my_parts:NAME`.

cellslam run tiny --set 'estimator.fastslam.association="my_parts:joint_compatibility"'
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import qmc
from scipy.special import ndtri

from cellslam.slam.fastslam.parts import NO_VT, likelihood


def least_distance(candidates):
    """Association: the assignment with the least sum of Mahalanobis distances, whatever the likelihoods are.

    Given are V candidates and m measurements of one site: `candidates.distance2` (V, m) is infinite outside the gate.
    Returned is the row of `candidates` for each measurement (m,), or NO_VT.
    """
    cost = np.where(np.isfinite(candidates.distance2), candidates.distance2, 1e6)
    rows, columns = linear_sum_assignment(cost)
    chosen = np.full(cost.shape[1], NO_VT)
    inside = cost[rows, columns] < 1e6
    chosen[columns[inside]] = rows[inside]
    return chosen


def never_twice(candidates, candidate_of):
    """Birth: a measurement without a VT begins one, but not while a VT that was detected once is a candidate."""
    return (candidate_of < 0) & (not (candidates.detections == 1).any())


def quasi_random(mean, covariance, rng):
    """Proposal: draws of a Sobol sequence, spread more evenly than independent ones.

    `mean` (d, N) and `covariance` (d, d) are those of the odometry's noise in a block, given all measurements up to the
    end of the block. Returned are the draws (d, N), and the logarithm of target over proposal density (N,): zero here,
    since the draws are of the target.
    """
    d, N = mean.shape
    uniform = qmc.Sobol(d, seed=rng).random_base2(int(np.ceil(np.log2(max(N, 2)))))[:N].T
    normal = ndtri(np.clip(uniform, 1e-9, 1.0 - 1e-9))
    value, vector = np.linalg.eigh(covariance)
    return mean + (vector * np.sqrt(np.maximum(value, 0.0))) @ normal, np.zeros(N)


def half_gain(G, W):
    """Update: half of what the Kalman gain would move the particles by, as a filter does that mistrusts its model.

    `G` (k, n) and `W` (k, N) stand for M <- M + G^T W and P <- P - G^T G: here P shrinks as the Kalman filter says.
    """
    return G, 0.5 * W


class Annealed:
    """Weight: a likelihood whose power grows from block to block, from 0.2 to 1."""

    def __init__(self):
        self.power = 0.2

    def __call__(self, W):
        """Return the log-likelihood (N,) of the particles, given their whitened innovations W (k, N)."""
        self.power = min(1.01 * self.power, 1.0)
        return self.power * likelihood(W)


def two_minutes(vts):
    """Pruning: every VT that was not seen for two minutes is dropped, confirmed or not."""
    return vts.unseen_s > 120.0


def best_half(weights, count, rng):
    """Resampling: copies of the better half of the particles, each as often as the others. It is biased: a bad idea."""
    better = np.argsort(weights)[len(weights) // 2 :]
    return np.sort(np.resize(better, count))
