"""Compiled: one snapshot for every filter of a bank: associate link by link, update, give birth, drop; likelihoods.

One thread: filters are many only during the start, and parallel code takes longer to compile than it saves.
"""

from __future__ import annotations

from numba import njit

from cellslam.slam.ekf_slam.association_kernel import associate, best_rival
from cellslam.slam.ekf_slam.guess_kernel import begin, correct, possible, settle, sweep
from cellslam.slam.ekf_slam.map_kernel import tidy
from cellslam.slam.ekf_slam.state_layout import (
    BIRTH,
    CLUTTER,
    CONFIRM,
    FREE,
    HITS,
    IDENT,
    KNOWN_ASSOCIATION,
    KNOWN_MAP,
    LAST,
    LINK,
    RIVAL,
)

FRESH, TAKEN = -1, -2  # measurements that are in no VT's gate, and those that nothing is to be made of


@njit(cache=True)
def _pair(mode, now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, z, q, gap, given, tables,
          cfg, forbidden, scratch):  # fmt: skip
    """Find for each measurement the slot of its VT, link by link, from what was predicted; return sum of log P(missed).

    Written into the last row of the integer scratch: FRESH for what may begin a VT, TAKEN for what may not.
    """
    g, _, score, chosen, ints, work_f, work_i, small, es, joint, _ = scratch
    row_of, gated, slot_of = ints[0], ints[1], ints[2]
    total = 0.0
    for link in range(len(first) - 1):
        start, stop = first[link], first[link + 1]
        if links[link] == 0:
            slot_of[start:stop] = TAKEN
        elif mode == KNOWN_ASSOCIATION:
            for k in range(start, stop):
                slot_of[k] = FRESH
                for i in range(count):
                    if slots[i, LINK] == link and slots[i, IDENT] == given[k]:
                        slot_of[k] = i
        else:
            _, missed = associate(
                g, x, p, core, anchor, slots, count, mode != KNOWN_MAP, now, link, first_offset + site_of[link], z, q,
                start, stop, tables, cfg, gap, forbidden, score, chosen, row_of, gated, work_f, work_i, small, es[3],
                es[:3], joint,
            )  # fmt: skip
            total += missed
            for k in range(start, stop):
                row = row_of[k - start]
                slot_of[k] = chosen[row] if row >= 0 else (TAKEN if gated[k - start] == 1 else FRESH)
    return total


@njit(cache=True)
def _snapshot(mode, now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, readings, given, born,
              tables, cfg, forbidden, association, scratch, lost, losses):  # fmt: skip
    """Use one snapshot in one filter; return log-likelihood, number of VTs, and of those given up."""
    z, q, many, gap, lack, first_z, first_q = readings
    g, t, _, _, ints, _, _, small, es, _, pending = scratch
    slot_of, mapped, rows = ints[2], mode != KNOWN_MAP, 0
    total = _pair(
        mode, now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, z, q, gap, given, tables, cfg,
        forbidden, scratch,
    )  # fmt: skip
    for link in range(len(first) - 1):
        for k in range(first[link], first[link + 1]):
            j = slot_of[k]
            association[k] = -1 if j < 0 else slots[j, IDENT]
            if j < 0:
                continue
            kind = 0 if slots[j, HITS] < 2 else 1
            age = min(now - slots[j, LAST], tables.shape[2] - 1)
            value, rows = correct(
                g, x, p, core, anchor, slots, count, j, now, first_offset + site_of[link], mapped, z[k], many[k], es[3],
                es[:3], t, pending, rows,
            )  # fmt: skip
            if mode != KNOWN_ASSOCIATION:
                total += tables[kind, 0, age] - tables[kind, 1, age] - cfg[CLUTTER] - gap[k]
            total += value + lack[k]
    settle(p, core + 3 * count if mapped else core, pending, rows)
    for link in range(len(first) - 1):
        offset = first_offset + site_of[link]
        for k in range(first[link], first[link + 1]):
            if slot_of[k] != FRESH or not possible(first_z[k], x[offset]):
                continue
            ident = born + k
            if mode == FREE:
                total += cfg[BIRTH]
            elif mode == KNOWN_ASSOCIATION and given[k] >= 0:
                association[k] = ident = given[k]
            else:
                continue
            count, losses = begin(
                g, x, p, core, anchor, slots, count, now, cfg[CONFIRM], link, offset, ident, first_z[k], first_q[k],
                small, lost, losses,
            )  # fmt: skip
    if mapped:
        count = sweep(x, p, core, anchor, slots, count)
    if mode == FREE:
        count = tidy(now, x, p, core, anchor, slots, count, cfg)
    return total, count, losses


@njit(cache=True)
def use_snapshot(mode, now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, readings, given,
                 born, tables, cfg, forbidden, log_weight, association, lost, losses, scratch, joint):  # fmt: skip
    """Use one snapshot in the filters x (K, N), p (K, N, N), anchor (K, V, 5), slots (K, V, 4), count (K,).

    links (K, L): 1 where a filter uses a link; first (L + 1,): first measurement of each link; readings: see
    `bank.Measured.columns`; given (M,): true VT of each measurement in mode KNOWN_ASSOCIATION; born: identity of
    measurement 0 as a VT; tables: see `front_end.existence`; cfg: see layout; forbidden (K, 2): see `score_pairs`.
    log_weight (K,) is added to, association (K, M) written; confirmed VTs given up go to lost (K, E, 14), losses (K,).
    The rest is scratch.
    """
    for f in range(len(x)):
        g, t, score, chosen, ints, work_f, work_i, small, es, pending = scratch
        own = (
            g[f], t[f], score[f], chosen[f], ints[f], work_f[f], work_i[f], small[f], es[f],
            (joint[0][f], joint[1][f], joint[2][f], joint[3][f], joint[4][f], joint[5][f], joint[6]),
            pending,
        )  # fmt: skip
        value, new_count, new_losses = _snapshot(
            mode, now, x[f], p[f], core, first_offset, anchor[f], slots[f], count[f], links[f], first, site_of,
            readings, given, born, tables, cfg, forbidden[f], association[f], own, lost[f], losses[f],
        )  # fmt: skip
        log_weight[f] += value
        count[f] = new_count
        losses[f] = new_losses


@njit(cache=True)
def find_rivals(now, x, p, core, first_offset, anchor, slots, count, first, site_of, readings, tables, cfg, nothing,
                rivals, scratch, joint):  # fmt: skip
    """Write the loss (nats) of each filter's best rival association, its measurement, and the VT it does without.

    rivals (K, 3): loss (cfg[RIVAL]: none is better), measurement, identity; nothing (2,): -1. Scratch is changed too.
    """
    for f in range(len(x)):
        z, q, _, gap, _, _, _ = readings
        g, _, score, chosen, ints, work_f, work_i, small, es, _ = scratch
        row_of, gated, second, best = ints[f, 0], ints[f, 1], ints[f, 2], es[f, 3]
        parts = (joint[0][f], joint[1][f], joint[2][f], joint[3][f], joint[4][f], joint[5][f], joint[6])
        rivals[f, 0], rivals[f, 1], rivals[f, 2] = cfg[RIVAL], -1.0, -1.0
        for link in range(len(first) - 1):
            start, stop = first[link], first[link + 1]
            if stop == start:
                continue
            rows, _ = associate(
                g[f], x[f], p[f], core, anchor[f], slots[f], count[f], True, now, link, first_offset + site_of[link], z,
                q, start, stop, tables, cfg, gap, nothing, score[f], chosen[f], row_of, gated, work_f[f], work_i[f],
                small[f], es[f, 3], es[f, :3], parts,
            )  # fmt: skip
            best[0], best[1], best[2] = rivals[f, 0], -1.0, -1.0
            best_rival(score[f], rows, stop - start, row_of, second, work_f[f], work_i[f], cfg, best)
            if best[1] >= 0.0:
                vt = slots[f, chosen[f, int(best[2])], IDENT]
                rivals[f, 0], rivals[f, 1], rivals[f, 2] = best[0], start + best[1], vt
