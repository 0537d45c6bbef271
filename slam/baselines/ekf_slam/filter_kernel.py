"""Compiled: one snapshot for every filter of a bank: associate link by link, update, give birth, drop; likelihoods.

Filters do not read one another: the result does not depend on the number of threads.
"""

from __future__ import annotations

import math

from numba import njit, prange

from cellslam.slam.baselines.ekf_slam.layout import (
    AGE_ONCE,
    AGE_TWICE,
    BIRTH,
    BY_POSE,
    BY_VT,
    CLUTTER,
    CONFIRM,
    FREE,
    GATE,
    HITS,
    IDENT,
    KNOWN_ASSOCIATION,
    KNOWN_MAP,
    LAST,
    LINK,
    PREDICTED,
    SLOT,
)
from cellslam.slam.baselines.ekf_slam.motion_kernel import rotations
from cellslam.slam.baselines.ekf_slam.vt_kernel import gains, give_birth, innovation, predict
from cellslam.slam.fastslam.assignment import assign

LOG_2PI = math.log(2.0 * math.pi)


@njit(cache=True)
def _innovate(g, z, b, e, s, q):
    """Write e = z - h(x), and make S + Q of what was measured; return the number of measured components."""
    measured = 0
    for r in range(3):
        if math.isnan(z[r]):
            e[r] = 0.0
            for c in range(3):
                s[r, c] = s[c, r] = 0.0
            s[r, r] = 1.0
        else:
            e[r] = z[r] - g[PREDICTED + r] - (b if r == 0 else 0.0)
            s[r, r] += q[r]
            measured += 1
    if not math.isnan(z[1]):
        e[1] -= 2.0 * math.pi * math.floor((e[1] + math.pi) / (2.0 * math.pi))
    return measured


@njit(cache=True)
def _cholesky(s):
    """Return the lower triangle of a 3 x 3 matrix's root as six scalars; the first is 0 where there is none."""
    if s[0, 0] <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a = math.sqrt(s[0, 0])
    b, c = s[1, 0] / a, s[2, 0] / a
    dd = s[1, 1] - b * b
    if dd <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    d = math.sqrt(dd)
    e = (s[2, 1] - b * c) / d
    ff = s[2, 2] - c * c - e * e
    if ff <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return a, b, c, d, e, math.sqrt(ff)


@njit(cache=True)
def _log_likelihood(e, s):
    """Return e^T S^-1 e and log det S; infinite where S has no root."""
    a, b, c, d, f, h = _cholesky(s)
    if a == 0.0:
        return math.inf, 0.0
    w0 = e[0] / a
    w1 = (e[1] - b * w0) / d
    w2 = (e[2] - c * w0 - f * w1) / h
    return w0 * w0 + w1 * w1 + w2 * w2, 2.0 * math.log(a * d * h)


@njit(cache=True)
def _update(g, x, p, size, anchor, offset, v, mapped, z, q, e, s, t):
    """Kalman update of the whole state by one measurement of the VT at state v; return log N(e; 0, S)."""
    rotations(g, x[3], x[4], x[5])
    predict(g, x, anchor, v)
    gains(g, p, size, offset, v, mapped, t)
    for r in range(3):
        for c in range(3):
            total = t[r, offset] if c == 0 else 0.0
            for k in range(6):
                total += t[r, k] * g[BY_POSE + 6 * c + k]
            if mapped:
                for k in range(3):
                    total += t[r, v + k] * g[BY_VT + 3 * c + k]
            s[r, c] = total
    for r in range(3):
        for c in range(r):
            s[r, c] = s[c, r] = 0.5 * (s[r, c] + s[c, r])
    for r in range(3):
        if math.isnan(z[r]):
            for j in range(size):
                t[r, j] = 0.0
    measured = _innovate(g, z, x[offset], e, s, q)
    l0, l1, l2, l3, l4, l5 = _cholesky(s)
    if l0 == 0.0:
        return 0.0
    w0 = e[0] / l0
    w1 = (e[1] - l1 * w0) / l3
    w2 = (e[2] - l2 * w0 - l4 * w1) / l5
    for j in range(size):
        u0 = t[0, j] / l0
        u1 = (t[1, j] - l1 * u0) / l3
        u2 = (t[2, j] - l2 * u0 - l4 * u1) / l5
        t[0, j], t[1, j], t[2, j] = u0, u1, u2
        x[j] += u0 * w0 + u1 * w1 + u2 * w2
    for i in range(size):
        u0, u1, u2 = t[0, i], t[1, i], t[2, i]
        if u0 == 0.0 and u1 == 0.0 and u2 == 0.0:
            continue
        for j in range(size):
            p[i, j] -= u0 * t[0, j] + u1 * t[1, j] + u2 * t[2, j]
    return -0.5 * (w0 * w0 + w1 * w1 + w2 * w2) - math.log(l0 * l3 * l5) - 0.5 * measured * LOG_2PI


@njit(cache=True)
def _remove(x, p, core, anchor, slots, count, j):
    """Drop VT j (exact marginalisation): the last one takes its place."""
    last = count - 1
    size, a, b = core + 3 * count, core + 3 * j, core + 3 * last
    if j != last:
        for k in range(3):
            x[a + k], anchor[j, k] = x[b + k], anchor[last, k]
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
def _room(slots, count, now, confirm):
    """Return the VT to give up for a new one: unconfirmed before confirmed, then the longest unseen; -1: none."""
    worst, rank = -1, math.inf
    for j in range(count):
        if slots[j, LAST] < now:
            value = slots[j, LAST] + (1e9 if slots[j, HITS] >= confirm else 0.0)
            if value < rank:
                worst, rank = j, value
    return worst


@njit(cache=True)
def _add(g, x, p, core, anchor, slots, count, now, confirm, link, offset, ident, z, q, small, lost, losses):
    """Give birth to a VT, making room if need be; return the number of VTs and of confirmed ones given up."""
    if count == len(slots):
        j = _room(slots, count, now, confirm)
        if j < 0:
            return count, losses
        if slots[j, HITS] >= confirm and losses < len(lost):
            _keep(x, p, core, anchor, slots, j, lost[losses])
            losses += 1
        count = _remove(x, p, core, anchor, slots, count, j)
    rotations(g, x[3], x[4], x[5])
    give_birth(g, x, p, core + 3 * count, anchor[count], offset, z, q, small)
    slots[count, LINK], slots[count, HITS], slots[count, LAST], slots[count, IDENT] = link, 1, now, ident
    return count + 1, losses


@njit(cache=True)
def _keep(x, p, core, anchor, slots, j, out):
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
                    total += _slope(rho, ca, sa, ce, se, r, a) * p[v + a, v + b] * _slope(rho, ca, sa, ce, se, s, b)
            out[5 + 3 * r + s] = total


@njit(cache=True)
def _slope(rho, ca, sa, ce, se, row, column):
    """Return d(position)/d(range, azimuth, elevation)[row, column]."""
    if column == 0:
        return ce * ca if row == 0 else (ce * sa if row == 1 else se)
    if column == 1:
        return -rho * ce * sa if row == 0 else (rho * ce * ca if row == 1 else 0.0)
    return -rho * se * ca if row == 0 else (-rho * se * sa if row == 1 else rho * ce)


@njit(cache=True)
def map_into(x, p, core, anchor, slots, count, hits, out):
    """Write the VTs with at least `hits` detections into out (V, 14) as `_keep` does; return their number."""
    found = 0
    for j in range(count):
        if slots[j, HITS] >= hits:
            _keep(x, p, core, anchor, slots, j, out[found])
            found += 1
    return found


@njit(cache=True)
def _associate(g, x, p, core, anchor, slots, count, mapped, now, link, offset, z, q, start, stop, tables, cfg, gap,
               score, chosen, row_of, gated, work_f, work_i, small, e, s):  # fmt: skip
    """Assign the measurements start..stop of one link to its VTs; return candidates and the sum of log P(missed).

    chosen (C,): VT of each candidate row; row_of (m,): row of each measurement, -1 none; gated (m,).
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
        missed += tables[kind, 1, age]
        if stop == start or rows == len(chosen):
            continue
        v = core + 3 * j
        predict(g, x, anchor[j], v)
        chosen[rows] = j
        prior = tables[kind, 0, age] - tables[kind, 1, age] - cfg[CLUTTER]
        innovation(g, p, offset, v, mapped, small, s)
        s00, s01, s02, s11, s12, s22 = s[0, 0], s[0, 1], s[0, 2], s[1, 1], s[1, 2], s[2, 2]
        for k in range(start, stop):
            s[0, 0], s[1, 1], s[2, 2] = s00, s11, s22
            s[0, 1] = s[1, 0] = s01
            s[0, 2] = s[2, 0] = s02
            s[1, 2] = s[2, 1] = s12
            measured = _innovate(g, z[k], x[offset], e, s, q[k])
            score[rows, k - start] = -1.0
            if e[0] * e[0] > cfg[GATE] * s[0, 0] or e[1] * e[1] > cfg[GATE] * s[1, 1] or measured == 0:
                continue
            distance2, log_det = _log_likelihood(e, s)
            if distance2 < cfg[GATE]:
                gated[k - start] = 1
                score[rows, k - start] = prior - gap[k] - 0.5 * (distance2 + log_det + measured * LOG_2PI)
        rows += 1
    assign(score, rows, stop - start, row_of, work_f, work_i)
    return rows, missed


@njit(cache=True)
def _snapshot(mode, now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, z, q, gap, given,
              born, tables, cfg, association, g, t, score, chosen, ints, work_f, work_i, small, es, lost,
              losses):  # fmt: skip
    """Use one snapshot in one filter; return log-likelihood, number of VTs, and of those given up."""
    e, s = es[3], es[:3]
    row_of, gated = ints[0], ints[1]
    total = 0.0
    mapped = mode != KNOWN_MAP
    for link in range(len(first) - 1):
        start, stop = first[link], first[link + 1]
        offset = first_offset + site_of[link]
        if links[link] == 0:
            continue
        if mode != KNOWN_ASSOCIATION:
            _, missed = _associate(
                g, x, p, core, anchor, slots, count, mapped, now, link, offset, z, q, start, stop, tables, cfg, gap,
                score, chosen, row_of, gated, work_f, work_i, small, e, s,
            )  # fmt: skip
            total += missed
        for k in range(start, stop):
            j = -1
            association[k] = -1
            if mode == KNOWN_ASSOCIATION:
                for i in range(count):
                    if slots[i, LINK] == link and slots[i, IDENT] == given[k]:
                        j = i
            elif row_of[k - start] >= 0:
                j = chosen[row_of[k - start]]
            if j < 0:
                continue
            kind = 0 if slots[j, HITS] < 2 else 1
            age = min(now - slots[j, LAST], tables.shape[2] - 1)
            size = core + 3 * count if mapped else core
            value = _update(g, x, p, size, anchor[j], offset, core + 3 * j, mapped, z[k], q[k], e, s, t)
            if mode != KNOWN_ASSOCIATION:
                total += tables[kind, 0, age] - tables[kind, 1, age] - cfg[CLUTTER] - gap[k]
            total += value
            slots[j, LAST] = now
            slots[j, HITS] += 1
            association[k] = slots[j, IDENT]
        for k in range(start, stop):
            whole = not (math.isnan(z[k, 0]) or math.isnan(z[k, 1]) or math.isnan(z[k, 2]))
            fresh = association[k] < 0 and whole and z[k, 0] - x[offset] > 1.0
            if mode == FREE and fresh and row_of[k - start] < 0 and gated[k - start] == 0:
                total += cfg[BIRTH]
                count, losses = _add(
                    g, x, p, core, anchor, slots, count, now, cfg[CONFIRM], link, offset, born + k, z[k], q[k], small,
                    lost, losses,
                )  # fmt: skip
            elif mode == KNOWN_ASSOCIATION and fresh and given[k] >= 0:
                association[k] = given[k]
                count, losses = _add(
                    g, x, p, core, anchor, slots, count, now, cfg[CONFIRM], link, offset, given[k], z[k], q[k], small,
                    lost, losses,
                )  # fmt: skip
    if mode == FREE:
        j = 0
        while j < count:
            age, hits = now - slots[j, LAST], slots[j, HITS]
            if hits < cfg[CONFIRM] and age > (cfg[AGE_ONCE] if hits < 2 else cfg[AGE_TWICE]):
                count = _remove(x, p, core, anchor, slots, count, j)
            else:
                j += 1
    return total, count, losses


@njit(cache=True, parallel=True)
def use_snapshot(mode, now, x, p, core, first_offset, anchor, slots, count, links, first, site_of, z, q, gap, given,
                 born, tables, cfg, log_weight, association, lost, losses, g, t, score, chosen, ints, work_f, work_i,
                 small, es):  # fmt: skip
    """Use one snapshot in the filters x (K, N), p (K, N, N), anchor (K, V, 3), slots (K, V, 4), count (K,).

    links (K, L): 1 where a filter uses a link; first (L + 1,): first measurement of each link; z, q (M, 3):
    measurements (NaN: not measured) and variances; gap (M,): log of the clutter's width in what is missing; given (M,):
    true VT of each measurement in mode KNOWN_ASSOCIATION; born: identity of measurement 0 as a VT; tables: see
    `fastslam.existence`; cfg: see layout. log_weight (K,) is added to, association (K, M) written; confirmed VTs given
    up go to lost (K, E, 14), losses (K,). The rest is scratch.
    """
    for f in prange(len(x)):
        value, new_count, new_losses = _snapshot(
            mode, now, x[f], p[f], core, first_offset, anchor[f], slots[f], count[f], links[f], first, site_of, z, q,
            gap, given, born, tables, cfg, association[f], g[f], t[f], score[f], chosen[f], ints[f], work_f[f],
            work_i[f], small[f], es[f], lost[f], losses[f],
        )  # fmt: skip
        log_weight[f] += value
        count[f] = new_count
        losses[f] = new_losses
