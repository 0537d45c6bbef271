"""Compiled: innovation of one measurement, its likelihood, and the Kalman update of the whole state."""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.ekf_slam.motion_kernel import rotations
from cellslam.slam.ekf_slam.state_layout import BY_POSE, BY_VT, PREDICTED
from cellslam.slam.ekf_slam.vt_kernel import gains, predict

LOG_2PI = math.log(2.0 * math.pi)


@njit(cache=True)
def innovate(g, z, b, e, s, q):
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
def cholesky(s):
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
def log_likelihood(e, s):
    """Return e^T S^-1 e and log det S; infinite where S has no root."""
    a, b, c, d, f, h = cholesky(s)
    if a == 0.0:
        return math.inf, 0.0
    w0 = e[0] / a
    w1 = (e[1] - b * w0) / d
    w2 = (e[2] - c * w0 - f * w1) / h
    return w0 * w0 + w1 * w1 + w2 * w2, 2.0 * math.log(a * d * h)


@njit(cache=True)
def spread(g, x, p, size, anchor, offset, v, mapped, s, t):
    """Predict the VT at state v; write T = H P (3, size) into t and H P H^T into s (3, 3)."""
    rotations(g, x[3], x[4], x[5])
    predict(g, x, anchor, v)
    gains(g, p, size, offset, v, mapped, t)
    innovation_of(g, t, offset, v, mapped, s)


@njit(cache=True)
def innovation_of(g, t, offset, v, mapped, s):
    """Write S = T H^T (3, 3) into s."""
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


@njit(cache=True)
def explained(g, size, offset, v, mapped, t, pending, k):
    """Take out of T = H P (3, size) what the first k rows of `pending` have explained: T <- T - (H G^T) G."""
    for j in range(0, k, 3):
        g0, g1, g2 = pending[j], pending[j + 1], pending[j + 2]
        a0, b0, c0 = g0[offset], g1[offset], g2[offset]
        a1, a2, b1, b2, c1, c2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(9 if mapped else 6):
            at = i if i < 6 else v + i - 6
            h = BY_POSE + i if i < 6 else BY_VT + i - 6
            step = 6 if i < 6 else 3
            h0, h1, h2 = g[h], g[h + step], g[h + 2 * step]
            a0, a1, a2 = a0 + h0 * g0[at], a1 + h1 * g0[at], a2 + h2 * g0[at]
            b0, b1, b2 = b0 + h0 * g1[at], b1 + h1 * g1[at], b2 + h2 * g1[at]
            c0, c1, c2 = c0 + h0 * g2[at], c1 + h1 * g2[at], c2 + h2 * g2[at]
        t0, t1, t2 = t[0], t[1], t[2]
        for x in range(size):
            y0, y1, y2 = g0[x], g1[x], g2[x]
            t0[x] -= a0 * y0 + b0 * y1 + c0 * y2
            t1[x] -= a1 * y0 + b1 * y1 + c1 * y2
            t2[x] -= a2 * y0 + b2 * y1 + c2 * y2


@njit(cache=True)
def update(g, x, p, size, anchor, offset, v, mapped, z, q, e, s, t, pending, k):
    """Kalman update of the whole state by one measurement of the VT at state v; return log N(e; 0, S), and k.

    P stays as it is: what the update takes off it is left in three more rows of `pending`, P - G^T G being meant.
    """
    rotations(g, x[3], x[4], x[5])
    predict(g, x, anchor, v)
    gains(g, p, size, offset, v, mapped, t)
    explained(g, size, offset, v, mapped, t, pending, k)
    innovation_of(g, t, offset, v, mapped, s)
    for r in range(3):
        if math.isnan(z[r]):
            for j in range(size):
                t[r, j] = 0.0
    measured = innovate(g, z, x[offset], e, s, q)
    l0, l1, l2, l3, l4, l5 = cholesky(s)
    if l0 == 0.0:
        return 0.0, k
    w0 = e[0] / l0
    w1 = (e[1] - l1 * w0) / l3
    w2 = (e[2] - l2 * w0 - l4 * w1) / l5
    g0, g1, g2 = pending[k], pending[k + 1], pending[k + 2]
    for j in range(size):
        u0 = t[0, j] / l0
        u1 = (t[1, j] - l1 * u0) / l3
        u2 = (t[2, j] - l2 * u0 - l4 * u1) / l5
        g0[j], g1[j], g2[j] = u0, u1, u2
        x[j] += u0 * w0 + u1 * w1 + u2 * w2
    value = -0.5 * (w0 * w0 + w1 * w1 + w2 * w2) - math.log(l0 * l3 * l5) - 0.5 * measured * LOG_2PI
    return value, k + 3
