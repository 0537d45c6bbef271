"""Compiled: which measurement of a link came from which VT: scores, best assignment.

A pair scores its log-likelihood ratio to a missed VT and clutter. Source: Bar-Shalom and Li, "Multitarget-multisensor
tracking", 1995.
"""

from __future__ import annotations

import math

from cellslam.sim.compiling import njit
from cellslam.slam.ekf_slam.state_layout import HITS, IDENT, LAST, LINK, SHARE, Filter, Measured, Scratch
from cellslam.slam.ekf_slam.update_kernel import LOG_2PI, innovate, log_likelihood
from cellslam.slam.ekf_slam.vt_kernel import covariance, predict, rotations_of
from cellslam.slam.model.assignment_kernel import assign
from cellslam.slam.model.matrices_kernel import Sym3
from cellslam.slam.model.measurement_kernel import Spherical


@njit(cache=True)
def log_density(f: Filter, seen: Measured, k: int, offset: int, expected: Spherical, hph: Sym3) -> float:
    """Return the log-likelihood ratio of measurement k to clutter, if it is of the VT that lets expect this with the
    covariance hph = H P H^T; -inf outside the gate."""
    i, gate = innovate(seen.z[k], seen.single[k], expected, f.x[offset], hph), seen.rules.gate
    if i.measured == 0 or i.e.x * i.e.x > gate * i.s.xx or i.e.y * i.e.y > gate * i.s.yy:
        return -math.inf
    distance2, log_det = log_likelihood(i)
    if distance2 >= gate:
        return -math.inf
    return -0.5 * (distance2 + log_det + i.measured * LOG_2PI)


@njit(cache=True)
def score_pairs(f: Filter, seen: Measured, link: int, w: Scratch) -> tuple[int, float]:
    """Score the measurements of a link against its VTs; return candidates and the sum of log P(missed).

    Written: w.score (C, m): log-likelihood ratio of a pair to "missed, and clutter", -inf outside the gate; w.chosen
    (C,): VT of each row; w.gated (m,): 1 in somebody's gate.
    """
    turned, offset = rotations_of(f), f.core.first_offset + seen.site_of[link]
    start, stop, tables, horizon = seen.first[link], seen.first[link + 1], seen.tables, seen.tables.shape[2] - 1
    rows, missed = 0, 0.0
    w.gated[: stop - start] = 0
    for j in range(f.count[0]):
        if f.slots[j, LINK] != link:
            continue
        kind, age = 0 if f.slots[j, HITS] < 2 else 1, min(seen.now - f.slots[j, LAST], horizon)
        share, row = f.anchor[j, SHARE], rows
        if share < 1.0:  # one of several guesses of a VT, which is one row
            for r in range(rows):
                row = r if f.slots[w.chosen[r], IDENT] == f.slots[j, IDENT] else row
        if row == rows:
            missed += tables[kind, 1, age]
        if stop == start or row == len(w.chosen) or share == 0.0:
            continue
        expected = predict(f, j, turned, w.h)
        prior = tables[kind, 0, age] - tables[kind, 1, age] - seen.rules.log_clutter + math.log(share)
        if row == rows:
            w.chosen[rows] = j
            w.score[rows, : stop - start] = -math.inf
            rows += 1
        hph = covariance(f, j, offset, w.h, w.narrow)
        for k in range(start, stop):
            density = log_density(f, seen, k, offset, expected, hph)
            if density > -math.inf:
                w.gated[k - start] = 1
                value, before = prior - seen.gap[k] + density, w.score[row, k - start]
                most = max(value, before)
                w.score[row, k - start] = most + math.log(math.exp(value - most) + math.exp(before - most))
    return rows, missed


@njit(cache=True)
def associate(f: Filter, seen: Measured, link: int, w: Scratch) -> float:
    """Write into w.row_of (m,) the row of `chosen` for each measurement of a link, -1 none: the assignment with the
    best sum of scores; return the sum of log P(missed)."""
    rows, missed = score_pairs(f, seen, link, w)
    assign(w.score, rows, seen.first[link + 1] - seen.first[link], w.row_of, w.work_f, w.work_i)
    return missed
