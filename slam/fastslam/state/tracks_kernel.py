"""Compiled: the life of tracks: what each particle believes of them, how they age, are dropped, and make room.

A status is DEAD where a particle (lane) does not believe in a track, else 4 * snapshot last seen + class.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.state.layout import LANES, V_WEIGHT, Link, Rows, Rules, Tracks

B = LANES
DEAD = -1
ONCE, UNCONFIRMED, CONFIRMED = 1, 2, 3
UNKNOWN = -2  # in `alike`, the status that all lanes of a track have: they differ, or were not looked at


@njit(error_model="numpy")
def link_of(tracks: Tracks, block: int, number: int) -> Link:
    """Return one map of one block."""
    return Link(
        tracks.status[block, number], tracks.alike[block, number], tracks.records[block, number],
        tracks.ident[block, number], tracks.order[block, number], tracks.bounds[block, number],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def spokesman(row: Rows) -> tuple[int, bool, bool]:
    """Return the first lane alive, -1 if none; whether all lanes alive have its status; whether all lanes are alive."""
    low, high = row[0], row[0]
    for l in range(B):
        low, high = min(low, row[l]), max(high, row[l])
    if low == high:
        return (0 if low >= 0 else -1), True, low >= 0
    different = 0
    for l in range(B):
        different |= (row[l] ^ high) & ~(row[l] >> 31)
    first = 0
    while row[first] < 0:
        first += 1
    return first, different == 0, False


@njit(cache=True, error_model="numpy")
def common(row: Rows) -> Any:
    """Return the status that all lanes have, UNKNOWN if they differ or some are not alive."""
    low, high = row[0], row[0]
    for l in range(B):
        low, high = min(low, row[l]), max(high, row[l])
    return low if low == high and low >= 0 else np.int32(UNKNOWN)


@njit(cache=True, error_model="numpy")
def age_all(v: Rows, now: int, link: Link, count: int, rules: Rules, share: float) -> int:
    """Charge each lane for each VT of a link as missed, drop what was never confirmed and is unlikely to be there;
    return the number of tracks left."""
    order, alike, status = link.order, link.alike, link.status
    i = 0
    charged = 0.0
    while i < count:
        slot = order[i]
        seen = alike[slot]
        if seen >= 0:
            charge = _charge(now, seen, rules)
            kept = charge <= 0.0
            charged += charge if kept else 0.0
        else:
            kept, whole = _age_lanes(v, now, status[slot], rules, share)
            alike[slot] = status[slot, 0] if whole else UNKNOWN
        if kept:
            i += 1
        else:
            count -= 1
            order[i], order[count] = order[count], order[i]
    charged *= share
    for l in range(B):
        v[V_WEIGHT * B + l] += charged
    return count


@njit(cache=True, error_model="numpy")
def _charge(now: int, seen: int, rules: Rules) -> float:
    """Return the log of missing a track with status `seen`, 1 where it is to be dropped."""
    age, kind = now - (seen >> 2), seen & 3
    if (kind == ONCE and age > rules.age_once) or (kind == UNCONFIRMED and age > rules.age_twice):
        return 1.0
    return float(rules.tables[0 if kind == ONCE else 1, 1, min(age, rules.tables.shape[2] - 1)])


@njit(cache=True, error_model="numpy")
def _age_lanes(v: Rows, now: int, row: Rows, rules: Rules, share: float) -> tuple[bool, bool]:
    """Charge the lanes that believe in a track, and drop it from those in which it is to be; return whether any keeps
    it, and whether all do, and have seen it alike."""
    first, same, whole = spokesman(row)
    if first < 0:
        return False, False
    if same:
        charge = _charge(now, row[first], rules)
        if charge > 0.0:
            return False, False
        charge *= share
        for l in range(B):
            v[V_WEIGHT * B + l] += charge if row[l] >= 0 else 0.0
        return True, whole
    kept = False
    for l in range(B):
        if row[l] >= 0:
            charge = _charge(now, row[l], rules)
            if charge > 0.0:
                row[l] = DEAD
            else:
                v[V_WEIGHT * B + l] += share * charge
                kept = True
    return kept, False


@njit(cache=True, error_model="numpy")
def evict(now: int, link: Link, count: int) -> int:
    """Give up the track that is confirmed in the fewest lanes, longest unseen; its place is then the first free one.
    Return the number of tracks left."""
    worst, worst_rank = 0, math.inf
    for i in range(count):
        rank = 0.0
        for l in range(B):
            s = link.status[link.order[i], l]
            if s >= 0:
                rank += (s & 3) + 1.0 / (2.0 + now - (s >> 2))
        if rank < worst_rank:
            worst, worst_rank = i, rank
    link.order[worst], link.order[count - 1] = link.order[count - 1], link.order[worst]
    return count - 1
