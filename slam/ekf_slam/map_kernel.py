"""Compiled: VTs come and go in a filter's state; the map in the world frame.

Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990: the state augmented
and marginalised, covariances through Jacobians.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats
from cellslam.slam.ekf_slam.state_layout import (
    EXISTS,
    HITS,
    IDENT,
    LAST,
    LINK,
    POSITION,
    SHARE,
    SPREAD,
    Filter,
    Rules,
)
from cellslam.slam.ekf_slam.vt_kernel import give_birth


@njit(cache=True)
def remove(f: Filter, j: int) -> None:
    """Drop VT j (exact marginalisation): the last one takes its place."""
    last, size = f.count[0] - 1, f.core.size + 3 * f.count[0]
    a, b = f.core.size + 3 * j, f.core.size + 3 * last
    if j != last:
        f.x[a : a + 3] = f.x[b : b + 3]
        f.anchor[j] = f.anchor[last]
        f.slots[j] = f.slots[last]
        for k in range(3):
            for i in range(size):
                f.p[a + k, i] = f.p[b + k, i]
        for k in range(3):
            for i in range(size):
                f.p[i, a + k] = f.p[i, b + k]
    f.count[0] = last


@njit(cache=True)
def room(f: Filter, now: int, confirm: int) -> int:
    """Return the VT to give up for a new one: unconfirmed before confirmed, then the longest unseen; -1: none."""
    worst, rank = -1, math.inf
    for j in range(f.count[0]):
        if f.slots[j, LAST] < now:
            value = f.slots[j, LAST] + (1e9 if f.slots[j, HITS] >= confirm else 0.0)
            if value < rank:
                worst, rank = j, value
    return worst


@njit(cache=True)
def add(
    f: Filter, now: int, confirm: int, link: int, offset: int, ident: int, z: Floats, q: Floats, ranged: bool
) -> bool:
    """Give birth to a VT, making room if need be; return whether there was room. Confirmed ones given up are kept.

    z, q (3,): measurement in m and rad, and variances; ranged: its distance was measured, with the clock offset in it.
    """
    if f.count[0] == len(f.slots):
        j = room(f, now, confirm)
        if j < 0:
            return False
        if f.slots[j, HITS] >= confirm and f.anchor[j, SHARE] > 0.5 and f.losses[0] < len(f.lost):
            keep(f, j, f.lost[f.losses[0]])
            f.losses[0] += 1
        remove(f, int(j))
    new = f.count[0]
    give_birth(f, new, offset, z, q, ranged)
    f.anchor[new, EXISTS] = f.anchor[new, SHARE] = 1.0
    f.slots[new, LINK], f.slots[new, HITS], f.slots[new, LAST], f.slots[new, IDENT] = link, 1, now, ident
    f.count[0] = new + 1
    return True


@njit(cache=True)
def keep(f: Filter, j: int, out: Floats) -> None:
    """Write identity, link, position (3,) in m and covariance (9,) in m^2 of VT j into out (14,)."""
    v = f.core.size + 3 * j
    rho, ca, sa = f.x[v], math.cos(f.x[v + 1]), math.sin(f.x[v + 1])
    ce, se = math.cos(f.x[v + 2]), math.sin(f.x[v + 2])
    out[0], out[1] = f.slots[j, IDENT], f.slots[j, LINK]
    at = f.anchor[j]
    out[POSITION], out[POSITION + 1] = at[0] + rho * ce * ca, at[1] + rho * ce * sa
    out[POSITION + 2] = at[2] + rho * se
    for r in range(3):
        for s in range(3):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += slope(rho, ca, sa, ce, se, r, a) * f.p[v + a, v + b] * slope(rho, ca, sa, ce, se, s, b)
            out[SPREAD + 3 * r + s] = total


@njit(cache=True)
def slope(rho: float, ca: float, sa: float, ce: float, se: float, row: int, column: int) -> float:
    """Return d(position)/d(range, azimuth, elevation)[row, column]."""
    if column == 0:
        return ce * ca if row == 0 else (ce * sa if row == 1 else se)
    if column == 1:
        return -rho * ce * sa if row == 0 else (rho * ce * ca if row == 1 else 0.0)
    return -rho * se * ca if row == 0 else (-rho * se * sa if row == 1 else rho * ce)


@njit(cache=True)
def map_into(f: Filter, hits: int, out: Floats) -> int:
    """Write the VTs with at least `hits` detections, as their likely guesses, into out (V, 14); return their number.

    Columns as `keep` writes them, in m and m^2.
    """
    found = 0
    for j in range(f.count[0]):
        if f.slots[j, HITS] >= hits and f.anchor[j, SHARE] > 0.5:
            keep(f, j, out[found])
            found += 1
    return found


@njit(cache=True)
def tidy(f: Filter, now: int, rules: Rules) -> None:
    """Drop VTs that were seen once or twice and not again."""
    j = np.int64(0)  # a literal would have `remove` compiled twice
    while j < f.count[0]:
        age, hits = now - f.slots[j, LAST], f.slots[j, HITS]
        if hits < rules.confirm and age > (rules.age_once if hits < 2 else rules.age_twice):
            remove(f, int(j))
        else:
            j += 1
