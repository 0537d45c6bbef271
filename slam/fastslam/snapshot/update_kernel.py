"""Compiled: what one association does to a track and to the particle's weight."""

from __future__ import annotations

import numpy as np
from numba import njit

from cellslam.slam.fastslam.parts.criterion import LOG_2PI_3
from cellslam.slam.fastslam.parts.landmarks import corrected
from cellslam.slam.fastslam.state.layout import (
    BIAS0,
    GAIN,
    HITS,
    LANES,
    MU,
    O_A,
    O_H,
    O_MU,
    O_OFFSET,
    O_SCORE,
    OFFSET0,
    SCALE0,
    SIGMA,
    V_WEIGHT,
    W_BIAS,
    W_D2,
    W_E,
    W_INV,
    W_LOG,
    W_MASK,
    W_SCALE,
)

B = LANES


@njit(error_model="numpy")
def correct(parts, w, rec, out):
    """Update a record where W_MASK is 1: K = Sigma H^T S^-1, mu += K e, G -= K A, Sigma -= K H Sigma
    (method.md)."""
    F = w.dtype.type
    for l in range(B):
        i0, i1, i2 = w[W_INV * B + l], w[(W_INV + 1) * B + l], w[(W_INV + 2) * B + l]
        i3, i4, i5 = w[(W_INV + 3) * B + l], w[(W_INV + 4) * B + l], w[(W_INV + 5) * B + l]
        a, b, c = rec[SIGMA * B + l], rec[(SIGMA + 1) * B + l], rec[(SIGMA + 2) * B + l]
        d, e, f = rec[(SIGMA + 3) * B + l], rec[(SIGMA + 4) * B + l], rec[(SIGMA + 5) * B + l]
        h0, h1, h2 = out[O_H * B + l], out[(O_H + 1) * B + l], out[(O_H + 2) * B + l]
        h3, h4, h5 = out[(O_H + 3) * B + l], out[(O_H + 4) * B + l], out[(O_H + 5) * B + l]
        h6, h7, h8 = out[(O_H + 6) * B + l], out[(O_H + 7) * B + l], out[(O_H + 8) * B + l]
        t00, t01, t02 = h0 * a + h1 * b + h2 * c, h0 * b + h1 * d + h2 * e, h0 * c + h1 * e + h2 * f
        t10, t11, t12 = h3 * a + h4 * b + h5 * c, h3 * b + h4 * d + h5 * e, h3 * c + h4 * e + h5 * f
        t20, t21, t22 = h6 * a + h7 * b + h8 * c, h6 * b + h7 * d + h8 * e, h6 * c + h7 * e + h8 * f
        on = w[W_MASK * B + l]
        k00, k01, k02 = on * (t00 * i0 + t10 * i1 + t20 * i2), on * (t00 * i1 + t10 * i3 + t20 * i4), F(0.0)
        k02 = on * (t00 * i2 + t10 * i4 + t20 * i5)
        k10, k11, k12 = on * (t01 * i0 + t11 * i1 + t21 * i2), on * (t01 * i1 + t11 * i3 + t21 * i4), F(0.0)
        k12 = on * (t01 * i2 + t11 * i4 + t21 * i5)
        k20, k21, k22 = on * (t02 * i0 + t12 * i1 + t22 * i2), on * (t02 * i1 + t12 * i3 + t22 * i4), F(0.0)
        k22 = on * (t02 * i2 + t12 * i4 + t22 * i5)
        e0, e1, e2 = w[W_E * B + l], w[(W_E + 1) * B + l], w[(W_E + 2) * B + l]
        old = F(1.0) - on
        mu = (
            out[O_MU * B + l], out[(O_MU + 1) * B + l], out[(O_MU + 2) * B + l], out[(O_MU + 3) * B + l],
            out[(O_MU + 4) * B + l],
        )  # fmt: skip
        first, second = k00 * e0 + k01 * e1 + k02 * e2, k10 * e0 + k11 * e1 + k12 * e2
        m0, m1, m2, m3, m4 = corrected(parts.landmarks, F, mu, first, second, k20 * e0 + k21 * e1 + k22 * e2)
        rec[MU * B + l] = m0 if on > F(0.5) else rec[MU * B + l]
        rec[(MU + 1) * B + l] = m1 if on > F(0.5) else rec[(MU + 1) * B + l]
        rec[(MU + 2) * B + l] = m2 if on > F(0.5) else rec[(MU + 2) * B + l]
        rec[(MU + 3) * B + l] = m3 if on > F(0.5) else rec[(MU + 3) * B + l]
        rec[(MU + 4) * B + l] = m4 if on > F(0.5) else rec[(MU + 4) * B + l]
        a0, a1, a2 = out[O_A * B + l], out[(O_A + 1) * B + l], out[(O_A + 2) * B + l]
        a3, a4, a5 = out[(O_A + 3) * B + l], out[(O_A + 4) * B + l], out[(O_A + 5) * B + l]
        a6, a7, a8 = out[(O_A + 6) * B + l], out[(O_A + 7) * B + l], out[(O_A + 8) * B + l]
        rec[GAIN * B + l] -= k00 * a0 + k01 * a3 + k02 * a6
        rec[(GAIN + 1) * B + l] -= k00 * a1 + k01 * a4 + k02 * a7
        rec[(GAIN + 2) * B + l] -= k00 * a2 + k01 * a5 + k02 * a8
        rec[(GAIN + 3) * B + l] -= k10 * a0 + k11 * a3 + k12 * a6
        rec[(GAIN + 4) * B + l] -= k10 * a1 + k11 * a4 + k12 * a7
        rec[(GAIN + 5) * B + l] -= k10 * a2 + k11 * a5 + k12 * a8
        rec[(GAIN + 6) * B + l] -= k20 * a0 + k21 * a3 + k22 * a6
        rec[(GAIN + 7) * B + l] -= k20 * a1 + k21 * a4 + k22 * a7
        rec[(GAIN + 8) * B + l] -= k20 * a2 + k21 * a5 + k22 * a8
        rec[SIGMA * B + l] = a - (k00 * t00 + k01 * t10 + k02 * t20)
        rec[(SIGMA + 1) * B + l] = b - (k00 * t01 + k01 * t11 + k02 * t21)
        rec[(SIGMA + 2) * B + l] = c - (k00 * t02 + k01 * t12 + k02 * t22)
        rec[(SIGMA + 3) * B + l] = d - (k10 * t01 + k11 * t11 + k12 * t21)
        rec[(SIGMA + 4) * B + l] = e - (k10 * t02 + k11 * t12 + k12 * t22)
        rec[(SIGMA + 5) * B + l] = f - (k20 * t02 + k21 * t12 + k22 * t22)
        rec[HITS * B + l] += on
        rec[OFFSET0 * B + l] = on * out[O_OFFSET * B + l] + old * rec[OFFSET0 * B + l]
        rec[BIAS0 * B + l] = on * w[W_BIAS * B + l] + old * rec[BIAS0 * B + l]
        rec[SCALE0 * B + l] = on * w[W_SCALE * B + l] + old * rec[SCALE0 * B + l]


@njit(cache=True, error_model="numpy")
def credit(w, v, out, lack, share):
    """Add what the association at hand is worth, where W_MASK is 1: the fit e^T S^-1 e, and `share` of all the rest.

    `lack`: see `measurement_kernel.pack`. The links of a site see the same VT come and go, so that each counts for its
    share only.
    """
    F = w.dtype.type
    half, part, rest = F(0.5), F(share), F(lack - LOG_2PI_3)
    for l in range(B):
        value = part * (out[O_SCORE * B + l] + rest - half * w[W_LOG * B + l]) - half * w[W_D2 * B + l]
        v[V_WEIGHT * B + l] += value if w[W_MASK * B + l] > half else F(0.0)


@njit(cache=True, error_model="numpy")
def mask(w, row_of, q):
    """Set W_MASK to 1 in the lanes whose measurement goes to track q; return whether there are any."""
    F = w.dtype.type
    wanted, any_ = np.int32(q), np.int32(0)
    for l in range(B):
        w[W_MASK * B + l] = F(1.0) if row_of[l] == wanted else F(0.0)
        any_ |= np.int32(row_of[l] == wanted)
    return any_ != 0
