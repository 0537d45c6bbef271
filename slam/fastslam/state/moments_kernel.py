"""Compiled: mean and covariance of what the particles hold.

Sources: Kong, Liu and Wong, "Sequential imputations and Bayesian missing data problems", J. American Statistical
Association 89, 1994 (effective sample size); Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking
and navigation", 2001, section 1.4 (moments of a mixture).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats
from cellslam.slam.fastslam.state.layout import LANES, POSE, POSE_G, THETA

B = LANES


@njit(cache=True)
def normalised(log_weight: Floats) -> tuple[Floats, int, float]:
    """Return weights (G, LANES) that sum to 1, the place of the greatest, and their effective sample size."""
    weights = np.empty_like(log_weight)
    flat, logs = weights.ravel(), log_weight.ravel()
    best = np.argmax(logs)
    total, squares = 0.0, 0.0
    for i in range(len(flat)):
        flat[i] = math.exp(logs[i] - logs[best])
        total += flat[i]
        squares += flat[i] * flat[i]
    for i in range(len(flat)):
        flat[i] /= total
    return weights, int(best), total * total / squares


@njit(cache=True)
def moments(state: Floats, weights: Floats, size: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return mean (6,) and covariance (6, 6) of the pose, mean and variance (S,) of the offsets of weighted particles.

    state (G, F LANES); weights (G, LANES) sum to 1; size: number of nuisances. Sums run in a fixed order, about the
    first particle; angles are wrapped to (-pi, pi]. In m, rad and their squares.
    """
    sites = size - 2
    mean, covariance, offset, variance = np.empty(6), np.empty((6, 6)), np.empty(sites), np.empty(sites)
    square, spread = np.zeros((6, 6)), np.zeros((3, 3))
    centre, offset_centre = np.empty(6), np.empty(sites)
    for c in range(6):
        centre[c] = state[0, (POSE + c) * B]
    for site in range(sites):
        offset_centre[site] = state[0, (THETA + site) * B]
    sums = np.zeros((33 + 2 * sites) * B)
    for g in range(state.shape[0]):
        _add_block(state[g], weights[g], size, centre, offset_centre, sums)
    row = 0
    for r in range(6):
        mean[r] = _total(sums, 27 + r)
        for c in range(r + 1):
            square[r, c] = _total(sums, row)
            row += 1
    for r in range(3):
        for c in range(r + 1):
            spread[r, c] = _total(sums, row)
            row += 1
    for site in range(sites):
        offset[site], variance[site] = _total(sums, 33 + 2 * site), _total(sums, 34 + 2 * site)
    for r in range(6):
        for c in range(r + 1):
            covariance[r, c] = covariance[c, r] = square[r, c] - mean[r] * mean[c]
    places = (0, 1, 3)
    for r in range(3):
        for c in range(r + 1):
            covariance[places[r], places[c]] += spread[r, c]
            if r != c:
                covariance[places[c], places[r]] += spread[r, c]
    for c in range(6):
        mean[c] += centre[c]
        if c > 2:
            mean[c] -= 2.0 * math.pi * math.ceil((mean[c] - math.pi) / (2.0 * math.pi))
    for site in range(sites):
        variance[site] -= offset[site] ** 2
        offset[site] += offset_centre[site]
    return mean, covariance, offset, variance


@njit(cache=True)
def _total(sums: Floats, row: int) -> float:
    """Return the sum of a row."""
    total = 0.0
    for l in range(B):
        total += sums[row * B + l]
    return total


@njit(cache=True, error_model="numpy")
def _add_block(s: Floats, weights: Floats, size: int, centre: Floats, offset_centre: Floats, sums: Floats) -> None:
    """Add one block, lane by lane: rows are 21 second moments of the pose, 6 of what is marginalised, 6 means, and
    mean and second moment of each offset."""
    last = size - 2
    cov = (THETA + size) * B
    bias, cross = cov + (last * size + last) * B, cov + (last * size + last + 1) * B
    scale = cov + ((last + 1) * size + last + 1) * B
    row = 0
    for r in range(6):
        i = (POSE + r) * B
        for l in range(B):
            sums[(27 + r) * B + l] += weights[l] * (s[i + l] - centre[r])
        for c in range(r + 1):
            j = (POSE + c) * B
            for l in range(B):
                sums[row * B + l] += weights[l] * (s[i + l] - centre[r]) * (s[j + l] - centre[c])
            row += 1
    for r in range(3):
        for c in range(r + 1):
            i, j = (POSE_G + 2 * r) * B, (POSE_G + 2 * c) * B
            for l in range(B):
                rb, rs, cb, cs = s[i + l], s[i + B + l], s[j + l], s[j + B + l]
                value = rb * s[bias + l] * cb + rs * s[scale + l] * cs + (rb * cs + rs * cb) * s[cross + l]
                sums[row * B + l] += weights[l] * value
            row += 1
    for site in range(last):
        i, j = (THETA + site) * B, cov + (site * size + site) * B
        for l in range(B):
            d = s[i + l] - offset_centre[site]
            sums[(33 + 2 * site) * B + l] += weights[l] * d
            sums[(34 + 2 * site) * B + l] += weights[l] * (d * d + s[j + l])
