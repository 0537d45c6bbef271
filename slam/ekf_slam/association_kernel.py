"""Compiled: which measurement of a link came from which VT: scores, best assignment, its best rival, JCBB."""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.frames_kernel import wrap
from cellslam.sim.recording import Ints
from cellslam.slam.ekf_slam.state_layout import (
    HITS,
    IDENT,
    JOINT_MEASUREMENTS,
    JOINT_VTS,
    LAST,
    LINK,
    OFFSET,
    SHARE,
    TOUCHED,
    Filter,
    JointScratch,
    Measured,
    Scratch,
)
from cellslam.slam.ekf_slam.update_kernel import LOG_2PI, innovate, log_likelihood
from cellslam.slam.ekf_slam.vt_kernel import covariance, gains, predict, rotations_of, state_of
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
def score_pairs(f: Filter, seen: Measured, link: int, forbidden: Ints, w: Scratch) -> tuple[int, float]:
    """Score the measurements of a link against its VTs; return candidates and the sum of log P(missed).

    Written: w.score (C, m): log-likelihood ratio of a pair to "missed, and clutter", -inf outside the gate; w.chosen
    (C,): VT of each row; w.gated (m,): 1 in somebody's gate. forbidden (2,): a measurement and the identity of a VT
    that do not go together, or -1.
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
            if forbidden[0] == k and forbidden[1] == f.slots[j, IDENT]:
                continue
            density = log_density(f, seen, k, offset, expected, hph)
            if density > -math.inf:
                w.gated[k - start] = 1
                value, before = prior - seen.gap[k] + density, w.score[row, k - start]
                most = max(value, before)
                w.score[row, k - start] = most + math.log(math.exp(value - most) + math.exp(before - most))
    return rows, missed


@njit(cache=True)
def associate(f: Filter, seen: Measured, link: int, forbidden: Ints, w: Scratch) -> tuple[int, float]:
    """Write into w.row_of (m,) the row of `chosen` for each measurement of a link, -1 none; return as `score_pairs`."""
    rows, missed = score_pairs(f, seen, link, forbidden, w)
    columns = seen.first[link + 1] - seen.first[link]
    if not (seen.rules.joint and columns > 0 and rows > 0 and jointly(f, seen, link, rows, w)):
        assign(w.score, rows, columns, w.row_of, w.work_f, w.work_i)
    return rows, missed


@njit(cache=True)
def best_rival(w: Scratch, rows: int, columns: int, most: float) -> tuple[float, int, int]:
    """Return the loss (nats) of the second-best assignment of a link, and column and row of the pair that it does
    without; `most`, -1 and -1 where no loss is below `most`.

    The second best lacks at least one pair of the best: each in turn is forbidden (Murty 1968, first level).
    """
    score, row_of, second, total = w.score, w.row_of, w.slot_of, 0.0
    least, column, without = most, -1, -1
    for k in range(columns):
        if row_of[k] >= 0:
            total += score[row_of[k], k]
    for k in range(columns):
        row = row_of[k]
        if row < 0:
            continue
        kept = score[row, k]
        rivals = kept < most
        for r in range(rows):
            rivals = rivals or (r != row and score[r, k] > kept - most and score[r, k] > 0.0)
        for c in range(columns):
            rivals = rivals or (c != k and score[row, c] > kept - most and score[row, c] > 0.0)
        if not rivals:
            continue
        score[row, k] = -1.0
        assign(score, rows, columns, second, w.work_f, w.work_i)
        other = 0.0
        for c in range(columns):
            if second[c] >= 0:
                other += score[second[c], c]
        score[row, k] = kept
        if total - other < least:
            least, column, without = total - other, k, row
    return least, column, without


@njit(cache=True)
def jointly(f: Filter, seen: Measured, link: int, rows: int, w: Scratch) -> bool:
    """Joint compatibility by branch and bound; return whether the link was small enough for it.

    Most pairings first, then the least joint Mahalanobis distance, within the chi-square gate of as many components
    (Neira and Tardos, IEEE Trans. Robotics and Automation 17, 2001). Pairs that do not pay against clutter are out.
    """
    columns, score, used = seen.first[link + 1] - seen.first[link], w.score, np.int64(0)
    if columns > JOINT_MEASUREMENTS:
        return False
    for r in range(rows):
        fits = False
        for c in range(columns):
            fits = fits or score[r, c] > 0.0
        if fits:
            if used == JOINT_VTS:
                return False
            w.chosen[used] = w.chosen[r]
            score[used, :columns] = score[r, :columns]
            used += 1
    for r in range(used, rows):
        score[r, :columns] = -1.0
    _blocks(f, seen, link, int(used), w)
    _branch(seen, link, int(used), w)
    return True


@njit(cache=True)
def _blocks(f: Filter, seen: Measured, link: int, used: int, w: Scratch) -> None:
    """Write all innovations e[r, c] (R, m, 3), and the covariances H_a P H_b^T (R, R, 3, 3) of all pairs of
    candidates; t (R, 3, N): H P."""
    t, blocks, e, h = w.joint.t, w.joint.blocks, w.joint.e, w.h
    start, stop, offset = seen.first[link], seen.first[link + 1], f.core.first_offset + seen.site_of[link]
    turned = rotations_of(f)
    for b in range(used):
        j = w.chosen[b]
        expected = predict(f, j, turned, h)
        gains(f, j, offset, h, t[b])
        for c in range(stop - start):
            z = seen.z[start + c]
            e[b, c, 0] = 0.0 if math.isnan(z[0]) else z[0] - expected.distance - f.x[offset]
            e[b, c, 1] = 0.0 if math.isnan(z[1]) else wrap(z[1] - expected.azimuth)
            e[b, c, 2] = 0.0 if math.isnan(z[2]) else z[2] - expected.elevation
        for a in range(b + 1):
            for r in range(3):
                for s in range(3):
                    total = t[a, r, offset] * h[s, OFFSET]
                    for c in range(TOUCHED):
                        if c != OFFSET:
                            total += t[a, r, state_of(f, j, offset, c)] * h[s, c]
                    blocks[a, b, r, s] = total
                    blocks[b, a, s, r] = total


@njit(cache=True)
def _joint_distance(seen: Measured, start: int, count: int, w: JointScratch) -> tuple[float, int]:
    """Return the joint squared Mahalanobis distance of the first `count` pairs (column, row), and the measured
    components.

    w.root (3 m, 3 m + 1): its last column holds the whitened innovation.
    """
    root, pairs, z = w.root, w.pairs, seen.z
    size, last, total = 0, root.shape[1] - 1, 0.0
    for d in range(count):
        column, row = pairs[d, 0], pairs[d, 1]
        for i in range(3):
            if math.isnan(z[start + column, i]):
                continue
            at = 0
            for d2 in range(d + 1):
                for j in range(3):
                    if math.isnan(z[start + pairs[d2, 0], j]) or at > size:
                        continue
                    value = w.blocks[row, pairs[d2, 1], i, j]
                    value += seen.single[start + column, i] if at == size else 0.0
                    for h in range(at):
                        value -= root[size, h] * root[at, h]
                    if at == size:
                        if value <= 0.0:
                            return math.inf, size
                        root[size, at] = math.sqrt(value)
                    else:
                        root[size, at] = value / root[at, at]
                    at += 1
            rest = w.e[row, column, i]
            for h in range(size):
                rest -= root[size, h] * root[h, last]
            root[size, last] = rest / root[size, size]
            total += root[size, last] ** 2
            size += 1
    return total, size


@njit(cache=True)
def _branch(seen: Measured, link: int, used: int, w: Scratch) -> None:
    """Depth-first search over the measurements of a link; write the best jointly compatible pairing into w.row_of.

    pairs (m, 2): column and row. tried[c]: next row for measurement c, `used` for none, beyond: exhausted.
    """
    score, row_of, pairs, tried = w.score, w.row_of, w.joint.pairs, w.joint.tried
    start, columns = seen.first[link], seen.first[link + 1] - seen.first[link]
    best, best_distance = np.int64(-1), math.inf
    row_of[:columns] = -1
    column, count = 0, np.int64(0)  # a literal would have `_joint_distance` compiled twice
    tried[0] = 0
    while column >= 0:
        if column == columns:
            distance, _ = _joint_distance(seen, start, int(count), w.joint)
            if count > best or (count == best and distance < best_distance):
                best, best_distance = count, distance
                row_of[:columns] = -1
                for d in range(count):
                    row_of[pairs[d, 0]] = pairs[d, 1]
            column -= 1
        else:
            if count > 0 and pairs[count - 1, 0] == column:
                count -= 1  # take back what was tried last for this measurement
            row = tried[column]
            tried[column] = row + 1
            if row > used or (row == used and count + columns - column - 1 < best):
                column -= 1
                continue
            if row < used:
                free = score[row, column] > 0.0 and count + columns - column >= best
                for d in range(count):
                    free = free and pairs[d, 1] != row
                if not free:
                    continue
                pairs[count, 0], pairs[count, 1] = column, row
                distance, size = _joint_distance(seen, start, int(count) + 1, w.joint)
                if distance > w.joint.gates[size]:
                    continue
                count += 1
            column += 1
            if column < columns:
                tried[column] = 0
