"""Compiled: VTs whose direction or distance was not measured: several guesses, of which time leaves one.

A lone distance begins VTs around the circle, a lone direction begins VTs at distances that double, all of them with one
identity and a share of the probability each: a Gaussian sum for one VT. While guesses are left, measurements correct
them and their shares, but not the pose or the clock offset, which are considered only: whatever a wrong guess would
teach does no harm. Guesses that agree become one, and the last one is a VT like any other.

Sources: Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE Trans. Automatic
Control 17(4), 1972; Sola et al., "Undelayed initialization in bearing only SLAM", IROS 2005 (distances that grow
geometrically); Schmidt, "Application of state-space methods to navigation problems", 1966 (considered states).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.frames_kernel import TURN, wrap
from cellslam.sim.recording import Floats
from cellslam.slam.ekf_slam.map_kernel import add, remove
from cellslam.slam.ekf_slam.state_layout import HITS, IDENT, LAST, LINK, SHARE, Filter, Scratch, same_vt, states
from cellslam.slam.ekf_slam.update_kernel import LOG_2PI, blank, expect, innovate, log_likelihood, update
from cellslam.slam.model.downdate_kernel import downdate
from cellslam.slam.model.matrices_kernel import Vec3, cholesky, solved

AROUND, AHEAD = 10, 7  # guesses of an azimuth, of a distance
NEAREST_M, FARTHER = 15.0, 2.0  # first distance, ratio of one to the next
WIDTH = 0.5  # deviation of a guess, in distances of neighbours
LEAST = 1e-3  # share below which a guess is given up
AGREE = 0.5  # guesses this close, in their deviations, are one


@njit(cache=True)
def possible(z: Floats, b: float) -> bool:
    """Return whether a VT can begin with a measurement z (3,): its distance, its azimuth or both are known.

    A distance must be 1 m beyond the clock offset b (m).
    """
    return z[0] - b > 1.0 or (math.isnan(z[0]) and not math.isnan(z[1]))


@njit(cache=True)
def begin(f: Filter, now: int, confirm: int, link: int, offset: int, ident: int, z: Floats, q: Floats) -> None:
    """Give birth to a VT, or to its guesses.

    z, q (3,): measurement in m and rad, and its variances; elevation is there, or its prior.
    """
    ranged = not math.isnan(z[0])
    whole = ranged and not math.isnan(z[1])
    guesses = 1 if whole else (AROUND if ranged else AHEAD)
    guess, wide = z.copy(), q.copy()
    for n in range(guesses):
        if not ranged:
            guess[0] = NEAREST_M * FARTHER**n
            wide[0] = (WIDTH * math.log(FARTHER) * guess[0]) ** 2
            guess[0] += f.x[offset]
        elif not whole:
            guess[1] = TURN * n / AROUND
            wide[1] = (WIDTH * TURN / AROUND) ** 2
        if add(f, now, confirm, link, offset, ident, guess, wide, ranged):
            f.anchor[f.count[0] - 1, SHARE] = 1.0 / guesses


@njit(cache=True)
def correct(f: Filter, j: int, offset: int, now: int, z: Floats, q: Floats, w: Scratch, k: int) -> tuple[float, int]:
    """Update by a measurement z of variances q (3,) of VT j, or of its guesses; return log-likelihood, and how many
    rows are pending.

    z in m and rad. Guesses given up have the share 0.
    """
    if k + 6 > len(w.pending):
        k = settle(f, w.pending, k)
    if f.anchor[j, SHARE] == 1.0:
        f.slots[j, LAST] = now
        f.slots[j, HITS] += 1
        return update(f, j, offset, z, q, w, k)
    k = settle(f, w.pending, k)
    link, ident, share = f.slots[j, LINK], f.slots[j, IDENT], f.anchor[:, SHARE]
    best = -math.inf
    for i in range(f.count[0]):
        if same_vt(f, i, link, ident):
            if share[i] > 0.0:
                share[i] = math.log(share[i]) + _likelihood(f, i, offset, z, q, w)
                best = max(best, share[i])
                f.slots[i, LAST] = now
                f.slots[i, HITS] += 1
            else:
                share[i] = -math.inf
    total = 0.0
    for i in range(f.count[0]):
        if same_vt(f, i, link, ident):
            share[i] = math.exp(share[i] - best)
            total += share[i]
    left, last = unite(f, link, ident, total)
    if left == 1:
        share[last] = 1.0
        _, k = update(f, last, offset, z, q, w, k)
    else:
        for i in range(f.count[0]):
            if same_vt(f, i, link, ident) and share[i] > 0.0:
                consider(f, i, offset, z, q, w)
    return best + math.log(total), k


@njit(cache=True)
def settle(f: Filter, pending: Floats, k: int) -> int:
    """Take off P the k rows of `pending` (K, N); return 0, which is how many are left."""
    downdate(f.p, states(f), pending, k)
    return 0


@njit(cache=True)
def sweep(f: Filter) -> None:
    """Remove the guesses that were given up."""
    j = np.int64(0)
    while j < f.count[0]:
        if f.anchor[j, SHARE] == 0.0:
            remove(f, int(j))
        else:
            j += 1


@njit(cache=True)
def _likelihood(f: Filter, j: int, offset: int, z: Floats, q: Floats, w: Scratch) -> float:
    """Return log N(e; 0, S) of a measurement for guess j."""
    expected, hph = expect(f, j, offset, w.h, w.t)
    i = innovate(z, q, expected, f.x[offset], hph)
    distance2, log_det = log_likelihood(i)
    return max(-0.5 * (distance2 + log_det + i.measured * LOG_2PI), -1e6)


@njit(cache=True)
def unite(f: Filter, link: int, ident: int, total: float) -> tuple[int, int]:
    """Make the shares of a VT's guesses sum to one, give up the improbable ones and doubles; return how many are left,
    and the last of them."""
    share = f.anchor[:, SHARE]
    for i in range(f.count[0]):
        if same_vt(f, i, link, ident):
            share[i] = share[i] / total if share[i] > LEAST * total else 0.0
    for a in range(f.count[0]):
        if not same_vt(f, a, link, ident) or share[a] == 0.0:
            continue
        for b in range(f.count[0]):
            if b == a or not same_vt(f, b, link, ident) or share[b] == 0.0:
                continue
            if share[b] > share[a] or not _agree(f, a, b):
                continue
            share[a] += share[b]
            share[b] = 0.0
    left, last, total = 0, -1, 0.0
    for i in range(f.count[0]):
        if same_vt(f, i, link, ident) and share[i] > 0.0:
            left, last = left + 1, i
            total += share[i]
    for i in range(f.count[0]):
        if same_vt(f, i, link, ident):
            share[i] /= total
    return left, last


@njit(cache=True)
def _agree(f: Filter, i: int, j: int) -> bool:
    """Return whether two guesses of one VT are the same by now."""
    a, b = f.core.size + 3 * i, f.core.size + 3 * j
    for c in range(3):
        gap = f.x[a + c] - f.x[b + c]
        if c == 1:
            gap = wrap(gap)
        if gap * gap > AGREE * AGREE * (f.p[a + c, a + c] + f.p[b + c, b + c]):
            return False
    return True


@njit(cache=True)
def consider(f: Filter, j: int, offset: int, z: Floats, q: Floats, w: Scratch) -> None:
    """Update VT j alone; all else is considered: covariances with it change, its own do not.

    z, q (3,): measurement in m and rad, and its variances.
    """
    x, p, t, v, size = f.x, f.p, w.t, f.core.size + 3 * j, states(f)
    expected, hph = expect(f, j, offset, w.h, t)
    innovation = innovate(z, q, expected, x[offset], hph)
    root = cholesky(innovation.s)
    if root.xx == 0.0:
        return
    blank(t, z)
    whitened = solved(root, innovation.e)
    for n in range(size):
        u = solved(root, Vec3(t[0, n], t[1, n], t[2, n]))
        t[0, n], t[1, n], t[2, n] = u.x, u.y, u.z
    for i in range(v, v + 3):
        x[i] += t[0, i] * whitened.x + t[1, i] * whitened.y + t[2, i] * whitened.z
        for n in range(size):
            value = p[i, n] - (t[0, i] * t[0, n] + t[1, i] * t[1, n] + t[2, i] * t[2, n])
            if n < v or n >= i:  # beside the VT's own block, or in its upper half
                p[i, n] = p[n, i] = value
