"""Compiled: one track as each particle of a block sees it; one measurement against it; the update; the birth.

Every loop runs over the LANES particles of a block at constant offsets of the scratch array (see layout). Angles
never leave the
unit circle: a difference of angles comes from cross and dot product, a small turn from its power series.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.fastslam.layout import (
    ANCHOR,
    BIAS0,
    CA,
    CE,
    GAIN,
    HITS,
    LANES,
    O_A,
    O_C,
    O_CA,
    O_CE,
    O_FLAT,
    O_FULL,
    O_H,
    O_RANGE,
    O_S,
    O_SA,
    O_SCORE,
    O_SE,
    O_X,
    O_Y,
    O_Z,
    OFFSET0,
    RANGE,
    SA,
    SCALE0,
    SE,
    SIGMA,
    W_B,
    W_BIAS,
    W_D2,
    W_DET,
    W_DROT,
    W_E,
    W_EXPONENT,
    W_G,
    W_GUESS,
    W_INV,
    W_LOG,
    W_MASK,
    W_P,
    W_POSE,
    W_REACH,
    W_ROT,
    W_SCALE,
    W_SCORE,
)
from cellslam.slam.fastslam.measurement_kernel import LEAST_RANGE_M, MOST_RANGE_M, evenly

B = LANES
LOG_2PI_3 = 1.5 * math.log(2.0 * math.pi)


@njit(cache=True, error_model="numpy")
def _sine(F, x):
    """Sine of a small angle, |x| < 0.5, to 1e-11."""
    q = x * x
    return x * (F(1.0) - q * (F(1 / 6) - q * (F(1 / 120) - q * (F(1 / 5040) - q * F(1 / 362880)))))


@njit(cache=True, error_model="numpy")
def _cosine(F, x):
    """Cosine of a small angle, |x| < 0.5, to 1e-10."""
    q = x * x
    return F(1.0) - q * (F(0.5) - q * (F(1 / 24) - q * (F(1 / 720) - q * F(1 / 40320))))


@njit(cache=True, error_model="numpy")
def _arc_tangent(F, t):
    """Arc tangent for |t| <= 0.66 to double precision (rational approximation of S. Moshier's Cephes library)."""
    q = t * t
    p = ((-F(0.8750608600031904) * q - F(16.15753718733365)) * q - F(75.00855792314705)) * q - F(122.8866684490136)
    p = p * q - F(64.85021904942025)
    d = (((q + F(24.85846490142306)) * q + F(165.0270098316989)) * q + F(432.8810604912903)) * q + F(485.3903996359137)
    d = d * q + F(194.5506571482614)
    return t + t * q * p / d


def _congruence_at(symmetric, matrix, place):
    """Return a kernel that writes M S M^T (6 rows of `out` at `place`) for symmetric S (6 rows of `source`) and M (9
    rows of `out`), all at constant places."""
    s, m, o = symmetric * B, matrix * B, place * B

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


@njit(cache=True, error_model="numpy")
def predict(w, rec, out):
    """Predict a record: h, H, A, S = H Sigma H^T, C = A P A^T (method.md: gate), lane by lane."""
    F = w.dtype.type
    for l in range(B):
        db, dg, ds = w[W_B * B + l] - rec[OFFSET0 * B + l], w[W_BIAS * B + l] - rec[BIAS0 * B + l], F(0.0)
        ds = w[W_SCALE * B + l] - rec[SCALE0 * B + l]
        g00, g01, g02 = rec[GAIN * B + l], rec[(GAIN + 1) * B + l], rec[(GAIN + 2) * B + l]
        g10, g11, g12 = rec[(GAIN + 3) * B + l], rec[(GAIN + 4) * B + l], rec[(GAIN + 5) * B + l]
        g20, g21, g22 = rec[(GAIN + 6) * B + l], rec[(GAIN + 7) * B + l], rec[(GAIN + 8) * B + l]
        rho = rec[RANGE * B + l] + g00 * db + g01 * dg + g02 * ds
        turn = g10 * db + g11 * dg + g12 * ds
        lift = g20 * db + g21 * dg + g22 * ds
        s, c = _sine(F, turn), _cosine(F, turn)
        ca, sa = rec[CA * B + l] * c - rec[SA * B + l] * s, rec[SA * B + l] * c + rec[CA * B + l] * s
        s, c = _sine(F, lift), _cosine(F, lift)
        ce, se = rec[CE * B + l] * c - rec[SE * B + l] * s, rec[SE * B + l] * c + rec[CE * B + l] * s
        out[O_RANGE * B + l] = rho
        out[O_CA * B + l] = ca
        out[O_SA * B + l] = sa
        out[O_CE * B + l] = ce
        out[O_SE * B + l] = se
        nx, ny = ce * ca, ce * sa
        wx = rec[ANCHOR * B + l] + rho * nx - w[W_POSE * B + l]
        wy = rec[(ANCHOR + 1) * B + l] + rho * ny - w[(W_POSE + 1) * B + l]
        wz = rec[(ANCHOR + 2) * B + l] + rho * se - w[(W_POSE + 2) * B + l]
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
        # H = V d(position)/d(range, azimuth, elevation)
        ax, ay, ex, ey, ez = -rho * ny, rho * nx, -rho * se * ca, -rho * se * sa, rho * ce
        h0, h1, h2 = v0 * nx + v1 * ny + v2 * se, v0 * ax + v1 * ay, v0 * ex + v1 * ey + v2 * ez
        h3, h4, h5 = v3 * nx + v4 * ny + v5 * se, v3 * ax + v4 * ay, v3 * ex + v4 * ey + v5 * ez
        h6, h7, h8 = v6 * nx + v7 * ny + v8 * se, v6 * ax + v7 * ay, v6 * ex + v7 * ey + v8 * ez
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
        yx, yy, yz = q0 * wx + q3 * wy, q1 * wx + q4 * wy, q2 * wx + q5 * wy
        t0, t1, t2 = m0 * yx + m1 * yy + m2 * yz, m3 * yx + m4 * yy, m6 * yx + m7 * yy + m8 * yz
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


@njit(cache=True, error_model="numpy")
def reach(w, out, first):
    """Write what each lane could measure, give or take 6 sigma, measurement noise not included: distances, and
    azimuths in the world frame against those of lane `first` (+-1.16 rad where they differ by more)."""
    F = w.dtype.type
    xr, yr, psi = out[O_X * B + first], out[O_Y * B + first], w[(W_POSE + 3) * B + first]
    flat_r = out[O_FLAT * B + first]
    for l in range(B):
        spread = F(6.0) * math.sqrt(max(out[O_S * B + l] + out[O_C * B + l], F(0.0)))
        expected = out[O_FULL * B + l] + w[W_B * B + l]
        w[W_REACH * B + l] = expected - spread
        w[(W_REACH + 1) * B + l] = expected + spread
    for l in range(B):
        spread = F(6.0) * math.sqrt(max(out[(O_S + 3) * B + l] + out[(O_C + 3) * B + l], F(0.0)))
        x, y, scale = out[O_X * B + l], out[O_Y * B + l], out[O_FLAT * B + l] * flat_r
        t = (xr * y - yr * x) / max(scale + xr * x + yr * y, F(1e-3) * scale)
        turn = F(2.0) * _arc_tangent(F, min(max(t, -F(0.66)), F(0.66))) + w[(W_POSE + 3) * B + l] - psi
        w[(W_REACH + 2) * B + l] = turn - spread
        w[(W_REACH + 3) * B + l] = turn + spread


@njit(cache=True, error_model="numpy")
def innovate(w, out, z):
    """Write e = z - h at W_E; z (12,): distance, cos and sin of azimuth and of elevation, 3 variances, 3 flags
    (measured).

    A component that was not measured has e = 0 and takes no part.
    """
    F = w.dtype.type
    d, ca, sa, ce, se, f0, f1, f2 = z[0], z[1], z[2], z[3], z[4], z[8], z[9], z[10]
    for l in range(B):
        x, y, flat = out[O_X * B + l], out[O_Y * B + l], out[O_FLAT * B + l]
        zz, full = out[O_Z * B + l], out[O_FULL * B + l]
        w[W_E * B + l] = f0 * (d - w[W_B * B + l] - full)
        t = (sa * x - ca * y) / max(flat + ca * x + sa * y, F(1e-3) * flat)
        w[(W_E + 1) * B + l] = f1 * F(2.0) * _arc_tangent(F, min(max(t, -F(0.66)), F(0.66)))
        t = (se * flat - ce * zz) / max(full + ce * flat + se * zz, F(1e-3) * full)
        w[(W_E + 2) * B + l] = f2 * F(2.0) * _arc_tangent(F, min(max(t, -F(0.66)), F(0.66)))


@njit(cache=True, error_model="numpy")
def invert(w, out, z, share):
    """Write S^-1 (6 rows at W_INV), det S and e^T S^-1 e for S = H Sigma H^T + share A P A^T + Q."""
    F = w.dtype.type
    share = F(share)
    q0, q1, q2, f0, f1, f2 = z[5], z[6], z[7], z[8], z[9], z[10]
    f01, f02, f12 = f0 * f1, f0 * f2, f1 * f2
    for l in range(B):
        a = f0 * (out[O_S * B + l] + share * out[O_C * B + l]) + q0
        b = f01 * (out[(O_S + 1) * B + l] + share * out[(O_C + 1) * B + l])
        c = f02 * (out[(O_S + 2) * B + l] + share * out[(O_C + 2) * B + l])
        d = f1 * (out[(O_S + 3) * B + l] + share * out[(O_C + 3) * B + l]) + q1
        e = f12 * (out[(O_S + 4) * B + l] + share * out[(O_C + 4) * B + l])
        f = f2 * (out[(O_S + 5) * B + l] + share * out[(O_C + 5) * B + l]) + q2
        m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
        det = a * m0 + b * m1 + c * m2
        s = F(1.0) / det
        i0, i1, i2, i3, i4, i5 = m0 * s, m1 * s, m2 * s, (a * f - c * c) * s, (b * c - a * e) * s, (a * d - b * b) * s
        x, y, zz = w[W_E * B + l], w[(W_E + 1) * B + l], w[(W_E + 2) * B + l]
        w[W_D2 * B + l] = i0 * x * x + i3 * y * y + i5 * zz * zz + F(2.0) * (i1 * x * y + i2 * x * zz + i4 * y * zz)
        w[W_DET * B + l] = det
        w[W_INV * B + l] = i0 * f0
        w[(W_INV + 1) * B + l] = i1 * f01
        w[(W_INV + 2) * B + l] = i2 * f02
        w[(W_INV + 3) * B + l] = i3 * f1
        w[(W_INV + 4) * B + l] = i4 * f12
        w[(W_INV + 5) * B + l] = i5 * f2


@njit(cache=True, error_model="numpy")
def logarithm(w, bits):
    """Write log det S at W_LOG; `bits` is W seen as integers of its size: exponent and mantissa are taken apart."""
    F = w.dtype.type
    if bits.itemsize == 4:
        _take_apart(w, bits, np.int32(23), np.int32(127), np.int32(0x007FFFFF), np.int32(0x3F800000))
    else:
        _take_apart(w, bits, np.int64(52), np.int64(1023), np.int64(0x000FFFFFFFFFFFFF), np.int64(0x3FF0000000000000))
    for l in range(B):
        m = w[W_LOG * B + l]
        t = (m - F(1.4142135623730951)) / (m + F(1.4142135623730951))
        q = t * t
        odd = F(1 / 7) + q * (F(1 / 9) + q * (F(1 / 11) + q * F(1 / 13)))
        series = F(2.0) * t * (F(1.0) + q * (F(1 / 3) + q * (F(1 / 5) + q * odd)))
        w[W_LOG * B + l] = w[W_EXPONENT * B + l] * F(0.6931471805599453) + F(0.34657359027997264) + series


@njit(cache=True, error_model="numpy")
def _take_apart(w, bits, width, bias, mantissa, one):
    """Write the binary exponent of det S at W_EXPONENT and its mantissa, 1 to 2, at W_LOG."""
    F = w.dtype.type
    for l in range(B):
        b = bits[W_DET * B + l]
        bits[W_LOG * B + l] = (b & mantissa) | one
        w[W_EXPONENT * B + l] = F((b >> width) - bias)


@njit(cache=True, error_model="numpy")
def score(w, out, gate, lack):
    """Write the pair's log-likelihood ratio at W_SCORE, -1e30 outside the gate or where the track's score is
    -1e30."""
    F = w.dtype.type
    limit, rest = F(gate), F(lack - LOG_2PI_3)
    for l in range(B):
        value = out[O_SCORE * B + l] - F(0.5) * w[W_D2 * B + l] - F(0.5) * w[W_LOG * B + l] + rest
        inside = w[W_D2 * B + l] < limit and w[W_DET * B + l] > F(0.0) and out[O_SCORE * B + l] > -F(1e29)
        w[W_SCORE * B + l] = value if inside else -F(1e30)


@njit(cache=True, error_model="numpy")
def correct(w, rec, out):
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
        rho = out[O_RANGE * B + l] + k00 * e0 + k01 * e1 + k02 * e2
        turn, lift = k10 * e0 + k11 * e1 + k12 * e2, k20 * e0 + k21 * e1 + k22 * e2
        rec[RANGE * B + l] = rho if on > F(0.5) else rec[RANGE * B + l]
        for_s, for_c = _sine(F, turn), _cosine(F, turn)
        ca, sa = out[O_CA * B + l], out[O_SA * B + l]
        na, ns = ca * for_c - sa * for_s, sa * for_c + ca * for_s
        scale = F(1.5) - F(0.5) * (na * na + ns * ns)
        rec[CA * B + l] = na * scale if on > F(0.5) else rec[CA * B + l]
        rec[SA * B + l] = ns * scale if on > F(0.5) else rec[SA * B + l]
        for_s, for_c = _sine(F, lift), _cosine(F, lift)
        ce, se = out[O_CE * B + l], out[O_SE * B + l]
        na, ns = ce * for_c - se * for_s, se * for_c + ce * for_s
        scale = F(1.5) - F(0.5) * (na * na + ns * ns)
        rec[CE * B + l] = na * scale if on > F(0.5) else rec[CE * B + l]
        rec[SE * B + l] = ns * scale if on > F(0.5) else rec[SE * B + l]
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
        rec[OFFSET0 * B + l] = on * w[W_B * B + l] + old * rec[OFFSET0 * B + l]
        rec[BIAS0 * B + l] = on * w[W_BIAS * B + l] + old * rec[BIAS0 * B + l]
        rec[SCALE0 * B + l] = on * w[W_SCALE * B + l] + old * rec[SCALE0 * B + l]


@njit(cache=True, error_model="numpy")
def complete(w, z, particle, birth):
    """Write what each lane takes for the distance, cos and sin of the azimuth, and variance of the range of a birth
    from measurement z: what was measured, or for a missing component a guess of its own.

    particle: number of the first lane's; birth: number of the measurement.
    """
    F = w.dtype.type
    for l in range(B):
        w[W_GUESS * B + l], w[(W_GUESS + 1) * B + l], w[(W_GUESS + 2) * B + l] = z[0], z[1], z[2]
        w[(W_GUESS + 3) * B + l] = z[5]
    if z[8] == 0.0:
        for l in range(B):
            share = evenly(particle + l, birth, 1)
            rho = F(LEAST_RANGE_M * (MOST_RANGE_M / LEAST_RANGE_M) ** share)
            w[W_GUESS * B + l] = w[W_B * B + l] + rho
            w[(W_GUESS + 3) * B + l] = z[5] * rho * rho
    if z[9] == 0.0:
        for l in range(B):
            azimuth = 2.0 * math.pi * evenly(particle + l, birth, 0)
            w[(W_GUESS + 1) * B + l], w[(W_GUESS + 2) * B + l] = math.cos(azimuth), math.sin(azimuth)


@njit(cache=True, error_model="numpy")
def give_birth(w, rec, z):
    """Write the record of a VT born from measurement z in every lane (method.md: birth); z as in `innovate`, completed
    by `complete`.

    Given theta the birth is exact: range variance q_d, G = (-1, 0, 0) for the offset (0 where no distance was
    measured); what the pose owes to bias and scale is passed on to the VT.
    """
    F = w.dtype.type
    ce_b, se_b, q1, q2, measured = z[3], z[4], z[6], z[7], z[8]
    for l in range(B):
        cosine, sine = w[(W_GUESS + 1) * B + l], w[(W_GUESS + 2) * B + l]
        bx, by = ce_b * cosine, ce_b * sine
        ax, ay = -by, bx
        ex, ey = -se_b * cosine, -se_b * sine
        r0, r1, r2 = w[W_ROT * B + l], w[(W_ROT + 1) * B + l], w[(W_ROT + 2) * B + l]
        r3, r4, r5 = w[(W_ROT + 3) * B + l], w[(W_ROT + 4) * B + l], w[(W_ROT + 5) * B + l]
        r6, r7, r8 = w[(W_ROT + 6) * B + l], w[(W_ROT + 7) * B + l], w[(W_ROT + 8) * B + l]
        nx, ny, nz = r0 * bx + r1 * by + r2 * se_b, r3 * bx + r4 * by + r5 * se_b, r6 * bx + r7 * by + r8 * se_b
        rho = max(w[W_GUESS * B + l] - w[W_B * B + l], F(1e-3))
        f2 = max(nx * nx + ny * ny, F(1e-18))
        flat = math.sqrt(f2)
        rec[ANCHOR * B + l] = w[W_POSE * B + l]
        rec[(ANCHOR + 1) * B + l] = w[(W_POSE + 1) * B + l]
        rec[(ANCHOR + 2) * B + l] = w[(W_POSE + 2) * B + l]
        rec[RANGE * B + l] = rho
        rec[CA * B + l] = nx / flat
        rec[SA * B + l] = ny / flat
        rec[CE * B + l] = flat
        rec[SE * B + l] = nz
        # world angles by body angles
        uax, uay, uaz = r0 * ax + r1 * ay, r3 * ax + r4 * ay, r6 * ax + r7 * ay
        uex, uey, uez = r0 * ex + r1 * ey + r2 * ce_b, r3 * ex + r4 * ey + r5 * ce_b, r6 * ex + r7 * ey + r8 * ce_b
        jaa, jae = (nx * uay - ny * uax) / f2, (nx * uey - ny * uex) / f2
        jea = flat * uaz - nz * (nx * uax + ny * uay) / flat
        jee = flat * uez - nz * (nx * uex + ny * uey) / flat
        rec[SIGMA * B + l] = w[(W_GUESS + 3) * B + l]
        rec[(SIGMA + 1) * B + l] = F(0.0)
        rec[(SIGMA + 2) * B + l] = F(0.0)
        rec[(SIGMA + 3) * B + l] = jaa * jaa * q1 + jae * jae * q2
        rec[(SIGMA + 4) * B + l] = jaa * jea * q1 + jae * jee * q2
        rec[(SIGMA + 5) * B + l] = jea * jea * q1 + jee * jee * q2
        pxb, pxs, pyb = w[W_G * B + l], w[(W_G + 1) * B + l], w[(W_G + 2) * B + l]
        pys, ppb, pps = w[(W_G + 3) * B + l], w[(W_G + 4) * B + l], w[(W_G + 5) * B + l]
        rec[GAIN * B + l] = -measured
        rec[(GAIN + 1) * B + l] = nx * pxb + ny * pyb
        rec[(GAIN + 2) * B + l] = nx * pxs + ny * pys
        rec[(GAIN + 3) * B + l] = F(0.0)
        rec[(GAIN + 4) * B + l] = (nx * pyb - ny * pxb) / (f2 * rho) + ppb
        rec[(GAIN + 5) * B + l] = (nx * pys - ny * pxs) / (f2 * rho) + pps
        rec[(GAIN + 6) * B + l] = F(0.0)
        rec[(GAIN + 7) * B + l] = -nz * (nx * pxb + ny * pyb) / (flat * rho)
        rec[(GAIN + 8) * B + l] = -nz * (nx * pxs + ny * pys) / (flat * rho)
        rec[OFFSET0 * B + l] = w[W_B * B + l]
        rec[BIAS0 * B + l] = w[W_BIAS * B + l]
        rec[SCALE0 * B + l] = w[W_SCALE * B + l]
        rec[HITS * B + l] = F(1.0)
