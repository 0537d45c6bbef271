"""Compiled: the information that a snapshot gives on the nuisances theta, and theta's update, lane by lane.

Source: method of the marginalised clock offset, written for a vector: with I = sum A^T S^-1 A and y = sum A^T S^-1 e
over a
snapshot's associations, P_new = (P^-1 + I)^-1, the mean moves by P_new y, and the log-weight is
-log det(1 + P I) / 2 + y^T P_new y / 2.
"""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.fastslam.layout import LANES, O_A, V_WEIGHT, V_Y, W_E, W_INV, W_LINK, W_MASK

B = LANES
A = O_A * B


@njit(cache=True, error_model="numpy")
def forget(w, v, size):
    """Set the weight, y, I and the link's sums to zero."""
    for i in range(W_LINK * B, (W_LINK + 9) * B):
        w[i] = 0.0
    for i in range((V_Y + size + size * size) * B):
        v[i] = 0.0


@njit(cache=True, error_model="numpy")
def absorb(w, out):
    """Add A^T S^-1 e and A^T S^-1 A of the association at hand, where W_MASK is 1, to the link's sums."""
    F = w.dtype.type
    none = F(0.0)
    for l in range(B):
        on = w[W_MASK * B + l] > F(0.5)
        i0, i1, i2 = w[W_INV * B + l], w[(W_INV + 1) * B + l], w[(W_INV + 2) * B + l]
        i3, i4, i5 = w[(W_INV + 3) * B + l], w[(W_INV + 4) * B + l], w[(W_INV + 5) * B + l]
        a0, a1, a2 = out[A + l], out[A + B + l], out[A + 2 * B + l]
        a3, a4, a5 = out[A + 3 * B + l], out[A + 4 * B + l], out[A + 5 * B + l]
        a6, a7, a8 = out[A + 6 * B + l], out[A + 7 * B + l], out[A + 8 * B + l]
        e0, e1, e2 = w[W_E * B + l], w[(W_E + 1) * B + l], w[(W_E + 2) * B + l]
        b0, b1, b2 = i0 * a0 + i1 * a3 + i2 * a6, i1 * a0 + i3 * a3 + i4 * a6, i2 * a0 + i4 * a3 + i5 * a6
        g0, g1, g2 = i0 * a1 + i1 * a4 + i2 * a7, i1 * a1 + i3 * a4 + i4 * a7, i2 * a1 + i4 * a4 + i5 * a7
        s0, s1, s2 = i0 * a2 + i1 * a5 + i2 * a8, i1 * a2 + i3 * a5 + i4 * a8, i2 * a2 + i4 * a5 + i5 * a8
        w[W_LINK * B + l] += b0 * e0 + b1 * e1 + b2 * e2 if on else none
        w[(W_LINK + 1) * B + l] += g0 * e0 + g1 * e1 + g2 * e2 if on else none
        w[(W_LINK + 2) * B + l] += s0 * e0 + s1 * e1 + s2 * e2 if on else none
        w[(W_LINK + 3) * B + l] += b0 * a0 + b1 * a3 + b2 * a6 if on else none
        w[(W_LINK + 4) * B + l] += b0 * a1 + b1 * a4 + b2 * a7 if on else none
        w[(W_LINK + 5) * B + l] += b0 * a2 + b1 * a5 + b2 * a8 if on else none
        w[(W_LINK + 6) * B + l] += g0 * a1 + g1 * a4 + g2 * a7 if on else none
        w[(W_LINK + 7) * B + l] += g0 * a2 + g1 * a5 + g2 * a8 if on else none
        w[(W_LINK + 8) * B + l] += s0 * a2 + s1 * a5 + s2 * a8 if on else none


@njit(cache=True, error_model="numpy")
def collect(w, v, site, size):
    """Move the link's sums to their places in y and in the lower triangle of I."""
    index = (site, size - 2, size - 1)
    k = 3
    for c in range(3):
        _gather(w, (W_LINK + c) * B, v, (V_Y + index[c]) * B)
        for d in range(c, 3):
            _gather(w, (W_LINK + k) * B, v, (V_Y + size + index[d] * size + index[c]) * B)
            k += 1
    for i in range(W_LINK * B, (W_LINK + 9) * B):
        w[i] = 0.0


@njit(cache=True, error_model="numpy")
def _gather(w, source, v, target):
    """Row `target` of v += row `source` of w."""
    a, b = v[target : target + B], w[source : source + B]
    for l in range(B):
        a[l] += b[l]


@njit(cache=True, error_model="numpy")
def _set(v, out, value):
    """Row out = value."""
    a = v[out : out + B]
    for l in range(B):
        a[l] = value


@njit(cache=True, error_model="numpy")
def _copy(v, out, right):
    """Row out = row right."""
    a, b = v[out : out + B], v[right : right + B]
    for l in range(B):
        a[l] = b[l]


@njit(cache=True, error_model="numpy")
def _add_product(v, out, left, right):
    """Row out += row left * row right."""
    a, b, c = v[out : out + B], v[left : left + B], v[right : right + B]
    for l in range(B):
        a[l] += b[l] * c[l]


@njit(cache=True, error_model="numpy")
def _take_product(v, out, left, right):
    """Row out -= row left * row right."""
    a, b, c = v[out : out + B], v[left : left + B], v[right : right + B]
    for l in range(B):
        a[l] -= b[l] * c[l]


@njit(cache=True, error_model="numpy")
def _divide(v, out, right):
    """Row out /= row right; 0 where the divisor is 0."""
    a, b = v[out : out + B], v[right : right + B]
    for l in range(B):
        a[l] = a[l] / b[l] if b[l] > 1e-150 else 0.0


@njit(cache=True, error_model="numpy")
def _root(v, out):
    """Row out = square root of row out; of 0 where it is negative."""
    a = v[out : out + B]
    for l in range(B):
        a[l] = math.sqrt(max(a[l], 0.0))


@njit(cache=True, error_model="numpy")
def _cholesky(v, source, target, n):
    """Factor n x n rows at `source` (lower triangle) into lower rows at `target`; a zero pivot gives a zero column."""
    for j in range(n):
        for i in range(j, n):
            out = target + (i * n + j) * B
            _copy(v, out, source + (i * n + j) * B)
            for k in range(j):
                _take_product(v, out, target + (i * n + k) * B, target + (j * n + k) * B)
            if i == j:
                _root(v, out)
            else:
                _divide(v, out, target + (j * n + j) * B)


@njit(cache=True, error_model="numpy")
def condition(v, cov, change, n):
    """Update theta's covariance rows (n x n at flat index `cov`), write the mean's change (n rows), add the log-weight.

    With P = L L^T and M = 1 + L^T I L = C C^T: X = C^-1 L^T, P_new = X^T X, change = X^T X y. M's eigenvalues are at
    least 1.
    """
    info, lower = (V_Y + n) * B, (V_Y + n + n * n) * B
    product, x = lower + n * n * B, lower + 2 * n * n * B
    _cholesky(v, cov, lower, n)
    for r in range(n):  # product = I L
        for c in range(n):
            out = product + (r * n + c) * B
            _set(v, out, 0.0)
            for k in range(c, n):
                _add_product(v, out, info + (max(r, k) * n + min(r, k)) * B, lower + (k * n + c) * B)
    for r in range(n):  # I is no longer needed: M = 1 + L^T I L in its place
        for c in range(r + 1):
            out = info + (r * n + c) * B
            _set(v, out, 1.0 if r == c else 0.0)
            for k in range(r, n):
                _add_product(v, out, lower + (k * n + r) * B, product + (k * n + c) * B)
    _cholesky(v, info, product, n)  # nor is I L: C in its place
    for c in range(n):  # X = C^-1 L^T
        for r in range(n):
            out = x + (r * n + c) * B
            if c >= r:
                _copy(v, out, lower + (c * n + r) * B)
            else:
                _set(v, out, 0.0)
            for k in range(r):
                _take_product(v, out, product + (r * n + k) * B, x + (k * n + c) * B)
            _divide(v, out, product + (r * n + r) * B)
    for r in range(n):
        for c in range(r + 1):
            out = cov + (r * n + c) * B
            _set(v, out, 0.0)
            for k in range(n):
                _add_product(v, out, x + (k * n + r) * B, x + (k * n + c) * B)
            _copy(v, cov + (c * n + r) * B, out)
    rows = lower  # L is no longer needed: X y in its place
    for r in range(n):
        _set(v, rows + r * B, 0.0)
        for k in range(n):
            _add_product(v, rows + r * B, x + (r * n + k) * B, (V_Y + k) * B)
    for r in range(n):
        _set(v, change + r * B, 0.0)
        for k in range(n):
            _add_product(v, change + r * B, x + (k * n + r) * B, rows + k * B)
    _evidence(v, rows, product, n)


@njit(cache=True, error_model="numpy")
def _evidence(v, rows, factor, n):
    """Add |X y|^2 / 2 - log det(1 + P I) / 2 to the log-weight."""
    for l in range(B):
        determinant, gain = 1.0, 0.0
        for r in range(n):
            determinant *= v[factor + (r * n + r) * B + l]
            gain += v[rows + r * B + l] ** 2
        v[V_WEIGHT * B + l] += 0.5 * gain - math.log(determinant)
