"""Compiled: VTs come and go in a filter's state; the map in the world frame."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.ekf_slam.motion_kernel import rotations
from cellslam.slam.ekf_slam.state_layout import (
    AGE_ONCE,
    AGE_TWICE,
    ANCHOR,
    CONFIRM,
    EXISTS,
    HITS,
    IDENT,
    LAST,
    LINK,
    SHARE,
    SLOT,
)
from cellslam.slam.ekf_slam.vt_kernel import give_birth


@njit(cache=True)
def remove(x, p, core, anchor, slots, count, j):
    """Drop VT j (exact marginalisation): the last one takes its place."""
    last = count - 1
    size, a, b = core + 3 * count, core + 3 * j, core + 3 * last
    if j != last:
        for k in range(3):
            x[a + k] = x[b + k]
        for k in range(ANCHOR):
            anchor[j, k] = anchor[last, k]
        for k in range(SLOT):
            slots[j, k] = slots[last, k]
        for k in range(3):
            for i in range(size):
                p[a + k, i] = p[b + k, i]
        for k in range(3):
            for i in range(size):
                p[i, a + k] = p[i, b + k]
    return last


@njit(cache=True)
def room(slots, count, now, confirm):
    """Return the VT to give up for a new one: unconfirmed before confirmed, then the longest unseen; -1: none."""
    worst, rank = -1, math.inf
    for j in range(count):
        if slots[j, LAST] < now:
            value = slots[j, LAST] + (1e9 if slots[j, HITS] >= confirm else 0.0)
            if value < rank:
                worst, rank = j, value
    return worst


@njit(cache=True)
def add(g, x, p, core, anchor, slots, count, now, confirm, link, offset, ident, z, q, ranged, small, lost, losses):
    """Give birth to a VT, making room if need be; return the number of VTs and of confirmed ones given up.

    ranged: its distance was measured, with the clock offset in it.
    """
    if count == len(slots):
        j = room(slots, count, now, confirm)
        if j < 0:
            return count, losses
        if slots[j, HITS] >= confirm and anchor[j, SHARE] > 0.5 and losses < len(lost):
            keep(x, p, core, anchor, slots, j, lost[losses])
            losses += 1
        count = remove(x, p, core, anchor, slots, count, j)
    rotations(g, x[3], x[4], x[5])
    give_birth(g, x, p, core + 3 * count, anchor[count], offset, z, q, ranged, small)
    anchor[count, EXISTS] = anchor[count, SHARE] = 1.0
    slots[count, LINK], slots[count, HITS], slots[count, LAST], slots[count, IDENT] = link, 1, now, ident
    return count + 1, losses


@njit(cache=True)
def keep(x, p, core, anchor, slots, j, out):
    """Write identity, link, position (3) and covariance (9) of VT j into out (14,)."""
    v = core + 3 * j
    rho, ca, sa = x[v], math.cos(x[v + 1]), math.sin(x[v + 1])
    ce, se = math.cos(x[v + 2]), math.sin(x[v + 2])
    out[0], out[1] = slots[j, IDENT], slots[j, LINK]
    out[2], out[3], out[4] = anchor[j, 0] + rho * ce * ca, anchor[j, 1] + rho * ce * sa, anchor[j, 2] + rho * se
    for r in range(3):
        for s in range(3):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += slope(rho, ca, sa, ce, se, r, a) * p[v + a, v + b] * slope(rho, ca, sa, ce, se, s, b)
            out[5 + 3 * r + s] = total


@njit(cache=True)
def slope(rho, ca, sa, ce, se, row, column):
    """Return d(position)/d(range, azimuth, elevation)[row, column]."""
    if column == 0:
        return ce * ca if row == 0 else (ce * sa if row == 1 else se)
    if column == 1:
        return -rho * ce * sa if row == 0 else (rho * ce * ca if row == 1 else 0.0)
    return -rho * se * ca if row == 0 else (-rho * se * sa if row == 1 else rho * ce)


@njit(cache=True)
def map_into(x, p, core, anchor, slots, count, hits, out):
    """Write the VTs with at least `hits` detections, as their likely guesses, into out (V, 14); return their number."""
    found = 0
    for j in range(count):
        if slots[j, HITS] >= hits and anchor[j, SHARE] > 0.5:
            keep(x, p, core, anchor, slots, j, out[found])
            found += 1
    return found


@njit(cache=True)
def tidy(now, x, p, core, anchor, slots, count, cfg):
    """Drop VTs that were seen once or twice and not again; return the number left."""
    j = np.int64(0)  # a literal would have `remove` compiled twice
    while j < count:
        age, hits = now - slots[j, LAST], slots[j, HITS]
        if hits < cfg[CONFIRM] and age > (cfg[AGE_ONCE] if hits < 2 else cfg[AGE_TWICE]):
            count = remove(x, p, core, anchor, slots, count, j)
        else:
            j += 1
    return count
