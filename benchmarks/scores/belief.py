"""How good a claimed Gaussian is against the error that there was: proper scores, coverage, protection levels.

Of the horizontal position, with error e (2,) and claimed covariance P (2, 2):

    squared        q = e^T P^-1 e: chi-square of two degrees of freedom where the claim is right (NEES)
    ellipse        u = 1 - exp(-q / 2): the probability claimed for the ellipse through the truth; where the claim is
                   right it is uniform (the probability integral transform, PIT)               `claimed_probability`
    log score      log det(2 pi P) / 2 + q / 2, in nats                                        `log_score`
    energy score   E |X - e| - E |X - X'| / 2 with X, X' ~ N(0, P), in m. As |x| = pi / 2 times the mean of |n x| over
                   directions n, it is pi / 2 times the mean of the CRPS of n e           `energy_score`
    radius         r with Pr(|X| > r) = risk: the protection level                             `Claim.radius`

Both scores are proper: in the mean none but the right claim has the least. The radius may be that of a claim that was
widened: X is then Student's t of `freedom` degrees of freedom with the scale matrix `scale`^2 P.

Sources: Gneiting and Raftery, "Strictly proper scoring rules, prediction, and estimation", J. American Statistical
Association 102, 2007 (scores; CRPS of a Gaussian: equation 21); DeCleene, "Defining pseudorange integrity:
overbounding", ION GPS 2000.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import erf, ndtr, stdtrit

from cellslam.sim.recording import Floats

LEVELS = (0.5, 0.9, 0.95, 0.99)  # claimed probabilities whose coverage is scored
DIRECTIONS = 16  # of the energy score: its error is below 1e-3 of it for axes of 1 to 10
ANGLES, RATIOS, HALVINGS = 128, 129, 60
SMALLEST_VARIANCE_M2 = 1e-12


@dataclass(frozen=True)
class Claim:
    """How a claimed covariance is read: as Gaussian, or widened by `scale` and with the tails of Student's t."""

    scale: float = 1.0
    freedom: float = math.inf

    def beyond(self, squared: Floats) -> Floats:
        """Return the probability (n,) that the normalised squared error is more than `squared` (n,)."""
        q = np.asarray(squared) / self.scale**2
        return np.exp(-q / 2.0) if math.isinf(self.freedom) else (1.0 + q / self.freedom) ** (-self.freedom / 2.0)

    def radius(self, covariance: Floats, risk: float) -> Floats:
        """Return the radius (n,) in m that the horizontal error exceeds with probability `risk`, of P (n, 2, 2)."""
        mean = (covariance[:, 0, 0] + covariance[:, 1, 1]) / 2.0
        apart = np.hypot((covariance[:, 0, 0] - covariance[:, 1, 1]) / 2.0, covariance[:, 0, 1])
        major, minor = mean + apart, np.maximum(mean - apart, 0.0)
        flat = np.sqrt(minor / np.where(major > 0.0, major, 1.0))
        grid, radii = _radii(self.freedom, risk)
        return np.asarray(self.scale * np.sqrt(major) * np.interp(flat, grid, radii))

    def half_width(self, variance: Floats, risk: float) -> Floats:
        """Return what the size of one component's error exceeds with probability `risk` (n,), of variances (n,)."""
        return np.asarray(self.scale * np.sqrt(variance) * -stdtrit(self.freedom, risk / 2.0))


AS_CLAIMED = Claim()


@lru_cache(maxsize=32)
def _radii(freedom: float, risk: float) -> tuple[Floats, Floats]:
    """Return ratios (k,) of the axes of an ellipse, and its radius (k,) where the longer one is 1.

    X = R (cos a, ratio sin a), where a is uniform and R is beyond r with the probability of `Claim.beyond`.
    """
    ratio = np.linspace(0.0, 1.0, RATIOS)
    angle = (np.arange(ANGLES) + 0.5) * (np.pi / 2.0 / ANGLES)
    along = np.cos(angle) ** 2 + (ratio[:, None] * np.sin(angle)) ** 2
    claim, low, high = Claim(1.0, freedom), np.zeros(RATIOS), np.full(RATIOS, 1e12)
    for _ in range(HALVINGS):
        middle = np.where(high < 1e3, (low + high) / 2.0, np.sqrt(np.maximum(low, 1e-6) * high))
        above = claim.beyond(middle[:, None] ** 2 / along).mean(axis=1) > risk
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return ratio, high


def squared_error(error: Floats, covariance: Floats) -> Floats:
    """Return e^T P^-1 e (n,) of errors (n, 2) and covariances (n, 2, 2), NaN where P has no inverse.

    Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, 5.4.2.
    """
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = xx * yy - xy * xy
    # The smaller eigenvalue is at least determinant / trace.
    regular = determinant > SMALLEST_VARIANCE_M2 * np.abs(xx + yy)
    quadratic = yy * error[:, 0] ** 2 - 2.0 * xy * error[:, 0] * error[:, 1] + xx * error[:, 1] ** 2
    return np.where(regular, quadratic / np.where(regular, determinant, 1.0), np.nan)


def claimed_probability(squared: Any) -> Floats:
    """Return the probability (n,) that is claimed for the ellipse through the truth, of `squared` (n,)."""
    return np.asarray(-np.expm1(-np.asarray(squared) / 2.0))


def ratio(error: Any, variance: Any) -> Floats:
    """Return sizes of errors (...) over their claimed deviations; NaN where it is claimed that there is none."""
    std = np.sqrt(np.maximum(variance, 0.0))
    return np.asarray(np.divide(np.abs(error), std, out=np.full(np.shape(std), np.nan), where=std > 0.0))


def two_sided(ratio: Floats) -> Floats:
    """Return the probability (n,) claimed for the interval up to the truth, of errors over deviations (n,)."""
    return np.asarray(erf(np.asarray(ratio) / math.sqrt(2.0)))


def log_score(error: Floats, covariance: Floats) -> Floats:
    """Return the log score (n,) in nats of claims (n, 2, 2) on errors (n, 2) in m; NaN where P has no inverse."""
    squared = squared_error(error, covariance)
    determinant = covariance[:, 0, 0] * covariance[:, 1, 1] - covariance[:, 0, 1] ** 2
    known = np.where(np.isfinite(squared), determinant, 1.0)
    return np.asarray(math.log(2.0 * math.pi) + np.log(known) / 2.0 + squared / 2.0)


def energy_score(error: Floats, covariance: Floats) -> Floats:
    """Return the energy score (n,) in m of claims (n, 2, 2), which have an inverse, on errors (n, 2) in m."""
    angle = np.arange(DIRECTIONS) * (np.pi / DIRECTIONS)
    n = np.stack([np.cos(angle), np.sin(angle)])
    std = np.sqrt(np.einsum("ik,tij,jk->tk", n, covariance, n))
    z = error @ n / std
    density = np.exp(-(z**2) / 2.0) / math.sqrt(2.0 * math.pi)
    crps = std * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / math.sqrt(math.pi))
    return np.asarray(np.pi / 2.0 * crps.mean(axis=1))
