"""Resampling schemes: plain functions, normalised weights (N,) in, ancestor indices (count,) out, sorted.

Sources: Douc, Cappe and Moulines, "Comparison of resampling schemes for particle filtering" (2005); systematic:
Kitagawa (1996).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellslam.sim.recording import Floats, Ints


def systematic(weights: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Return ancestors (count,) by one uniform draw and `count` equally spaced points: least variance of the schemes
    here.

    weights (N,).
    """
    return _inverse(weights, (np.arange(count) + rng.random()) / count)


def stratified(weights: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Return ancestors (count,) by one uniform draw in each of `count` equal strata; weights (N,)."""
    return _inverse(weights, (np.arange(count) + rng.random(count)) / count)


def multinomial(weights: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Return ancestors (count,) by independent draws, sorted; weights (N,)."""
    return _inverse(weights, np.sort(rng.random(count)))


def residual(weights: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Return ancestors (count,): the integer part of count * weight copies of each, the rest by multinomial draws.

    weights (N,).
    """
    copies = np.floor(count * weights).astype(np.int64)
    rest = count - int(copies.sum())
    if rest > 0:
        left = count * weights - copies
        copies += np.bincount(multinomial(left / left.sum(), rest, rng), minlength=len(weights))
    return np.repeat(np.arange(len(weights)), copies)


SCHEMES: dict[str, Callable[[Floats, int, np.random.Generator], Ints]] = {
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
    "multinomial": multinomial,
}


def _inverse(weights: Floats, points: Floats) -> Ints:
    cumulative = np.cumsum(weights)
    cumulative[-1] = np.inf
    return np.searchsorted(cumulative, points, side="right").astype(np.int64)
