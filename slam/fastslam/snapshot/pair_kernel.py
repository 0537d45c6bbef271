"""Compiled: one measurement against one predicted track, lane by lane: innovation, its covariance, its likelihood.

Angles never leave the unit circle: a difference of angles comes from cross and dot product.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from cellslam.slam.fastslam.state.angle_kernel import arc_tangent
from cellslam.slam.fastslam.state.layout import (
    LANES,
    O_C,
    O_FLAT,
    O_FULL,
    O_OFFSET,
    O_S,
    O_X,
    O_Y,
    O_Z,
    W_D2,
    W_DET,
    W_E,
    W_EXPONENT,
    W_INV,
    W_LOG,
    W_POSE,
    W_REACH,
)

B = LANES


@njit(cache=True, error_model="numpy")
def reach(w, out, first):
    """Write what each lane expects to measure, and its variance without that of the measurement: distance, and azimuth
    in the world frame against that of lane `first` (+-1.16 rad where they differ by more)."""
    F = w.dtype.type
    xr, yr, psi = out[O_X * B + first], out[O_Y * B + first], w[(W_POSE + 3) * B + first]
    flat_r = out[O_FLAT * B + first]
    for l in range(B):
        w[W_REACH * B + l] = out[O_FULL * B + l] + out[O_OFFSET * B + l]
        w[(W_REACH + 1) * B + l] = out[O_S * B + l] + out[O_C * B + l]
        w[(W_REACH + 3) * B + l] = out[(O_S + 3) * B + l] + out[(O_C + 3) * B + l]
    for l in range(B):
        x, y, scale = out[O_X * B + l], out[O_Y * B + l], out[O_FLAT * B + l] * flat_r
        t = (xr * y - yr * x) / max(scale + xr * x + yr * y, F(1e-3) * scale)
        turn = F(2.0) * arc_tangent(F, min(max(t, -F(0.66)), F(0.66)))
        w[(W_REACH + 2) * B + l] = turn + w[(W_POSE + 3) * B + l] - psi


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
        w[W_E * B + l] = f0 * (d - out[O_OFFSET * B + l] - full)
        t = (sa * x - ca * y) / max(flat + ca * x + sa * y, F(1e-3) * flat)
        w[(W_E + 1) * B + l] = f1 * F(2.0) * arc_tangent(F, min(max(t, -F(0.66)), F(0.66)))
        t = (se * flat - ce * zz) / max(full + ce * flat + se * zz, F(1e-3) * full)
        w[(W_E + 2) * B + l] = f2 * F(2.0) * arc_tangent(F, min(max(t, -F(0.66)), F(0.66)))


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
