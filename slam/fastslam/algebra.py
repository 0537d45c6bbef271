"""Unrolled 3 x 3 algebra on scalars for the compiled kernels; symmetric matrices are (00, 01, 02, 11, 12, 22)."""

from __future__ import annotations

from numba import njit


@njit(cache=True, inline="always")
def symmetric_inverse(a, b, c, d, e, f):
    """Return the inverse of a symmetric matrix as six scalars, and its determinant."""
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * m00 + b * m01 + c * m02
    s = 1.0 / determinant
    return (
        m00 * s,
        m01 * s,
        m02 * s,
        (a * f - c * c) * s,
        (b * c - a * e) * s,
        (a * d - b * b) * s,
        determinant,
    )


@njit(cache=True, inline="always")
def quadratic(a, b, c, d, e, f, x, y, z):
    """Return v^T M v for symmetric M and v = (x, y, z)."""
    return a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)


@njit(cache=True, inline="always")
def congruence(m, o, s0, s1, s2, s3, s4, s5):
    """Return M S M^T (six scalars) for M = m[o:o+9] row by row and symmetric S."""
    a0 = m[o] * s0 + m[o + 1] * s1 + m[o + 2] * s2
    a1 = m[o] * s1 + m[o + 1] * s3 + m[o + 2] * s4
    a2 = m[o] * s2 + m[o + 1] * s4 + m[o + 2] * s5
    b0 = m[o + 3] * s0 + m[o + 4] * s1 + m[o + 5] * s2
    b1 = m[o + 3] * s1 + m[o + 4] * s3 + m[o + 5] * s4
    b2 = m[o + 3] * s2 + m[o + 4] * s4 + m[o + 5] * s5
    c0 = m[o + 6] * s0 + m[o + 7] * s1 + m[o + 8] * s2
    c1 = m[o + 6] * s1 + m[o + 7] * s3 + m[o + 8] * s4
    c2 = m[o + 6] * s2 + m[o + 7] * s4 + m[o + 8] * s5
    return (
        a0 * m[o] + a1 * m[o + 1] + a2 * m[o + 2],
        a0 * m[o + 3] + a1 * m[o + 4] + a2 * m[o + 5],
        a0 * m[o + 6] + a1 * m[o + 7] + a2 * m[o + 8],
        b0 * m[o + 3] + b1 * m[o + 4] + b2 * m[o + 5],
        b0 * m[o + 6] + b1 * m[o + 7] + b2 * m[o + 8],
        c0 * m[o + 6] + c1 * m[o + 7] + c2 * m[o + 8],
    )
