"""Compiled: which measurement of a link came from which VT: scores, Hungarian assignment, its best rival, JCBB."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.ekf_slam.motion_kernel import rotations
from cellslam.slam.ekf_slam.state_layout import (
    BY_POSE,
    BY_VT,
    CLUTTER,
    GATE,
    HITS,
    IDENT,
    JOINT,
    JOINT_MEASUREMENTS,
    JOINT_VTS,
    LAST,
    LINK,
    PREDICTED,
    RIVAL,
    SHARE,
)
from cellslam.slam.ekf_slam.update_kernel import LOG_2PI, innovate, log_likelihood
from cellslam.slam.ekf_slam.vt_kernel import gains, innovation, predict
from cellslam.slam.model.assignment_kernel import assign


@njit(cache=True)
def score_pairs(g, x, p, core, anchor, slots, count, mapped, now, link, offset, z, q, start, stop, tables, cfg, gap,
                forbidden, score, chosen, gated, small, e, s):  # fmt: skip
    """Score the measurements start..stop of a link against its VTs; return candidates and the sum of log P(missed).

    score (C, m): log-likelihood ratio of a pair to "missed, and clutter", -inf outside the gate; chosen (C,): VT of
    each row; gated (m,): 1 in somebody's gate. forbidden (2,): a measurement and the identity of a VT that do not go
    together, or -1.
    """
    rotations(g, x[3], x[4], x[5])
    horizon = tables.shape[2] - 1
    rows, missed = 0, 0.0
    for k in range(stop - start):
        gated[k] = 0
    for j in range(count):
        if slots[j, LINK] != link:
            continue
        kind, age = 0 if slots[j, HITS] < 2 else 1, min(now - slots[j, LAST], horizon)
        share, row = anchor[j, SHARE], rows
        if share < 1.0:  # one of several guesses of a VT, which is one row
            for r in range(rows):
                row = r if slots[chosen[r], IDENT] == slots[j, IDENT] else row
        if row == rows:
            missed += tables[kind, 1, age]
        if stop == start or row == len(chosen) or share == 0.0:
            continue
        v = core + 3 * j
        predict(g, x, anchor[j], v)
        prior = tables[kind, 0, age] - tables[kind, 1, age] - cfg[CLUTTER] + math.log(share)
        if row == rows:
            chosen[rows] = j
            for k in range(stop - start):
                score[rows, k] = -math.inf
            rows += 1
        innovation(g, p, offset, v, mapped, small, s)
        s00, s01, s02, s11, s12, s22 = s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]
        for k in range(start, stop):
            s[0, 0], s[1, 1], s[2, 2] = s00, s11, s22
            s[0, 1] = s[1, 0] = s01
            s[0, 2] = s[2, 0] = s02
            s[1, 2] = s[2, 1] = s12
            measured = innovate(g, z[k], x[offset], e, s, q[k])
            if e[0] * e[0] > cfg[GATE] * s[0, 0] or e[1] * e[1] > cfg[GATE] * s[1, 1] or measured == 0:
                continue
            if forbidden[0] == k and forbidden[1] == slots[j, IDENT]:
                continue
            distance2, log_det = log_likelihood(e, s)
            if distance2 < cfg[GATE]:
                gated[k - start] = 1
                value = prior - gap[k] - 0.5 * (distance2 + log_det + measured * LOG_2PI)
                most = max(value, score[row, k - start])
                score[row, k - start] = most + math.log(math.exp(value - most) + math.exp(score[row, k - start] - most))
    return rows, missed


@njit(cache=True)
def associate(g, x, p, core, anchor, slots, count, mapped, now, link, offset, z, q, start, stop, tables, cfg, gap,
              forbidden, score, chosen, row_of, gated, work_f, work_i, small, e, s, joint):  # fmt: skip
    """Write into row_of (m,) the row of `chosen` for each measurement of a link, -1 none; return as `score_pairs`."""
    rows, missed = score_pairs(
        g, x, p, core, anchor, slots, count, mapped, now, link, offset, z, q, start, stop, tables, cfg, gap, forbidden,
        score, chosen, gated, small, e, s,
    )  # fmt: skip
    if cfg[JOINT] > 0.0 and stop > start and rows > 0:
        done = _jointly(
            g, x, p, core, anchor, chosen, rows, offset, z, q, start, stop, score, row_of, joint,
        )  # fmt: skip
        if done:
            return rows, missed
    assign(score, rows, stop - start, row_of, work_f, work_i)
    return rows, missed


@njit(cache=True)
def best_rival(score, rows, columns, row_of, second, work_f, work_i, cfg, out):
    """Write into out the loss of the second-best assignment of a link, and the pair that it does without.

    out (3,): loss (nats), column, row; changed only where the loss is below out[0]. second (m,): scratch.
    The second best lacks at least one pair of the best: each in turn is forbidden (Murty 1968, first level).
    """
    total = 0.0
    for k in range(columns):
        if row_of[k] >= 0:
            total += score[row_of[k], k]
    for k in range(columns):
        row = row_of[k]
        if row < 0:
            continue
        kept = score[row, k]
        rivals = kept < cfg[RIVAL]
        for r in range(rows):
            rivals = rivals or (r != row and score[r, k] > kept - cfg[RIVAL] and score[r, k] > 0.0)
        for c in range(columns):
            rivals = rivals or (c != k and score[row, c] > kept - cfg[RIVAL] and score[row, c] > 0.0)
        if not rivals:
            continue
        score[row, k] = -1.0
        assign(score, rows, columns, second, work_f, work_i)
        other = 0.0
        for c in range(columns):
            if second[c] >= 0:
                other += score[second[c], c]
        score[row, k] = kept
        if total - other < out[0]:
            out[0], out[1], out[2] = total - other, k, row


@njit(cache=True)
def _jointly(g, x, p, core, anchor, chosen, rows, offset, z, q, start, stop, score, row_of, joint):
    """Joint compatibility by branch and bound; return whether the link was small enough for it.

    Most pairings first, then the least joint Mahalanobis distance, within the chi-square gate of as many components
    (Neira and Tardos, IEEE Trans. Robotics and Automation 17, 2001). Pairs that do not pay against clutter are out.
    joint: t (R, 3, N), blocks (R, R, 3, 3), e (R, m, 3), root (3 m, 3 m + 1), pairs (m, 2), tried (m + 1,), scratch;
    and the gates (3 m + 1,) by number of components.
    """
    t, blocks, e, root, pairs, tried, gates = joint
    columns = stop - start
    if columns > JOINT_MEASUREMENTS:
        return False
    used = np.int64(0)  # a literal would have `_blocks` and `_branch` compiled twice
    for r in range(rows):
        fits = False
        for c in range(columns):
            fits = fits or score[r, c] > 0.0
        if fits:
            if used == JOINT_VTS:
                return False
            chosen[used] = chosen[r]
            for c in range(columns):
                score[used, c] = score[r, c]
            used += 1
    for r in range(used, rows):
        for c in range(columns):
            score[r, c] = -1.0
    _blocks(g, x, p, core, anchor, chosen, used, offset, z, start, columns, t, blocks, e)
    _branch(score, used, columns, z, q, start, blocks, e, root, gates, pairs, tried, row_of)
    return True


@njit(cache=True)
def _blocks(g, x, p, core, anchor, chosen, used, offset, z, start, columns, t, blocks, e):
    """Write all innovations e[r, c], and the covariances H_a P H_b^T of all pairs of candidates."""
    size = p.shape[0]
    for b in range(used):
        v = core + 3 * chosen[b]
        predict(g, x, anchor[chosen[b]], v)
        gains(g, p, size, offset, v, np.bool_(True), t[b])
        for c in range(columns):
            for i in range(3):
                value = z[start + c, i]
                e[b, c, i] = 0.0 if math.isnan(value) else value - g[PREDICTED + i] - (x[offset] if i == 0 else 0.0)
            turn = e[b, c, 1]
            e[b, c, 1] = turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))
        for a in range(b + 1):
            for i in range(3):
                for j in range(3):
                    total = t[a, i, offset] if j == 0 else 0.0
                    for k in range(6):
                        total += t[a, i, k] * g[BY_POSE + 6 * j + k]
                    for k in range(3):
                        total += t[a, i, v + k] * g[BY_VT + 3 * j + k]
                    blocks[a, b, i, j] = total
                    blocks[b, a, j, i] = total


@njit(cache=True)
def _joint_distance(pairs, count, z, q, start, blocks, e, root):
    """Return the joint squared Mahalanobis distance of `count` pairs (column, row), and the measured components.

    root (3 m, 3 m + 1): scratch; its last column holds the whitened innovation.
    """
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
                    value = blocks[row, pairs[d2, 1], i, j] + (q[start + column, i] if at == size else 0.0)
                    for h in range(at):
                        value -= root[size, h] * root[at, h]
                    if at == size:
                        if value <= 0.0:
                            return math.inf, size
                        root[size, at] = math.sqrt(value)
                    else:
                        root[size, at] = value / root[at, at]
                    at += 1
            rest = e[row, column, i]
            for h in range(size):
                rest -= root[size, h] * root[h, last]
            root[size, last] = rest / root[size, size]
            total += root[size, last] ** 2
            size += 1
    return total, size


@njit(cache=True)
def _branch(score, used, columns, z, q, start, blocks, e, root, gates, pairs, tried, row_of):
    """Depth-first search over the measurements of a link; write the best jointly compatible pairing into row_of.

    pairs (m, 2), tried (m + 1,): scratch. tried[c]: next row for measurement c, `used` for none, beyond: exhausted.
    """
    best, best_distance = np.int64(-1), math.inf
    for c in range(columns):
        row_of[c] = -1
    column, count = 0, np.int64(0)  # a literal would have `_joint_distance` compiled twice
    tried[0] = 0
    while column >= 0:
        if column == columns:
            distance, _ = _joint_distance(pairs, count, z, q, start, blocks, e, root)
            if count > best or (count == best and distance < best_distance):
                best, best_distance = count, distance
                for c in range(columns):
                    row_of[c] = -1
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
                distance, size = _joint_distance(pairs, count + 1, z, q, start, blocks, e, root)
                if distance > gates[size]:
                    continue
                count += 1
            column += 1
            if column < columns:
                tried[column] = 0
