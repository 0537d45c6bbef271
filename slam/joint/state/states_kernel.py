"""Compiled: the state of a joint filter: what comes and goes in it.

States before `core.size` are always there. The others enter as they are met and leave by exact marginalisation, the
last one taking the place of one that leaves: `owner` says whose each of them is, `vts.state` and `fields.state` where
they are. Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.state.layout import OF_VT, Filter
from cellslam.slam.model.arrays_kernel import put

SAME = 0.5  # deviations by which equally likely filters differ, or one stays


@lean
def enter(f: Filter, owner: int, variance: float) -> int:
    """Add an independent state of mean zero; return its index, -1 where the arrays are full."""
    n = f.size[0]
    if n == len(f.x):
        return -1
    f.x[n] = 0.0
    f.p[n, : n + 1] = 0.0
    f.p[: n + 1, n] = 0.0
    f.p[n, n] = variance
    f.particles.deviation[n] = 0.0
    f.size[0] = n + 1
    _index(f, n, owner)
    return int(n)


@part
def leave(f: Filter, index: int) -> None:
    """Take a state out; the last one takes its place."""
    last = f.size[0] - 1
    _index(f, -1, f.owner[index])
    if index != last:
        f.x[index] = f.x[last]
        put(f.p[index], f.p[last, :last])
        put(f.p[:, index], f.p[last, :last])
        f.p[index, index] = f.p[last, last]
        put(f.particles.deviation[index], f.particles.deviation[last])
        _index(f, index, f.owner[last])
    f.size[0] = last


@lean
def _index(f: Filter, index: int, owner: int) -> None:
    """Write down the index of the state of this owner, -1: there is none."""
    if index >= 0:
        f.owner[index] = owner
    if owner >= 0:
        f.fields.state[owner] = index
    elif owner <= OF_VT:
        k = OF_VT - owner
        f.vts.state[k // f.vts.state.shape[1], k % f.vts.state.shape[1]] = index


@lean
def owner_of(j: int, coordinate: int, width: int) -> int:
    """Return the owner's number of a coordinate of VT j, of `width` each."""
    return OF_VT - (j * width + coordinate)


@lean
def fade(f: Filter, index: int, kept: float, variance: float) -> None:
    """Let a Gauss-Markov state keep this share of itself; `variance`: what it has in the long run."""
    n = f.size[0]
    for i in range(n):
        f.p[index, i] *= kept
    for i in range(n):
        f.p[i, index] *= kept
    f.p[index, index] += (1.0 - kept * kept) * variance
    f.x[index] *= kept
    for c in range(len(f.particles.weight)):
        f.particles.deviation[index, c] *= kept


@lean
def covariance_of(f: Filter, i: int, j: int) -> float:
    """Return the covariance of two states: that which particles share, and that of their means, if there are any."""
    total, a, b = 0.0, f.particles.deviation[i], f.particles.deviation[j]
    for c in range(len(f.particles.weight)):
        total += f.particles.weight[c] * a[c] * b[c]
    return float(f.p[i, j] + total)


@njit(cache=True)
def differing(x: Floats, p: Floats, log_odds: Floats, likely: Ints) -> Ints:
    """Return those of the filters `likely`, the likeliest first, whose states differ from those of all before them.

    Of the K filters x (K, n) are means, p (K, n, n) covariances, log_odds (K,) those between them. What is unlikely
    adds little to the mixture, and must differ by more: by SAME deviations times the root of 1 + its log-odds.
    """
    kept, found = np.empty(len(likely), np.int64), 0
    for i in likely:
        double = False
        for j in kept[:found]:
            most2 = SAME * SAME * (1.0 + log_odds[j] - log_odds[i])
            double = double or _same(x[i], x[j], p[i], p[j], most2)
        if not double:
            kept[found] = i
            found += 1
    return kept[:found]


@lean
def _same(x: Floats, y: Floats, p: Floats, q: Floats, most2: float) -> bool:
    same = True
    for c in range(len(x)):
        same = same and (x[c] - y[c]) ** 2 <= most2 * max(min(p[c, c], q[c, c]), 0.0)
    return same
