"""Compiled steps of the bound's recursion, which change their arrays (the equations: `cramer_rao`).

Of arrays with capacity for N states the first n are those that are there: P (N, N) is the covariance and m (N,) the
error of the mean of the states divided by their scale s (N,). `index` (K,) has the row of each state, -1: it is not
there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.arrays_kernel import downdate

SMALLEST_SCALE = 1e-6  # s of a state: before it is smaller P takes it over, or 1 / s^2 would drown the rest
ROUNDING = 1e-14  # of a matrix's trace, that its eigenvalues can be wrong by


class Sparse(NamedTuple):
    """A matrix of r rows: row i has `load` (e,) on the states `state` (e,), entries begin[i] up to begin[i + 1]."""

    begin: Ints
    state: Ints
    load: Floats


class Components(NamedTuple):
    """The k measured components of a drive; snapshot t has begin[t]:begin[t + 1].

    Row i of H is row `row[i]` of the views, and `load` (k,) on a state `own` (k,), -1: none. `std` (k,): of the white
    error; `residual` (k,): measured less predicted at the truth.
    """

    begin: Ints
    row: Ints
    own: Ints
    load: Floats
    std: Floats
    residual: Floats


@njit(cache=True)
def predict(P: Floats, m: Floats, s: Floats, F: Floats, Q: Floats, jump: Floats, a: Floats) -> None:
    """Let the core move by F, Q and `jump`, and the n states fade by their factors `a` (n,)."""
    core, n = len(F), len(a)
    rows, mean = np.zeros((core, n)), jump.copy()
    for i in range(core):
        for j in range(core):
            if F[i, j] != 0.0:
                mean[i] += F[i, j] * m[j]
                for x in range(n):
                    rows[i, x] += F[i, j] * P[j, x]
    block = rows[:, :core].copy() @ F.T.copy() + Q
    m[:core] = mean
    for i in range(core):
        rows[i, :core] = block[i]
        P[i, :n], P[:n, i] = rows[i], rows[i]
    s[:n] *= a
    if s[:n].min() < SMALLEST_SCALE:
        for i in range(n):
            P[i, :n] *= s[i] * s[:n]
        m[:n] *= s[:n]
        s[:n] = 1.0
    for i in range(n):
        P[i, i] += (1.0 - a[i] ** 2) / s[i] ** 2


@njit(cache=True)
def times(H: Components, t: int, views: Sparse, index: Ints, s: Floats, x: Floats, width: int) -> Floats:
    """Return H x (k, width) of snapshot t for the first columns of x (n, width); a state that is not there is zero."""
    low, high = H.begin[t], H.begin[t + 1]
    first, last = H.row[low] // 3 * 3, H.row[high - 1] // 3 * 3 + 3
    shared, out = np.zeros((last - first, width)), np.zeros((high - low, width))  # ports share what they see
    for r in range(first, last):
        row = shared[r - first]
        for e in range(views.begin[r], views.begin[r + 1]):
            at = index[views.state[e]]
            if at >= 0:
                load, other = views.load[e] * s[at], x[at]
                for j in range(width):
                    row[j] += load * other[j]
    for i in range(low, high):
        row, view = out[i - low], shared[H.row[i] - first]
        for j in range(width):
            row[j] = view[j]
        if H.own[i] >= 0:
            at = index[H.own[i]]
            load, other = H.load[i] * s[at], x[at]
            for j in range(width):
                row[j] += load * other[j]
    return out


@njit(cache=True)
def update(P: Floats, m: Floats, n: int, H: Components, t: int, views: Sparse, index: Ints, s: Floats) -> None:
    """Take the measured components of snapshot t in.

    H, residual and S are divided by the roots of R: S is 1 + H P H^T, whose eigenvalues are 1 or more, but for what the
    largest of them is rounded by. So much is added before S = L L^T.
    """
    low, k = H.begin[t], H.begin[t + 1] - H.begin[t]
    std = H.std[low : low + k].reshape((k, 1))
    G = np.empty((k + 3, n))  # with three rows more, as `downdate` asks
    G[:k] = times(H, t, views, index, s, P, n) / std
    L = times(H, t, views, index, s, G[:k].T.copy(), k) / std
    y = (H.residual[low : low + k] - times(H, t, views, index, s, m.reshape((len(m), 1)), 1)[:, 0]) / std[:, 0]
    rounded = ROUNDING * np.trace(L)
    for i in range(k):
        L[i, i] += 1.0 + rounded
        for j in range(i + 1):
            for x in range(j):
                L[i, j] -= L[i, x] * L[j, x]
            L[i, j] = L[i, j] / L[j, j] if j < i else np.sqrt(L[i, i])
        for j in range(i):
            y[i] -= L[i, j] * y[j]
            for x in range(n):
                G[i, x] -= L[i, j] * G[j, x]
        y[i] /= L[i, i]
        for x in range(n):
            G[i, x] /= L[i, i]
            m[x] += y[i] * G[i, x]
    downdate(P, n, G, k)


@njit(cache=True)
def keep(P: Floats, m: Floats, s: Floats, states: Ints, kept: Ints) -> None:
    """Leave only the states of the rows `kept` (k,), which ascend."""
    for i in range(len(kept)):
        of = kept[i]
        m[i], s[i], states[i] = m[of], s[of], states[of]
        for j in range(len(kept)):
            P[i, j] = P[of, kept[j]]
