"""Compiled: the paper's FastSLAM, a snapshot for every particle. Cartesian VTs, an EKF each, Hungarian association."""

from __future__ import annotations

import math

from numba import prange

from cellslam.sim.compiling import njit
from cellslam.slam.model.assignment_kernel import assign

LAST, IDENT = 0, 1
SLACK = 1e-3  # m^2: rounding, and that a predicted distance is never below a millimetre


@njit(cache=True)
def _predict(pose, rot, vt, h, by):
    """Write h (3,) and dh/dv (3, 3) for a VT (3,) seen from a pose with rotation rot (3, 3) (paper, eq. for h)."""
    wx, wy, wz = vt[0] - pose[0], vt[1] - pose[1], vt[2] - pose[2]
    x = rot[0, 0] * wx + rot[1, 0] * wy + rot[2, 0] * wz
    y = rot[0, 1] * wx + rot[1, 1] * wy + rot[2, 1] * wz
    z = rot[0, 2] * wx + rot[1, 2] * wy + rot[2, 2] * wz
    flat2 = max(x * x + y * y, 1e-6)
    full2 = flat2 + z * z
    flat, full = math.sqrt(flat2), math.sqrt(full2)
    h[0], h[1], h[2] = full, math.atan2(y, x), math.atan2(z, flat)
    for c in range(3):
        a, b, d = rot[c, 0], rot[c, 1], rot[c, 2]
        by[0, c] = (x * a + y * b + z * d) / full
        by[1, c] = (-y * a + x * b) / flat2
        by[2, c] = (-(x * a + y * b) * z / flat + flat * d) / full2


@njit(cache=True)
def _spread(by, cov, t, p):
    """Write T = H Sigma and P = T H^T (corrected: the paper prints H^T Sigma H)."""
    for r in range(3):
        for c in range(3):
            t[r, c] = by[r, 0] * cov[0, c] + by[r, 1] * cov[1, c] + by[r, 2] * cov[2, c]
    for r in range(3):
        for c in range(3):
            p[r, c] = t[r, 0] * by[c, 0] + t[r, 1] * by[c, 1] + t[r, 2] * by[c, 2]


@njit(cache=True)
def _invert(p, q, s):
    """Write the inverse of S = P + Q; return det S."""
    a, b, c, d, e, f = p[0, 0] + q[0], p[0, 1], p[0, 2], p[1, 1] + q[1], p[1, 2], p[2, 2] + q[2]
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m0 + b * m1 + c * m2
    s[0, 0], s[1, 1], s[2, 2] = m0 / det, (a * f - c * c) / det, (a * d - b * b) / det
    s[0, 1] = s[1, 0] = m1 / det
    s[0, 2] = s[2, 0] = m2 / det
    s[1, 2] = s[2, 1] = (b * c - a * e) / det
    return det


@njit(cache=True)
def _distance2(z, offset, h, s, e):
    """Write the innovation e (3,) and return its squared Mahalanobis distance."""
    e[0], e[2] = z[0] - offset - h[0], z[2] - h[2]
    turn = z[1] - h[1]
    e[1] = turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))
    total = 0.0
    for r in range(3):
        for c in range(3):
            total += e[r] * s[r, c] * e[c]
    return total


@njit(cache=True)
def _birth(pose, rot, z, offset, q, mean, cov):
    """Write mean and covariance of the VT that a measurement points to: Sigma = J Q J^T."""
    rho = max(z[0] - offset, 1.0)
    ca, sa, ce, se = math.cos(z[1]), math.sin(z[1]), math.cos(z[2]), math.sin(z[2])
    for r in range(3):
        a, b, d = rot[r, 0], rot[r, 1], rot[r, 2]
        mean[r] = pose[r] + rho * (a * ce * ca + b * ce * sa + d * se)
        j0 = a * ce * ca + b * ce * sa + d * se
        j1, j2 = rho * ce * (b * ca - a * sa), rho * (d * ce - se * (a * ca + b * sa))
        for c in range(3):
            a2, b2, d2 = rot[c, 0], rot[c, 1], rot[c, 2]
            k0 = a2 * ce * ca + b2 * ce * sa + d2 * se
            k1, k2 = rho * ce * (b2 * ca - a2 * sa), rho * (d2 * ce - se * (a2 * ca + b2 * sa))
            cov[r, c] = q[0] * j0 * k0 + q[1] * j1 * k1 + q[2] * j2 * k2


@njit(cache=True)
def _within_reach(pose, means, covs, link, count, z, q, start, stop, offset, gate, near):
    """Write which of a link's `count` VTs may have a measurement within the gate, by distance; return how many.

    No component alone has a greater normalised distance than all three, and the variance of the predicted distance is
    at most the trace of the VT's covariance: what is too far off by that needs no Jacobian.
    """
    found = 0
    for j in range(count):
        x, y, z_up = means[link, j, 0] - pose[0], means[link, j, 1] - pose[1], means[link, j, 2] - pose[2]
        full = math.sqrt(x * x + y * y + z_up * z_up)
        most = covs[link, j, 0, 0] + covs[link, j, 1, 1] + covs[link, j, 2, 2]
        near[found] = j
        for k in range(start, stop):
            e = z[k, 0] - offset - full
            if e * e <= gate * (most + q[k, 0]) + SLACK:
                found += 1
                break
    return found


@njit(cache=True)
def _score(pose, rot, mean, cov, z, q, start, stop, offset, gate, score, h, s):
    """Write by how much each measurement of a link is within a VT's gate, at most 0 where not; return if any is."""
    by, t, e, p = h[1:4], h[4:7], h[7], s[3:]
    _predict(pose, rot, mean, h[0], by)
    _spread(by, cov, t, p)
    found = False
    for k in range(start, stop):
        score[k - start] = -1.0
        e0 = z[k, 0] - offset - h[0, 0]
        if e0 * e0 > gate * (p[0, 0] + q[k, 0]):
            continue
        det = _invert(p, q[k], s)
        distance2 = _distance2(z[k], offset, h[0], s, e)
        # A covariance that rounding has spoilt takes no measurement.
        if det > 0.0 and distance2 >= 0.0:
            score[k - start] = gate - distance2
            found |= distance2 < gate
    return found


@njit(cache=True)
def _particle(now, pose, rot, means, covs, slots, counts, first, offset_of, z, q, born, gate, association, score, h, s,
              work_f, work_i):  # fmt: skip
    weight = 0.0
    by, t, e = h[1:4], h[4:7], h[7]
    rows, places = len(z) + 1, means.shape[1]
    row_of, near, solver = work_i[:rows], work_i[rows : rows + places + 1], work_i[rows + places + 1 :]
    for link in range(len(first) - 1):
        start, stop, count = first[link], first[link + 1], counts[link]
        rivals = 0  # VTs with a measurement within the gate: the solver need not know of others
        possible = _within_reach(pose, means, covs, link, count, z, q, start, stop, offset_of[link], gate, near)
        for n in range(possible):
            near[rivals] = j = near[n]
            rivals += _score(
                pose, rot, means[link, j], covs[link, j], z, q, start, stop, offset_of[link], gate, score[rivals], h, s
            )
        assign(score, rivals, stop - start, row_of, work_f, solver)
        for k in range(start, stop):
            association[k] = -1
            if row_of[k - start] >= 0:
                j = near[row_of[k - start]]
                mean, cov = means[link, j], covs[link, j]
                _predict(pose, rot, mean, h[0], by)
                _spread(by, cov, t, s[3:])
                det = _invert(s[3:], q[k], s)
                distance2 = _distance2(z[k], offset_of[link], h[0], s, e)
                weight += -0.5 * distance2 - 0.5 * math.log(det) - 1.5 * math.log(2.0 * math.pi)
                for r in range(3):
                    for c in range(3):
                        by[r, c] = t[0, r] * s[0, c] + t[1, r] * s[1, c] + t[2, r] * s[2, c]
                for r in range(3):
                    for c in range(3):
                        mean[r] += by[r, c] * e[c]
                for r in range(3):
                    for c in range(r, 3):
                        value = cov[r, c] - (by[r, 0] * t[0, c] + by[r, 1] * t[1, c] + by[r, 2] * t[2, c])
                        cov[r, c] = cov[c, r] = value
                slots[link, j, LAST] = now
                association[k] = slots[link, j, IDENT]
        for k in range(start, stop):
            if row_of[k - start] < 0:
                j = counts[link]
                if j == means.shape[1]:
                    j = 0
                    for i in range(means.shape[1]):
                        if slots[link, i, LAST] < slots[link, j, LAST]:
                            j = i
                else:
                    counts[link] += 1
                _birth(pose, rot, z[k], offset_of[link], q[k], means[link, j], covs[link, j])
                slots[link, j, LAST], slots[link, j, IDENT] = now, born + k
    return weight


@njit(cache=True, parallel=True)
def use_snapshot(now, pose, rot, means, covs, slots, counts, first, offset_of, z, q, born, gate, log_weight,
                 association, score, h, s, work_f, work_i):  # fmt: skip
    """Use one snapshot in N particles.

    pose (N, 6), rot (N, 3, 3); maps, written: means (N, L, C, 3), covs (N, L, C, 3, 3), slots (N, L, C, 2), counts
    (N, L); first (L + 1,), z, q (M, 3); offset_of (L,): clock offset taken for each link; log_weight (N,) is added to,
    association (N, M) written. score, h (., 8, 3), s (., 6, 3), work_f, work_i: scratch, one a particle.
    """
    for i in prange(len(pose)):
        log_weight[i] += _particle(
            now, pose[i], rot[i], means[i], covs[i], slots[i], counts[i], first, offset_of, z, q, born, gate,
            association[i], score[i], h[i], s[i], work_f[i], work_i[i],
        )  # fmt: skip
