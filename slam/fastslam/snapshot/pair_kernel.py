"""Compiled: one measurement against one predicted track, lane by lane: innovation, its covariance, its likelihood.

Angles never leave the unit circle: a difference of angles comes from cross and dot product.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.state.angle_kernel import arc_tangent
from cellslam.slam.fastslam.state.lanes_kernel import five_at, put, sym_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    LANES,
    O_C,
    O_FLAT,
    O_FULL,
    O_S,
    O_X,
    O_Y,
    W_B,
    W_D2,
    W_DET,
    W_E,
    W_EXPONENT,
    W_INV,
    W_LOG,
    W_POSE,
    W_REACH,
    Rows,
)
from cellslam.slam.model.matrices_kernel import Sym3, adjugate, determinant, quadratic, sym_plus, sym_scaled, sym_times

B = LANES


@njit(error_model="numpy")
def _angle(F: Any, sine: Any, one_and_cosine: Any, scale: Any) -> Any:
    """Return the angle of which `scale` times sine and 1 + cosine are given, 2 atan(sine / (1 + cosine)), within
    +-1.16 rad."""
    t = sine / max(one_and_cosine, F(1e-3) * scale)
    return F(2.0) * arc_tangent(F, min(max(t, -F(0.66)), F(0.66)))


@njit(cache=True, error_model="numpy")
def reach(w: Rows, out: Rows, first: int) -> None:
    """Write what each lane expects to measure, and its variance without that of the measurement: distance, and azimuth
    in the world frame against that of lane `first` (+-1.16 rad where they differ by more)."""
    F = w.dtype.type
    xr, yr, psi = out[O_X * B + first], out[O_Y * B + first], w[(W_POSE + 3) * B + first]
    flat_r = out[O_FLAT * B + first]
    for l in range(B):
        w[W_REACH * B + l] = out[O_FULL * B + l] + w[W_B * B + l]
        w[(W_REACH + 1) * B + l] = out[O_S * B + l] + out[O_C * B + l]
        w[(W_REACH + 3) * B + l] = out[(O_S + 3) * B + l] + out[(O_C + 3) * B + l]
    for l in range(B):
        x, y, scale = out[O_X * B + l], out[O_Y * B + l], out[O_FLAT * B + l] * flat_r
        turn = _angle(F, xr * y - yr * x, scale + xr * x + yr * y, scale)
        w[(W_REACH + 2) * B + l] = turn + w[(W_POSE + 3) * B + l] - psi


@njit(cache=True, error_model="numpy")
def innovate(w: Rows, out: Rows, z: Rows) -> None:
    """Write e = z - h at W_E; z (12,): distance, cos and sin of azimuth and of elevation, 3 variances, 3 flags
    (measured).

    A component that was not measured has e = 0 and takes no part.
    """
    F = w.dtype.type
    d, ca, sa, ce, se, f0, f1, f2 = z[0], z[1], z[2], z[3], z[4], z[8], z[9], z[10]
    for l in range(B):
        x, y, zz, flat, full = five_at(out, O_X, l)
        w[W_E * B + l] = f0 * (d - w[W_B * B + l] - full)
        w[(W_E + 1) * B + l] = f1 * _angle(F, sa * x - ca * y, flat + ca * x + sa * y, flat)
        w[(W_E + 2) * B + l] = f2 * _angle(F, se * flat - ce * zz, full + ce * flat + se * zz, full)


@njit(cache=True, error_model="numpy")
def invert(w: Rows, out: Rows, z: Rows, share: float) -> None:
    """Write S^-1, det S and e^T S^-1 e for S = H Sigma H^T + share A P A^T + Q; rows and columns of what was not
    measured are those of Q alone in S, and 0 in S^-1."""
    F = w.dtype.type
    part, f0, f1, f2 = F(share), z[8], z[9], z[10]
    flags = Sym3(f0, f0 * f1, f0 * f2, f1, f1 * f2, f2)
    for l in range(B):
        seen = sym_times(sym_plus(sym_at(out, O_S, l), sym_scaled(sym_at(out, O_C, l), part)), flags)
        s = Sym3(seen.xx + z[5], seen.xy, seen.xz, seen.yy + z[6], seen.yz, seen.zz + z[7])
        adjugate_of_s = adjugate(s)
        det = determinant(s, adjugate_of_s)
        inverse = sym_scaled(adjugate_of_s, F(1.0) / det)
        w[W_D2 * B + l] = quadratic(inverse, vec_at(w, W_E, l))
        w[W_DET * B + l] = det
        put(w, W_INV, l, sym_times(inverse, flags))


@njit(cache=True, error_model="numpy")
def logarithm(w: Rows, bits: Rows) -> None:
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
def _take_apart(w: Rows, bits: Rows, width: Any, bias: Any, mantissa: Any, one: Any) -> None:
    """Write the binary exponent of det S at W_EXPONENT and its mantissa, 1 to 2, at W_LOG."""
    F = w.dtype.type
    for l in range(B):
        b = bits[W_DET * B + l]
        bits[W_LOG * B + l] = (b & mantissa) | one
        w[W_EXPONENT * B + l] = F((b >> width) - bias)
