"""Compiled: VTs whose direction or distance was not measured: several guesses, of which time leaves one.

A lone distance begins VTs around the circle, a lone direction begins VTs at distances that double, all of them with one
identity and a share of the probability each: a Gaussian sum for one VT (Alspach and Sorenson 1972; for distances also
Sola et al., "Undelayed initialization in bearing only SLAM", IROS 2005). While guesses are left, measurements correct
them and their shares, but not the pose or the clock offset, which are considered only (Schmidt 1966): whatever a wrong
guess would teach does no harm. Guesses that agree become one, and the last one is a VT like any other.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.ekf_slam.map_kernel import add, remove
from cellslam.slam.ekf_slam.state_layout import HITS, IDENT, LAST, LINK, SHARE
from cellslam.slam.ekf_slam.update_kernel import LOG_2PI, cholesky, innovate, log_likelihood, spread, update
from cellslam.slam.model.downdate_kernel import downdate

AROUND, AHEAD = 10, 7  # guesses of an azimuth, of a distance
NEAREST_M, FARTHER = 15.0, 2.0  # first distance, ratio of one to the next
WIDTH = 0.5  # deviation of a guess, in distances of neighbours
LEAST = 1e-3  # share below which a guess is given up
AGREE = 0.5  # guesses this close, in their deviations, are one


@njit(cache=True)
def possible(z, b):
    """Return whether a VT can begin with a measurement: its distance, its azimuth or both are known."""
    return z[0] - b > 1.0 or (math.isnan(z[0]) and not math.isnan(z[1]))


@njit(cache=True)
def begin(g, x, p, core, anchor, slots, count, now, confirm, link, offset, ident, z, q, small, lost, losses):
    """Give birth to a VT, or to its guesses; return as `add`. z, q (3,): elevation is there, or its prior."""
    whole = not (math.isnan(z[0]) or math.isnan(z[1]))
    guesses = 1 if whole else (AHEAD if math.isnan(z[0]) else AROUND)
    guess, wide = z.copy(), q.copy()
    ranged = not math.isnan(z[0])
    for n in range(guesses):
        if not ranged:
            guess[0] = NEAREST_M * FARTHER**n
            wide[0] = (WIDTH * math.log(FARTHER) * guess[0]) ** 2
            guess[0] += x[offset]
        elif not whole:
            guess[1] = 2.0 * math.pi * n / AROUND
            wide[1] = (WIDTH * 2.0 * math.pi / AROUND) ** 2
        count, losses = add(
            g, x, p, core, anchor, slots, count, now, confirm, link, offset, ident, guess, wide, ranged, small, lost,
            losses,
        )  # fmt: skip
        if slots[count - 1, IDENT] == ident and slots[count - 1, LINK] == link:  # there was room
            anchor[count - 1, SHARE] = 1.0 / guesses
    return count, losses


@njit(cache=True)
def correct(g, x, p, core, anchor, slots, count, j, now, offset, mapped, z, q, e, s, t, pending, k):
    """Update by a measurement of VT j, or of its guesses; return log-likelihood, and how much is pending.

    Guesses given up have the share 0.
    """
    size = core + 3 * count if mapped else core
    if k + 6 > len(pending):
        k = settle(p, size, pending, k)
    if anchor[j, SHARE] == 1.0:
        slots[j, LAST] = now
        slots[j, HITS] += 1
        return update(g, x, p, size, anchor[j], offset, core + 3 * j, mapped, z, q, e, s, t, pending, k)
    k = settle(p, size, pending, k)
    link, ident = slots[j, LINK], slots[j, IDENT]
    best = -math.inf
    for i in range(count):
        if slots[i, IDENT] == ident and slots[i, LINK] == link and anchor[i, SHARE] > 0.0:
            value = _likelihood(g, x, p, size, anchor[i], offset, core + 3 * i, z, q, e, s, t)
            anchor[i, SHARE] = math.log(anchor[i, SHARE]) + value
            best = max(best, anchor[i, SHARE])
            slots[i, LAST] = now
            slots[i, HITS] += 1
        elif slots[i, IDENT] == ident and slots[i, LINK] == link:
            anchor[i, SHARE] = -math.inf
    total = 0.0
    for i in range(count):
        if slots[i, IDENT] == ident and slots[i, LINK] == link:
            anchor[i, SHARE] = math.exp(anchor[i, SHARE] - best)
            total += anchor[i, SHARE]
    left, last = _unite(x, p, core, anchor, slots, count, link, ident, total)
    if left == 1:
        anchor[last, SHARE] = 1.0
        _, k = update(g, x, p, size, anchor[last], offset, core + 3 * last, True, z, q, e, s, t, pending, k)
    else:
        for i in range(count):
            if slots[i, IDENT] == ident and slots[i, LINK] == link and anchor[i, SHARE] > 0.0:
                _consider(g, x, p, size, anchor[i], offset, core + 3 * i, z, q, e, s, t)
    return best + math.log(total), k


@njit(cache=True)
def settle(p, size, pending, k):
    """Take off P what is pending; return 0, which is how much is left."""
    downdate(p, size, pending, k)
    return 0


@njit(cache=True)
def sweep(x, p, core, anchor, slots, count):
    """Remove the guesses that were given up; return the number of VTs left."""
    j = np.int64(0)
    while j < count:
        if anchor[j, SHARE] == 0.0:
            count = remove(x, p, core, anchor, slots, count, j)
        else:
            j += 1
    return count


@njit(cache=True)
def _likelihood(g, x, p, size, anchor, offset, v, z, q, e, s, t):
    """Return log N(e; 0, S) of a measurement for the guess at state v."""
    spread(g, x, p, size, anchor, offset, v, np.bool_(True), s, t)
    measured = innovate(g, z, x[offset], e, s, q)
    distance2, log_det = log_likelihood(e, s)
    return max(-0.5 * (distance2 + log_det + measured * LOG_2PI), -1e6)


@njit(cache=True)
def _unite(x, p, core, anchor, slots, count, link, ident, total):
    """Make the shares of a VT's guesses sum to one, give up the improbable ones and doubles; return how many are left,
    and the last of them."""
    for i in range(count):
        if slots[i, IDENT] == ident and slots[i, LINK] == link:
            anchor[i, SHARE] = anchor[i, SHARE] / total if anchor[i, SHARE] > LEAST * total else 0.0
    for a in range(count):
        if slots[a, IDENT] != ident or slots[a, LINK] != link or anchor[a, SHARE] == 0.0:
            continue
        for b in range(count):
            if b == a or slots[b, IDENT] != ident or slots[b, LINK] != link or anchor[b, SHARE] == 0.0:
                continue
            if anchor[b, SHARE] > anchor[a, SHARE] or not _agree(x, p, core + 3 * a, core + 3 * b):
                continue
            anchor[a, SHARE] += anchor[b, SHARE]
            anchor[b, SHARE] = 0.0
    left, last, total = 0, -1, 0.0
    for i in range(count):
        if slots[i, IDENT] == ident and slots[i, LINK] == link and anchor[i, SHARE] > 0.0:
            left, last = left + 1, i
            total += anchor[i, SHARE]
    for i in range(count):
        if slots[i, IDENT] == ident and slots[i, LINK] == link:
            anchor[i, SHARE] /= total
    return left, last


@njit(cache=True)
def _agree(x, p, a, b):
    """Return whether two guesses of one VT are the same by now."""
    for c in range(3):
        gap = x[a + c] - x[b + c]
        if c == 1:
            gap -= 2.0 * math.pi * math.floor(gap / (2.0 * math.pi) + 0.5)
        if gap * gap > AGREE * AGREE * (p[a + c, a + c] + p[b + c, b + c]):
            return False
    return True


@njit(cache=True)
def _consider(g, x, p, size, anchor, offset, v, z, q, e, s, t):
    """Update the VT at state v alone; all else is considered: covariances with it change, its own do not."""
    spread(g, x, p, size, anchor, offset, v, np.bool_(True), s, t)
    for r in range(3):
        if math.isnan(z[r]):
            for j in range(size):
                t[r, j] = 0.0
    innovate(g, z, x[offset], e, s, q)
    l0, l1, l2, l3, l4, l5 = cholesky(s)
    if l0 == 0.0:
        return
    w0 = e[0] / l0
    w1 = (e[1] - l1 * w0) / l3
    w2 = (e[2] - l2 * w0 - l4 * w1) / l5
    for j in range(size):
        u0 = t[0, j] / l0
        u1 = (t[1, j] - l1 * u0) / l3
        t[0, j], t[1, j], t[2, j] = u0, u1, (t[2, j] - l2 * u0 - l4 * u1) / l5
    for i in range(v, v + 3):
        x[i] += t[0, i] * w0 + t[1, i] * w1 + t[2, i] * w2
        for j in range(size):
            value = p[i, j] - (t[0, i] * t[0, j] + t[1, i] * t[1, j] + t[2, i] * t[2, j])
            if j < v or j >= i:  # beside the VT's own block, or in its upper half
                p[i, j] = p[j, i] = value
