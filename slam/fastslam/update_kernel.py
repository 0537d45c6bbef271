"""Compiled: one snapshot for every particle: associate, update VTs and nuisances, weigh, give birth, drop.

Parallel over chunks of particles with scratch of their own; no particle reads another, so the result does not depend on
the number of threads.
"""

from __future__ import annotations

import math

from numba import njit, prange

from cellslam.slam.fastslam.algebra import quadratic, symmetric_inverse
from cellslam.slam.fastslam.assignment import assign
from cellslam.slam.fastslam.layout import (
    BIAS0,
    GAIN,
    HITS,
    IDENTITY,
    LAST_SEEN,
    MEAN,
    OFFSET0,
    P_A,
    P_C,
    P_H,
    P_J,
    P_MEAN,
    P_POSITION,
    P_S,
    P_SCORE0,
    P_SLOT,
    P_Z,
    POSITION,
    RANGE_PER_OFFSET,
    SCALE0,
    SIGMA,
    SPREAD,
)
from cellslam.slam.fastslam.predict_kernel import born_into, predict_into

LOG_2PI_3 = 1.5 * math.log(2.0 * math.pi)


@njit(cache=True, inline="always")
def _wrap(angle):
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(cache=True)
def update_vt(vt, row, e0, e1, e2, inv, now, offset, bias, scale):
    """Kalman update of one record, given the nuisances (method: VT update); `inv` is S^-1 as six scalars."""
    i0, i1, i2, i3, i4, i5 = inv
    # T = H Sigma (3 x 3), K = T^T S^-1
    a, b, c, d, e, f = vt[SIGMA], vt[SIGMA + 1], vt[SIGMA + 2], vt[SIGMA + 3], vt[SIGMA + 4], vt[SIGMA + 5]
    h = row
    t00 = h[P_H] * a + h[P_H + 1] * b + h[P_H + 2] * c
    t01 = h[P_H] * b + h[P_H + 1] * d + h[P_H + 2] * e
    t02 = h[P_H] * c + h[P_H + 1] * e + h[P_H + 2] * f
    t10 = h[P_H + 3] * a + h[P_H + 4] * b + h[P_H + 5] * c
    t11 = h[P_H + 3] * b + h[P_H + 4] * d + h[P_H + 5] * e
    t12 = h[P_H + 3] * c + h[P_H + 4] * e + h[P_H + 5] * f
    t20 = h[P_H + 6] * a + h[P_H + 7] * b + h[P_H + 8] * c
    t21 = h[P_H + 6] * b + h[P_H + 7] * d + h[P_H + 8] * e
    t22 = h[P_H + 6] * c + h[P_H + 7] * e + h[P_H + 8] * f
    k00, k01, k02 = (
        t00 * i0 + t10 * i1 + t20 * i2,
        t00 * i1 + t10 * i3 + t20 * i4,
        t00 * i2 + t10 * i4 + t20 * i5,
    )
    k10, k11, k12 = (
        t01 * i0 + t11 * i1 + t21 * i2,
        t01 * i1 + t11 * i3 + t21 * i4,
        t01 * i2 + t11 * i4 + t21 * i5,
    )
    k20, k21, k22 = (
        t02 * i0 + t12 * i1 + t22 * i2,
        t02 * i1 + t12 * i3 + t22 * i4,
        t02 * i2 + t12 * i4 + t22 * i5,
    )
    d0, d1, d2 = (
        k00 * e0 + k01 * e1 + k02 * e2,
        k10 * e0 + k11 * e1 + k12 * e2,
        k20 * e0 + k21 * e1 + k22 * e2,
    )
    vt[MEAN] = row[P_MEAN] + d0
    vt[MEAN + 1] = row[P_MEAN + 1] + d1
    vt[MEAN + 2] = row[P_MEAN + 2] + d2
    for col in range(3):
        a0, a1, a2 = row[P_A + col], row[P_A + 3 + col], row[P_A + 6 + col]
        vt[GAIN + col] -= k00 * a0 + k01 * a1 + k02 * a2
        vt[GAIN + 3 + col] -= k10 * a0 + k11 * a1 + k12 * a2
        vt[GAIN + 6 + col] -= k20 * a0 + k21 * a1 + k22 * a2
    vt[SIGMA] = a - (k00 * t00 + k01 * t10 + k02 * t20)
    vt[SIGMA + 1] = b - (k00 * t01 + k01 * t11 + k02 * t21)
    vt[SIGMA + 2] = c - (k00 * t02 + k01 * t12 + k02 * t22)
    vt[SIGMA + 3] = d - (k10 * t01 + k11 * t11 + k12 * t21)
    vt[SIGMA + 4] = e - (k10 * t02 + k11 * t12 + k12 * t22)
    vt[SIGMA + 5] = f - (k20 * t02 + k21 * t12 + k22 * t22)
    for r in range(3):
        vt[POSITION + r] = (
            row[P_POSITION + r] + row[P_J + 3 * r] * d0 + row[P_J + 3 * r + 1] * d1 + row[P_J + 3 * r + 2] * d2
        )
    vt[LAST_SEEN] = now
    vt[HITS] += 1.0
    vt[SPREAD] = math.sqrt(max(vt[SIGMA], 0.0))
    vt[RANGE_PER_OFFSET] = vt[GAIN]
    vt[OFFSET0], vt[BIAS0], vt[SCALE0] = offset, bias, scale


@njit(cache=True)
def _candidates(rec, count, rows, z, q, first, last, now, pose, rot, drot, pose_g, b, bias, scale, cov, tables, cfg):
    """Predict the VTs of one link that could have given one of z[first:last]; return their number and the miss terms.

    A VT whose distance is far from every measured one is passed over after reading one cache line. Every VT pays the
    log-probability of having been missed; `_score` gives it back to those that are detected.
    """
    found = 0
    missed = 0.0
    horizon = tables.shape[2] - 1
    widest = 0.0
    for k in range(first, last):
        widest = max(widest, q[k, 0])
    root_p = math.sqrt(cov[0])
    for j in range(count):
        vt = rec[j]
        age = min(int(now - vt[LAST_SEEN]), horizon)
        kind = 0 if vt[HITS] < 2.0 else 1
        missed += tables[kind, 1, age]
        dx, dy, dz = vt[POSITION] - pose[0], vt[POSITION + 1] - pose[1], vt[POSITION + 2] - pose[2]
        expected = math.sqrt(dx * dx + dy * dy + dz * dz) + b + vt[RANGE_PER_OFFSET] * (b - vt[OFFSET0])
        own = (1.0 + vt[RANGE_PER_OFFSET]) * root_p
        reach = 6.0 * math.sqrt(vt[SPREAD] * vt[SPREAD] + widest + own * own) + cfg[3]
        near = False
        for k in range(first, last):
            if not abs(z[k, 0] - expected) > reach:
                near = True
                break
        if near and found < rows.shape[0]:
            row = rows[found]
            predict_into(row, vt, pose, rot, drot, pose_g, b, bias, scale, cov)
            row[P_SLOT] = j
            row[P_SCORE0] = tables[kind, 0, age] - cfg[0] - tables[kind, 1, age]
            found += 1
    return found, missed


@njit(cache=True)
def _score(rows, found, z, q, first, last, score, gated, gate):
    """Fill score (found, last - first) with log-likelihood ratios against clutter and a missed VT; mark gated
    measurements.

    The covariance is S + A P A^T: the clock offset and the odometer's errors are marginalised (method: gate). A
    component that
    was not measured is NaN and takes no part.
    """
    for k in range(first, last):
        gated[k - first] = 0
    for i in range(found):
        row = rows[i]
        for k in range(first, last):
            score[i, k - first] = -math.inf
            e0, e1, e2 = z[k, 0] - row[P_Z], _wrap(z[k, 1] - row[P_Z + 1]), z[k, 2] - row[P_Z + 2]
            s0, s1, s2 = (
                row[P_S] + row[P_C] + q[k, 0],
                row[P_S + 1] + row[P_C + 1],
                row[P_S + 2] + row[P_C + 2],
            )
            s3, s4, s5 = (
                row[P_S + 3] + row[P_C + 3] + q[k, 1],
                row[P_S + 4] + row[P_C + 4],
                row[P_S + 5] + row[P_C + 5] + q[k, 2],
            )
            if e0 * e0 > gate * s0 or e1 * e1 > gate * s3 or e2 * e2 > gate * s5:
                continue
            i0, i1, i2, i3, i4, i5, det = symmetric_inverse(s0, s1, s2, s3, s4, s5)
            distance2 = quadratic(i0, i1, i2, i3, i4, i5, e0, e1, e2)
            if distance2 < gate:
                gated[k - first] = 1
                score[i, k - first] = row[P_SCORE0] - 0.5 * distance2 - 0.5 * math.log(det) - LOG_2PI_3


@njit(cache=True)
def _absorb(row, site, sites, e0, e1, e2, inv, info, vector):
    """Add A^T S^-1 A and A^T S^-1 e of one association to the snapshot's information on theta."""
    i0, i1, i2, i3, i4, i5 = inv
    for c in range(3):
        a0, a1, a2 = row[P_A + c], row[P_A + 3 + c], row[P_A + 6 + c]
        g0, g1, g2 = i0 * a0 + i1 * a1 + i2 * a2, i1 * a0 + i3 * a1 + i4 * a2, i2 * a0 + i4 * a1 + i5 * a2
        ci = site if c == 0 else sites + c - 1
        vector[ci] += g0 * e0 + g1 * e1 + g2 * e2
        for d in range(3):
            di = site if d == 0 else sites + d - 1
            info[ci, di] += g0 * row[P_A + d] + g1 * row[P_A + 3 + d] + g2 * row[P_A + 6 + d]


@njit(cache=True)
def condition(cov, info, vector, work, change):
    """Update theta's covariance (K, K) by the information of a snapshot; write the mean's change; return the
    log-weight.

    P_new = (1 + P I)^-1 P, change = P_new y, log-weight = -log det(1 + P I) / 2 + y^T P_new y / 2. Gauss-Jordan with
    row
    pivots on [1 + P I | P] in `work` (K, 2 K).
    """
    n = cov.shape[0]
    for r in range(n):
        for c in range(n):
            total = 1.0 if r == c else 0.0
            for k in range(n):
                total += cov[r, k] * info[k, c]
            work[r, c] = total
            work[r, n + c] = cov[r, c]
    log_det = 0.0
    for p in range(n):
        best = p
        for r in range(p + 1, n):
            if abs(work[r, p]) > abs(work[best, p]):
                best = r
        if best != p:
            for c in range(2 * n):
                work[p, c], work[best, c] = work[best, c], work[p, c]
        pivot = work[p, p]
        log_det += math.log(abs(pivot))
        for c in range(p, 2 * n):
            work[p, c] /= pivot
        for r in range(n):
            if r != p and work[r, p] != 0.0:
                factor = work[r, p]
                for c in range(p, 2 * n):
                    work[r, c] -= factor * work[p, c]
    for r in range(n):
        for c in range(n):
            cov[r, c] = 0.5 * (work[r, n + c] + work[c, n + r])
    gain = 0.0
    for r in range(n):
        total = 0.0
        for c in range(n):
            total += cov[r, c] * vector[c]
        change[r] = total
        gain += total * vector[r]
    return 0.5 * gain - 0.5 * log_det


@njit(cache=True)
def _free_slot(rec, count, now, cfg):
    """Return a slot for a birth: the next free one, else that of the VT with the fewest hits, longest unseen; -1:
    none to give."""
    if count < rec.shape[0]:
        return count
    worst, worst_rank = -1, math.inf
    for j in range(count):
        if rec[j, LAST_SEEN] < now:
            rank = rec[j, HITS] - 1e-6 * (now - rec[j, LAST_SEEN])
            if rank < worst_rank:
                worst, worst_rank = j, rank
    return worst


@njit(cache=True)
def _drop(rec, counts, link, now, cfg):
    """Drop VTs that were never confirmed and are now unlikely to be there."""
    j = 0
    while j < counts[link]:
        age = now - rec[j, LAST_SEEN]
        hits = rec[j, HITS]
        if hits < cfg[4] and age > (cfg[5] if hits < 2.0 else cfg[6]):
            counts[link] -= 1
            if j < counts[link]:
                rec[j, :] = rec[counts[link], :]
        else:
            j += 1


@njit(cache=True)
def _rotation_into(rot, drot, psi, theta, phi):
    """Write R(psi, theta, phi) and dR/dpsi, row by row."""
    cp, sp, ct, st = math.cos(psi), math.sin(psi), math.cos(theta), math.sin(theta)
    cr, sr = math.cos(phi), math.sin(phi)
    rot[0], rot[1], rot[2] = cp * ct, cp * st * sr - sp * cr, cp * st * cr + sp * sr
    rot[3], rot[4], rot[5] = sp * ct, sp * st * sr + cp * cr, sp * st * cr - cp * sr
    rot[6], rot[7], rot[8] = -st, ct * sr, ct * cr
    for c in range(3):
        drot[c], drot[3 + c], drot[6 + c] = -rot[3 + c], rot[c], 0.0


@njit(cache=True)
def _particle(
    now,
    pose,
    pose_g,
    theta,
    cov,
    records,
    counts,
    first,
    site_of,
    z,
    q,
    born,
    tables,
    cfg,
    association,
    rows,
    score,
    small,
    ints,
):
    """Run one snapshot for one particle; return its log-weight."""
    sites = theta.shape[0] - 2
    size = theta.shape[0]
    rot, drot, block = small[0:9], small[9:18], small[18:24]
    vector, change = small[24 : 24 + size], small[24 + size : 24 + 2 * size]
    base = 24 + 2 * size
    info = small[base : base + size * size].reshape((size, size))
    work = small[base + size * size : base + 3 * size * size].reshape((size, 2 * size))
    floats = small[base + 3 * size * size :]
    row_of, gated, solver = ints[0 : z.shape[0]], ints[z.shape[0] : 2 * z.shape[0]], ints[2 * z.shape[0] :]
    _rotation_into(rot, drot, pose[3], pose[4], pose[5])
    vector[:] = 0.0
    info[:, :] = 0.0
    bias, scale = theta[sites], theta[sites + 1]
    weight = 0.0
    updated = 0
    for link in range(counts.shape[0]):
        start, stop = first[link], first[link + 1]
        site = site_of[link]
        rec = records[link]
        block[0], block[1], block[2] = cov[site, site], cov[site, sites], cov[site, sites + 1]
        block[3], block[4], block[5] = cov[sites, sites], cov[sites, sites + 1], cov[sites + 1, sites + 1]
        found, missed = _candidates(
            rec,
            counts[link],
            rows,
            z,
            q,
            start,
            stop,
            now,
            pose,
            rot,
            drot,
            pose_g,
            theta[site],
            bias,
            scale,
            block,
            tables,
            cfg,
        )
        weight += missed
        if stop > start:
            _score(rows, found, z, q, start, stop, score, gated, cfg[1])
            assign(score, found, stop - start, row_of, floats, solver)
            for k in range(start, stop):
                association[k] = -1
                i = row_of[k - start]
                if i >= 0:
                    row = rows[i]
                    vt = rec[int(row[P_SLOT])]
                    e0, e1, e2 = z[k, 0] - row[P_Z], _wrap(z[k, 1] - row[P_Z + 1]), z[k, 2] - row[P_Z + 2]
                    s = symmetric_inverse(
                        row[P_S] + q[k, 0],
                        row[P_S + 1],
                        row[P_S + 2],
                        row[P_S + 3] + q[k, 1],
                        row[P_S + 4],
                        row[P_S + 5] + q[k, 2],
                    )
                    inv = (s[0], s[1], s[2], s[3], s[4], s[5])
                    weight += (
                        row[P_SCORE0]
                        - 0.5 * quadratic(s[0], s[1], s[2], s[3], s[4], s[5], e0, e1, e2)
                        - 0.5 * math.log(s[6])
                        - LOG_2PI_3
                    )
                    _absorb(row, site, sites, e0, e1, e2, inv, info, vector)
                    update_vt(vt, row, e0, e1, e2, inv, now, theta[site], bias, scale)
                    association[k] = int(vt[IDENTITY])
                    updated += 1
            for k in range(start, stop):
                rho = z[k, 0] - theta[site]
                if row_of[k - start] < 0 and gated[k - start] == 0 and rho > 1.0:
                    j = _free_slot(rec, counts[link], now, cfg)
                    if j >= 0:
                        vt = rec[j]
                        born_into(vt, rho, z[k, 1], z[k, 2], q[k], pose, rot, pose_g)
                        ce = math.cos(vt[MEAN + 2])
                        vt[POSITION] = pose[0] + rho * ce * math.cos(vt[MEAN + 1])
                        vt[POSITION + 1] = pose[1] + rho * ce * math.sin(vt[MEAN + 1])
                        vt[POSITION + 2] = pose[2] + rho * math.sin(vt[MEAN + 2])
                        vt[LAST_SEEN], vt[HITS], vt[SPREAD] = now, 1.0, math.sqrt(vt[SIGMA])
                        vt[RANGE_PER_OFFSET] = -1.0
                        vt[OFFSET0], vt[BIAS0], vt[SCALE0] = theta[site], bias, scale
                        vt[IDENTITY] = born + k
                        weight += cfg[2]
                        if j == counts[link]:
                            counts[link] += 1
        _drop(rec, counts, link, now, cfg)
    if updated > 0:
        weight += condition(cov, info, vector, work, change)
        for c in range(size):
            theta[c] += change[c]
        for r in range(2):
            pose[r] += pose_g[2 * r] * change[sites] + pose_g[2 * r + 1] * change[sites + 1]
        pose[3] += pose_g[4] * change[sites] + pose_g[5] * change[sites + 1]
    return weight


@njit(cache=True, parallel=True)
def update(
    now,
    pose,
    pose_g,
    theta,
    cov,
    records,
    counts,
    first,
    site_of,
    z,
    q,
    born,
    tables,
    cfg,
    log_weight,
    association,
    rows,
    score,
    small,
    ints,
):
    """Use one snapshot in every particle.

    pose (N, 6), pose_g (N, 6), theta (N, K), cov (N, K, K), records (N, L, C, 32), counts (N, L): particle states,
    written.
    first (L + 1,): first measurement of each link; z, q (M, 3): measurements and their variances; born: number of the
    first
    measurement; tables (2, 2, ages): log of visible-and-detected and of missed, for VTs seen once and for others;
    cfg: log clutter density, gate, log-weight of a birth, slack of the distance test, hits to confirm, ages to drop
    at. log_weight (N,) is added to,
    association (N, M) written; rows, score, small, ints are scratch, one a chunk.
    """
    chunks = rows.shape[0]
    n = pose.shape[0]
    for chunk in prange(chunks):
        for i in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            log_weight[i] += cfg[7] * _particle(
                now,
                pose[i],
                pose_g[i],
                theta[i],
                cov[i],
                records[i],
                counts[i],
                first,
                site_of,
                z,
                q,
                born,
                tables,
                cfg,
                association[i],
                rows[chunk],
                score[chunk],
                small[chunk],
                ints[chunk],
            )


@njit(cache=True, parallel=True)
def move(pose, pose_g, theta, velocity, dt, chunks):
    """Advance poses by sampled body velocities (N, 6), corrected by the nuisance mean; carry the sensitivities.

    velocity: measured less sampled noise. The paper's motion model, with heading taken at mid-interval.
    """
    n = pose.shape[0]
    sites = theta.shape[1] - 2
    for chunk in prange(chunks):
        for i in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            u, p, g = velocity[i], pose[i], pose_g[i]
            stretch = 1.0 / (1.0 + theta[i, sites + 1])
            turn = (u[3] - theta[i, sites]) * dt
            psi, the, phi = p[3] + 0.5 * turn, p[4] + 0.5 * u[4] * dt, p[5] + 0.5 * u[5] * dt
            cp, sp, ct, st, cr, sr = (
                math.cos(psi),
                math.sin(psi),
                math.cos(the),
                math.sin(the),
                math.cos(phi),
                math.sin(phi),
            )
            ux, uy, uz = u[0] * stretch * dt, u[1] * dt, u[2] * dt
            mx = cp * ct * ux + (cp * st * sr - sp * cr) * uy + (cp * st * cr + sp * sr) * uz
            my = sp * ct * ux + (sp * st * sr + cp * cr) * uy + (sp * st * cr - cp * sr) * uz
            p[0] += mx
            p[1] += my
            p[2] += -st * ux + ct * sr * uy + ct * cr * uz
            p[3] += turn
            p[4] += u[4] * dt
            p[5] += u[5] * dt
            # d(x, y)/d(bias, scale): through the heading at mid-interval, and through the stretch
            mid_bias, mid_scale = g[4] - 0.5 * dt, g[5]
            g[0] -= my * mid_bias
            g[2] += mx * mid_bias
            g[1] -= my * mid_scale + cp * ct * ux * stretch
            g[3] += mx * mid_scale - sp * ct * ux * stretch
            g[4] -= dt
