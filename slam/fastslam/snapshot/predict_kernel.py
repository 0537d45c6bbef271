"""Compiled: one track as each particle of a block sees it.

Every loop runs over the LANES particles of a block at constant offsets of the scratch array (see layout).
"""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.fastslam.parts.clock import expect, widen
from cellslam.slam.fastslam.parts.landmarks import moved, place, slopes
from cellslam.slam.fastslam.state.layout import (
    ANCHOR,
    BIAS0,
    GAIN,
    LANES,
    MU,
    O_A,
    O_C,
    O_FLAT,
    O_FULL,
    O_H,
    O_MU,
    O_OFFSET,
    O_S,
    O_X,
    O_Y,
    O_Z,
    OFFSET0,
    SCALE0,
    SIGMA,
    W_BIAS,
    W_DROT,
    W_G,
    W_P,
    W_POSE,
    W_ROT,
    W_SCALE,
)

B = LANES


def _congruence_at(symmetric, matrix, target):
    """Return a kernel that writes M S M^T (6 rows of `out` at `target`) for symmetric S (6 rows of `source`) and M (9
    rows of `out`), all at constant places."""
    s, m, o = symmetric * B, matrix * B, target * B

    @njit(cache=True, error_model="numpy")
    def congruence(source, out):
        for l in range(B):
            s0, s1, s2 = source[s + l], source[s + B + l], source[s + 2 * B + l]
            s3, s4, s5 = source[s + 3 * B + l], source[s + 4 * B + l], source[s + 5 * B + l]
            m0, m1, m2 = out[m + l], out[m + B + l], out[m + 2 * B + l]
            m3, m4, m5 = out[m + 3 * B + l], out[m + 4 * B + l], out[m + 5 * B + l]
            m6, m7, m8 = out[m + 6 * B + l], out[m + 7 * B + l], out[m + 8 * B + l]
            a0, a1, a2 = m0 * s0 + m1 * s1 + m2 * s2, m0 * s1 + m1 * s3 + m2 * s4, m0 * s2 + m1 * s4 + m2 * s5
            b0, b1, b2 = m3 * s0 + m4 * s1 + m5 * s2, m3 * s1 + m4 * s3 + m5 * s4, m3 * s2 + m4 * s4 + m5 * s5
            c0, c1, c2 = m6 * s0 + m7 * s1 + m8 * s2, m6 * s1 + m7 * s3 + m8 * s4, m6 * s2 + m7 * s4 + m8 * s5
            out[o + l] = a0 * m0 + a1 * m1 + a2 * m2
            out[o + B + l] = a0 * m3 + a1 * m4 + a2 * m5
            out[o + 2 * B + l] = a0 * m6 + a1 * m7 + a2 * m8
            out[o + 3 * B + l] = b0 * m3 + b1 * m4 + b2 * m5
            out[o + 4 * B + l] = b0 * m6 + b1 * m7 + b2 * m8
            out[o + 5 * B + l] = c0 * m6 + c1 * m7 + c2 * m8

    return congruence


_spread_of_vt = _congruence_at(SIGMA, O_H, O_S)
_spread_of_nuisances = _congruence_at(W_P, O_A, O_C)


@njit(error_model="numpy")
def predict(parts, w, rec, out):
    """Predict a record: h, H, A, S = H Sigma H^T, C = A P A^T (method.md: gate), lane by lane."""
    F = w.dtype.type
    expect(parts.clock, parts.landmarks, w, rec, out)
    for l in range(B):
        db, dg = out[O_OFFSET * B + l] - rec[OFFSET0 * B + l], w[W_BIAS * B + l] - rec[BIAS0 * B + l]
        ds = w[W_SCALE * B + l] - rec[SCALE0 * B + l]
        g00, g01, g02 = rec[GAIN * B + l], rec[(GAIN + 1) * B + l], rec[(GAIN + 2) * B + l]
        g10, g11, g12 = rec[(GAIN + 3) * B + l], rec[(GAIN + 4) * B + l], rec[(GAIN + 5) * B + l]
        g20, g21, g22 = rec[(GAIN + 6) * B + l], rec[(GAIN + 7) * B + l], rec[(GAIN + 8) * B + l]
        anchor = rec[ANCHOR * B + l], rec[(ANCHOR + 1) * B + l], rec[(ANCHOR + 2) * B + l]
        old = (
            rec[MU * B + l],
            rec[(MU + 1) * B + l],
            rec[(MU + 2) * B + l],
            rec[(MU + 3) * B + l],
            rec[(MU + 4) * B + l],
        )
        first, second = g00 * db + g01 * dg + g02 * ds, g10 * db + g11 * dg + g12 * ds
        mu = moved(parts.landmarks, F, old, first, second, g20 * db + g21 * dg + g22 * ds)
        out[O_MU * B + l] = mu[0]
        out[(O_MU + 1) * B + l] = mu[1]
        out[(O_MU + 2) * B + l] = mu[2]
        out[(O_MU + 3) * B + l] = mu[3]
        out[(O_MU + 4) * B + l] = mu[4]
        vx, vy, vz = place(parts.landmarks, F, anchor, mu)
        xx, xy, xz, yx, yy, yz, zx, zy, zz = slopes(parts.landmarks, F, mu)
        wx, wy, wz = vx - w[W_POSE * B + l], vy - w[(W_POSE + 1) * B + l], vz - w[(W_POSE + 2) * B + l]
        r0, r1, r2 = w[W_ROT * B + l], w[(W_ROT + 1) * B + l], w[(W_ROT + 2) * B + l]
        r3, r4, r5 = w[(W_ROT + 3) * B + l], w[(W_ROT + 4) * B + l], w[(W_ROT + 5) * B + l]
        r6, r7, r8 = w[(W_ROT + 6) * B + l], w[(W_ROT + 7) * B + l], w[(W_ROT + 8) * B + l]
        x, y, z = r0 * wx + r3 * wy + r6 * wz, r1 * wx + r4 * wy + r7 * wz, r2 * wx + r5 * wy + r8 * wz
        flat2 = max(x * x + y * y, F(1e-6))
        full2 = flat2 + z * z
        flat, full = math.sqrt(flat2), math.sqrt(full2)
        out[O_X * B + l] = x
        out[O_Y * B + l] = y
        out[O_Z * B + l] = z
        out[O_FLAT * B + l] = flat
        out[O_FULL * B + l] = full
        # M = d(distance, azimuth, elevation)/d(body vector); V = M R^T
        i1, i2 = F(1.0) / full, F(1.0) / flat2
        k = i1 * i1 / flat
        m0, m1, m2, m3, m4 = x * i1, y * i1, z * i1, -y * i2, x * i2
        m6, m7, m8 = -x * z * k, -y * z * k, flat * i1 * i1
        v0, v1, v2 = m0 * r0 + m1 * r1 + m2 * r2, m0 * r3 + m1 * r4 + m2 * r5, m0 * r6 + m1 * r7 + m2 * r8
        v3, v4, v5 = m3 * r0 + m4 * r1, m3 * r3 + m4 * r4, m3 * r6 + m4 * r7
        v6, v7, v8 = m6 * r0 + m7 * r1 + m8 * r2, m6 * r3 + m7 * r4 + m8 * r5, m6 * r6 + m7 * r7 + m8 * r8
        # H = V d(position)/ds
        h0, h1, h2 = v0 * xx + v1 * yx + v2 * zx, v0 * xy + v1 * yy + v2 * zy, v0 * xz + v1 * yz + v2 * zz
        h3, h4, h5 = v3 * xx + v4 * yx + v5 * zx, v3 * xy + v4 * yy + v5 * zy, v3 * xz + v4 * yz + v5 * zz
        h6, h7, h8 = v6 * xx + v7 * yx + v8 * zx, v6 * xy + v7 * yy + v8 * zy, v6 * xz + v7 * yz + v8 * zz
        out[O_H * B + l] = h0
        out[(O_H + 1) * B + l] = h1
        out[(O_H + 2) * B + l] = h2
        out[(O_H + 3) * B + l] = h3
        out[(O_H + 4) * B + l] = h4
        out[(O_H + 5) * B + l] = h5
        out[(O_H + 6) * B + l] = h6
        out[(O_H + 7) * B + l] = h7
        out[(O_H + 8) * B + l] = h8
        # what yaw does: M (dR/dpsi)^T (v - r)
        q0, q1, q3 = w[W_DROT * B + l], w[(W_DROT + 1) * B + l], w[(W_DROT + 3) * B + l]
        q2, q4, q5 = w[(W_DROT + 2) * B + l], w[(W_DROT + 4) * B + l], w[(W_DROT + 5) * B + l]
        bx, by, bz = q0 * wx + q3 * wy, q1 * wx + q4 * wy, q2 * wx + q5 * wy
        t0, t1, t2 = m0 * bx + m1 * by + m2 * bz, m3 * bx + m4 * by, m6 * bx + m7 * by + m8 * bz
        # A = H G + H_pose G_pose + e_d e_b^T
        pxb, pxs, pyb = w[W_G * B + l], w[(W_G + 1) * B + l], w[(W_G + 2) * B + l]
        pys, ppb, pps = w[(W_G + 3) * B + l], w[(W_G + 4) * B + l], w[(W_G + 5) * B + l]
        a0 = h0 * g00 + h1 * g10 + h2 * g20 + F(1.0)
        a1 = h0 * g01 + h1 * g11 + h2 * g21 + t0 * ppb - v0 * pxb - v1 * pyb
        a2 = h0 * g02 + h1 * g12 + h2 * g22 + t0 * pps - v0 * pxs - v1 * pys
        a3 = h3 * g00 + h4 * g10 + h5 * g20
        a4 = h3 * g01 + h4 * g11 + h5 * g21 + t1 * ppb - v3 * pxb - v4 * pyb
        a5 = h3 * g02 + h4 * g12 + h5 * g22 + t1 * pps - v3 * pxs - v4 * pys
        a6 = h6 * g00 + h7 * g10 + h8 * g20
        a7 = h6 * g01 + h7 * g11 + h8 * g21 + t2 * ppb - v6 * pxb - v7 * pyb
        a8 = h6 * g02 + h7 * g12 + h8 * g22 + t2 * pps - v6 * pxs - v7 * pys
        out[O_A * B + l] = a0
        out[(O_A + 1) * B + l] = a1
        out[(O_A + 2) * B + l] = a2
        out[(O_A + 3) * B + l] = a3
        out[(O_A + 4) * B + l] = a4
        out[(O_A + 5) * B + l] = a5
        out[(O_A + 6) * B + l] = a6
        out[(O_A + 7) * B + l] = a7
        out[(O_A + 8) * B + l] = a8
    _spread_of_vt(rec, out)
    _spread_of_nuisances(w, out)
    widen(parts.clock, w, rec, out)
