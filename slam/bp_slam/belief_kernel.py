"""Compiled: one snapshot by belief propagation: association probabilities by message passing, soft updates, existence.

Source: Leitinger, Meyer, Hlawatsch, Tufvesson and Win, "A belief propagation algorithm for multipath-based SLAM", IEEE
Trans. Wireless Communications 18, 2019, sections IV to VI; the message passing of the association is that of Williams
and Lau, "Approximate evaluation of marginal association probabilities with belief propagation", IEEE Trans. Aerospace
and Electronic Systems 50, 2014.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.ekf_slam.map_kernel import add, remove
from cellslam.slam.ekf_slam.motion_kernel import rotations
from cellslam.slam.ekf_slam.state_layout import (
    BACK,
    BIRTH,
    CLUTTER,
    CONFIRM,
    DETECTION,
    DROP,
    EXISTS,
    GATE,
    HITS,
    IDENT,
    LAST,
    LINK,
    STAY,
)
from cellslam.slam.ekf_slam.update_kernel import LOG_2PI, innovate, log_likelihood, spread
from cellslam.slam.ekf_slam.vt_kernel import innovation, predict

ROUNDS, CLOSE = 200, 1e-7
SURE = 1.0 - 1e-9  # most that existence can be
NEGLIGIBLE = 1e-4  # probability below which an association moves nothing


@njit(cache=True)
def pass_messages(beta, fresh, rows, columns, out, back, marginal):
    """Run the iterative data association; return the logarithm of the Bethe approximation of its normaliser.

    beta (R, m): messages of legacy features to their association variables, over that of a missed detection; fresh
    (m,): message of the new feature of a measurement, over that of clutter (0: it can have none). out (R, m), back (R,
    m): messages to and from the measurements, written; marginal (R, m): P(feature r made measurement c), written.
    Without loops (a feature or measurement in doubt at most at one end) everything is exact.
    """
    for r in range(rows):
        for c in range(columns):
            back[r, c] = 1.0 / (1.0 + fresh[c])
    for _ in range(ROUNDS):
        change = 0.0
        for r in range(rows):
            total = 1.0
            for c in range(columns):
                total += beta[r, c] * back[r, c]
            for c in range(columns):
                out[r, c] = beta[r, c] / max(total - beta[r, c] * back[r, c], 1e-300)
        for c in range(columns):
            total = 1.0 + fresh[c]
            for r in range(rows):
                total += out[r, c]
            for r in range(rows):
                value = 1.0 / max(total - out[r, c], 1e-300)
                change = max(change, abs(math.log(value / back[r, c])))
                back[r, c] = value
        if change < CLOSE:
            break
    log_z = 0.0
    for r in range(rows):
        total = 1.0
        for c in range(columns):
            total += beta[r, c] * back[r, c]
        log_z += math.log(total)
        for c in range(columns):
            marginal[r, c] = beta[r, c] * back[r, c] / total
    for c in range(columns):
        total = 1.0 + fresh[c]
        for r in range(rows):
            total += out[r, c]
            log_z -= math.log1p(out[r, c] * back[r, c])
        log_z += math.log(total)
    return log_z


@njit(cache=True)
def _messages(g, x, p, core, anchor, slots, count, link, offset, readings, start, stop, cfg, beta, chosen, small, e, s):
    """Predict the existence of a link's features and write their messages beta; return rows and log of missing all.

    Existence: a Markov chain of visible and hidden; only what was confirmed comes back (paper: survival probability).
    """
    z, q, _, gap, _, _, _ = readings
    rotations(g, x[3], x[4], x[5])
    rows, missed = 0, 0.0
    for j in range(count):
        if slots[j, LINK] != link:
            continue
        exists = anchor[j, EXISTS]
        exists = exists * cfg[STAY] + (1.0 - exists) * (cfg[BACK] if slots[j, HITS] >= cfg[CONFIRM] else 0.0)
        anchor[j, EXISTS] = exists
        silent = 1.0 - exists * cfg[DETECTION]
        missed += math.log(silent)
        v = core + 3 * j
        predict(g, x, anchor[j], v)
        chosen[rows] = j
        innovation(g, p, offset, v, True, small, s)
        s00, s01, s02, s11, s12, s22 = s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]
        scale = math.log(max(exists * cfg[DETECTION] / silent, 1e-300)) - cfg[CLUTTER]
        for k in range(start, stop):
            s[0, 0], s[1, 1], s[2, 2] = s00, s11, s22
            s[0, 1] = s[1, 0] = s01
            s[0, 2] = s[2, 0] = s02
            s[1, 2] = s[2, 1] = s12
            measured = innovate(g, z[k], x[offset], e, s, q[k])
            beta[rows, k - start] = 0.0
            if measured > 0 and e[0] * e[0] < cfg[GATE] * s[0, 0] and e[1] * e[1] < cfg[GATE] * s[1, 1]:
                distance2, log_det = log_likelihood(e, s)
                if distance2 < cfg[GATE]:
                    value = scale - gap[k] - 0.5 * (distance2 + log_det + measured * LOG_2PI)
                    beta[rows, k - start] = math.exp(min(value, 300.0))
        rows += 1
    return rows, missed


@njit(cache=True)
def soft_update(g, x, p, size, anchor, offset, v, readings, start, stop, share, e, s, t, mixed):
    """Update the whole state by one feature's measurements, each with its probability share (m,); return evidence.

    The mixture over "missed" and each measurement is replaced by the Gaussian of its mean and covariance: with S_c the
    innovation covariance and w_c = S_c^-1 e_c, the mean moves by T^T sum(share w), the covariance becomes P - T^T M T
    with M = sum(share S_c^-1) - sum(share w w^T) + mean(w) mean(w)^T. The evidence is what the log-likelihood of
    persisting errors lacks against that of fresh draws. mixed (4, 4): scratch.
    """
    z, q, many, _, lack, _, _ = readings
    spread(g, x, p, size, anchor, offset, v, True, s, t)
    s00, s01, s02, s11, s12, s22 = s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]
    for a in range(4):
        for b in range(4):
            mixed[a, b] = 0.0
    evidence = 0.0
    for k in range(start, stop):
        part = share[k - start]
        if part < NEGLIGIBLE:
            continue
        for use in range(2):
            s[0, 0], s[1, 1], s[2, 2] = s00, s11, s22
            s[0, 1] = s[1, 0] = s01
            s[0, 2] = s[2, 0] = s02
            s[1, 2] = s[2, 1] = s12
            innovate(g, z[k], x[offset], e, s, q[k] if use == 0 else many[k])
            distance2, log_det = log_likelihood(e, s)
            if use == 0:
                evidence += 0.5 * part * (distance2 + log_det)
            else:
                evidence += part * (lack[k] - 0.5 * (distance2 + log_det))
        _add_inverse(s, z[k], e, part, mixed)
    for a in range(3):
        for b in range(3):
            mixed[a, b] += mixed[3, a] * mixed[3, b]
    for j in range(size):
        x[j] += t[0, j] * mixed[3, 0] + t[1, j] * mixed[3, 1] + t[2, j] * mixed[3, 2]
    for i in range(size):
        t0, t1, t2 = t[0, i], t[1, i], t[2, i]
        if t0 == 0.0 and t1 == 0.0 and t2 == 0.0:
            continue
        u0 = t0 * mixed[0, 0] + t1 * mixed[1, 0] + t2 * mixed[2, 0]
        u1 = t0 * mixed[0, 1] + t1 * mixed[1, 1] + t2 * mixed[2, 1]
        u2 = t0 * mixed[0, 2] + t1 * mixed[1, 2] + t2 * mixed[2, 2]
        for j in range(i, size):
            value = p[i, j] - (u0 * t[0, j] + u1 * t[1, j] + u2 * t[2, j])
            p[i, j] = p[j, i] = value
    return evidence


@njit(cache=True)
def _add_inverse(s, z, e, part, mixed):
    """Add part (S^-1 - w w^T) of the measured components to mixed[:3, :3], and part w to mixed[3, :3]; w = S^-1 e."""
    a, b, c, d, f, h = s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]
    m00, m01, m02 = d * h - f * f, c * f - b * h, b * f - c * d
    det = a * m00 + b * m01 + c * m02
    m11, m12, m22 = a * h - c * c, b * c - a * f, a * d - b * b
    w0 = (m00 * e[0] + m01 * e[1] + m02 * e[2]) / det
    w1 = (m01 * e[0] + m11 * e[1] + m12 * e[2]) / det
    w2 = (m02 * e[0] + m12 * e[1] + m22 * e[2]) / det
    has0, has1, has2 = not math.isnan(z[0]), not math.isnan(z[1]), not math.isnan(z[2])
    mixed[0, 0] += part * ((m00 / det if has0 else 0.0) - w0 * w0)
    mixed[1, 1] += part * ((m11 / det if has1 else 0.0) - w1 * w1)
    mixed[2, 2] += part * ((m22 / det if has2 else 0.0) - w2 * w2)
    for r, col, value in ((0, 1, m01 / det - w0 * w1), (0, 2, m02 / det - w0 * w2), (1, 2, m12 / det - w1 * w2)):
        mixed[r, col] += part * value
        mixed[col, r] += part * value
    mixed[3, 0] += part * w0
    mixed[3, 1] += part * w1
    mixed[3, 2] += part * w2


@njit(cache=True)
def _believe(now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, readings, born, cfg,
             association, scratch, lost, losses):  # fmt: skip
    """Use one snapshot in one filter; return log-likelihood, number of features, and of those given up."""
    first_z, first_q = readings[5], readings[6]
    g, t, score, chosen, small, es, out, back, marginal, fresh, mixed = scratch
    e, s = es[3], es[:3]
    total = 0.0
    for link in range(len(first) - 1):
        start, stop = first[link], first[link + 1]
        if links[link] == 0:
            continue
        offset, columns = first_offset + site_of[link], stop - start
        rows, missed = _messages(
            g, x, p, core, anchor, slots, count, link, offset, readings, start, stop, cfg, score, chosen, small, e, s
        )
        total += missed
        for k in range(start, stop):
            whole = not math.isnan(first_z[k, 1]) and first_z[k, 0] - x[offset] > 1.0
            fresh[k - start] = cfg[BIRTH] if whole else 0.0
            association[k] = -1
        total += pass_messages(score, fresh, rows, columns, out, back, marginal)
        size = core + 3 * count
        for r in range(rows):
            j = chosen[r]
            seen, best = 0.0, 0
            for c in range(columns):
                seen += marginal[r, c]
                if marginal[r, c] > marginal[r, best]:
                    best = c
            exists = anchor[j, EXISTS]
            silent = exists * (1.0 - cfg[DETECTION]) / (1.0 - exists * cfg[DETECTION])
            anchor[j, EXISTS] = min(seen + (1.0 - seen) * silent, SURE)
            if seen > NEGLIGIBLE:
                total += soft_update(
                    g, x, p, size, anchor[j], offset, core + 3 * j, readings, start, stop, marginal[r], e, s, t, mixed
                )
            if seen > 0.5:
                slots[j, LAST] = now
                slots[j, HITS] += 1
                if marginal[r, best] > 0.5:
                    association[start + best] = slots[j, IDENT]
        for k in range(start, stop):
            claims = 1.0 + fresh[k - start]
            for r in range(rows):
                claims += out[r, k - start]
            exists = fresh[k - start] / claims
            if exists >= cfg[DROP]:
                count, losses = add(
                    g, x, p, core, anchor, slots, count, now, cfg[CONFIRM], link, offset, born + k, first_z[k],
                    first_q[k], True, small, lost, losses,
                )  # fmt: skip
                if anchor[count - 1, EXISTS] > SURE:  # there was room for it
                    anchor[count - 1, EXISTS] = exists
    j = np.int64(0)  # a literal would have `remove` compiled twice
    while j < count:
        if anchor[j, EXISTS] < cfg[DROP] and slots[j, HITS] < cfg[CONFIRM]:
            count = remove(x, p, core, anchor, slots, count, j)
        else:
            j += 1
    return total, count, losses


@njit(cache=True)
def believe_snapshot(now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, readings, born, cfg,
                     log_weight, association, lost, losses, scratch):  # fmt: skip
    """Use one snapshot in the filters x (K, N), p (K, N, N): arguments as in `filter_kernel.use_snapshot`."""
    for f in range(len(x)):
        own = (
            scratch[0][f], scratch[1][f], scratch[2][f], scratch[3][f], scratch[4][f], scratch[5][f], scratch[6][f],
            scratch[7][f], scratch[8][f], scratch[9][f], scratch[10][f],
        )  # fmt: skip
        value, new_count, new_losses = _believe(
            now, x[f], p[f], core, first_offset, anchor[f], slots[f], count[f], links[f], first, site_of, readings,
            born, cfg, association[f], own, lost[f], losses[f],
        )  # fmt: skip
        log_weight[f] += value
        count[f] = new_count
        losses[f] = new_losses
