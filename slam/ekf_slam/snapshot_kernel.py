"""Compiled: one snapshot for every filter of a bank: associate link by link, update, give birth, drop; likelihoods.

One thread: filters are many only during the start, and parallel code takes longer to compile than it saves.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, chapter 5 (the
Kalman filter and its likelihood); existence of VTs as in `front_end.visibility`.
"""

from __future__ import annotations

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.ekf_slam.association_kernel import associate
from cellslam.slam.ekf_slam.guess_kernel import begin, correct, possible, settle, sweep
from cellslam.slam.ekf_slam.map_kernel import tidy
from cellslam.slam.ekf_slam.state_layout import (
    FREE,
    HITS,
    IDENT,
    KNOWN_ASSOCIATION,
    LAST,
    Filter,
    Measured,
    Scratch,
    one_of,
    same_vt,
)

FRESH, TAKEN = -1, -2  # measurements that are in no VT's gate, and those that nothing is to be made of


@njit(cache=True)
def _pair(f: Filter, seen: Measured, w: Scratch) -> float:
    """Find for each measurement the slot of its VT, link by link, from what was predicted; return sum of log P(missed).

    Written into w.slot_of: FRESH for what may begin a VT, TAKEN for what may not.
    """
    slot_of, total = w.slot_of, 0.0
    for link in range(len(seen.first) - 1):
        start, stop = seen.first[link], seen.first[link + 1]
        if f.links[link] == 0:
            slot_of[start:stop] = TAKEN
        elif seen.rules.mode == KNOWN_ASSOCIATION:
            for k in range(start, stop):
                slot_of[k] = FRESH
                for i in range(f.count[0]):
                    if same_vt(f, i, link, seen.given[k]):
                        slot_of[k] = i
        else:
            total += associate(f, seen, link, w)
            for k in range(start, stop):
                row = w.row_of[k - start]
                slot_of[k] = w.chosen[row] if row >= 0 else (TAKEN if w.gated[k - start] == 1 else FRESH)
    return total


@njit(cache=True)
def _update(f: Filter, seen: Measured, association: Ints, total: float, w: Scratch) -> float:
    """Update by the measurements that have a VT, write its identity; return `total` and their log-likelihood against
    clutter."""
    rows, tables = 0, seen.tables
    for link in range(len(seen.first) - 1):
        offset = f.core.first_offset + seen.site_of[link]
        for k in range(seen.first[link], seen.first[link + 1]):
            j = w.slot_of[k]
            association[k] = -1 if j < 0 else f.slots[j, IDENT]
            if j < 0:
                continue
            kind, age = 0 if f.slots[j, HITS] < 2 else 1, min(seen.now - f.slots[j, LAST], tables.shape[2] - 1)
            value, rows = correct(f, j, offset, seen.now, seen.z[k], seen.many[k], w, rows)
            if seen.rules.mode != KNOWN_ASSOCIATION:
                total += tables[kind, 0, age] - tables[kind, 1, age] - seen.rules.log_clutter - seen.gap[k]
            total += value + seen.lack[k]
    settle(f, w.pending, rows)
    return total


@njit(cache=True)
def _begin(f: Filter, seen: Measured, association: Ints, total: float, w: Scratch) -> float:
    """Give birth to VTs; return `total` and what that adds to the log-likelihood."""
    rules = seen.rules
    for link in range(len(seen.first) - 1):
        offset = f.core.first_offset + seen.site_of[link]
        for k in range(seen.first[link], seen.first[link + 1]):
            if w.slot_of[k] != FRESH or not possible(seen.begin[k], f.x[offset]):
                continue
            ident = seen.born + k
            if rules.mode == FREE:
                total += rules.birth
            elif rules.mode == KNOWN_ASSOCIATION and seen.given[k] >= 0:
                association[k] = ident = seen.given[k]
            else:
                continue
            begin(f, seen.now, rules.confirm, link, offset, ident, seen.begin[k], seen.begin_q[k])
    return total


@njit(cache=True)
def use_snapshot(filters: Filter, seen: Measured, log_weight: Floats, association: Ints, w: Scratch) -> None:
    """Use one snapshot in the K filters of a bank.

    log_weight (K,) is added to, association (K, m) written: identities of VTs.
    """
    for k in range(len(filters.x)):
        f = one_of(filters, k)
        total = _update(f, seen, association[k], _pair(f, seen, w), w)
        log_weight[k] += _begin(f, seen, association[k], total, w)
        if f.mapped:
            sweep(f)
        if seen.rules.mode == FREE:
            tidy(f, seen.now, seen.rules)
