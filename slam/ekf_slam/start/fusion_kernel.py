"""Compiled: Gaussians multiplied, what they share counted once; moments of a Gaussian sum; which components stay.

Sources: Grime and Durrant-Whyte, "Data fusion in decentralized sensor networks", Control Engineering Practice 2(5),
1994 (what is shared is divided out); Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum
approximations", IEEE Trans. Automatic Control 17(4), 1972 (the sum).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints

LEAST_SHARE = 1e-14  # of the largest variance, below which there is none left but rounding
SMALLEST = 1e-10  # share of the largest scaled variance below which a direction counts as known
DOUBLE = 0.25  # components closer than this, in deviations of the likelier one, are one


@njit(cache=True)
def root_of(cov: Floats) -> tuple[Floats, Floats]:
    """Return L (n, r) with cov = L L^T, in the directions that are uncertain, and its left inverse (r, n).

    cov (n, n), any units: states are scaled by their deviations first.
    """
    n = len(cov)
    scale, scaled = np.empty(n), np.empty((n, n))
    for i in range(n):
        scale[i] = math.sqrt(cov[i, i]) if cov[i, i] > 0.0 else 1.0
    for i in range(n):
        for j in range(n):
            scaled[i, j] = cov[i, j] / (scale[i] * scale[j])
    values, basis = np.linalg.eigh(scaled)
    kept = np.flatnonzero(values > SMALLEST * max(values[-1], SMALLEST))
    root, left = np.empty((n, len(kept))), np.empty((len(kept), n))
    for k, which in enumerate(kept):
        spread = math.sqrt(values[which])
        for i in range(n):
            root[i, k] = scale[i] * basis[i, which] * spread
            left[k, i] = basis[i, which] / (spread * scale[i])
    return root, left


@njit(cache=True)
def fuse(mean: Floats, cov: Floats, means: Floats, covs: Floats) -> tuple[Floats, Floats]:
    """Return the product of the odometry's belief (n,), (n, n) and what each site's, (S, n) and (S, n, n), adds to it.

    In the units of the states. Negative information is cut off.
    """
    root, left = root_of(cov)
    rank = root.shape[1]
    matrix, vector = np.eye(rank), np.zeros(rank)
    for s in range(len(means)):
        values, axes = np.linalg.eigh(left @ np.ascontiguousarray(covs[s]) @ left.T)
        most = max(values[-1], 0.0) if rank > 0 else 0.0
        shift = left @ (means[s] - mean)
        for k in range(rank):
            if values[k] < 1.0 and values[k] > LEAST_SHARE * most:
                axis = np.ascontiguousarray(axes[:, k])
                told = 0.0
                for i in range(rank):
                    told += axis[i] * shift[i]
                for i in range(rank):
                    vector[i] += axis[i] * told / values[k]
                    for j in range(rank):
                        matrix[i, j] += axis[i] * axis[j] * (1.0 / values[k] - 1.0)
    spread = root @ np.linalg.inv(matrix) @ root.T
    return mean + root @ np.linalg.solve(matrix, vector), 0.5 * (spread + spread.T)


@njit(cache=True)
def moments(log_weight: Floats, x: Floats, p: Floats, first: int, n: int) -> tuple[Floats, Floats]:
    """Return mean (n,) and covariance (n, n) of the states from `first` on of a Gaussian sum x (K, N), p (K, N, N).

    log_weight (K,): log-weights of its components. Results are in the units of the states.
    """
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    mean, cov = np.zeros(n), np.zeros((n, n))
    for k in range(len(weight)):
        for i in range(n):
            mean[i] += weight[k] * x[k, first + i]
    for k in range(len(weight)):
        for i in range(n):
            apart = x[k, first + i] - mean[i]
            for j in range(n):
                cov[i, j] += weight[k] * (p[k, first + i, first + j] + apart * (x[k, first + j] - mean[j]))
    return mean, cov


@njit(cache=True)
def likely(log_weight: Floats, x: Floats, p: Floats, state: int, least: float) -> Ints:
    """Return which components (n,) of K to keep, by index: not less likely than the best by `least`, and no double of a
    more likely one in the given state.

    log_weight (K,); x (K, N) and p (K, N, N) in the units of the states; `least`: a log, below 0.
    """
    best, kept = log_weight.max(), np.zeros(len(log_weight), np.bool_)
    for i in np.argsort(-log_weight, kind="mergesort"):
        if log_weight[i] - best < least:
            break
        kept[i] = True
        for k in np.flatnonzero(kept):
            if k != i and abs(x[i, state] - x[k, state]) < DOUBLE * math.sqrt(p[i, state, state]):
                kept[i] = False
                break
    return np.flatnonzero(kept)
