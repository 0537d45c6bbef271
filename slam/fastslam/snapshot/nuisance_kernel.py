"""Compiled: the information that a snapshot gives on the nuisances theta, and theta's update, lane by lane.

Source: method of the marginalised clock offset, written for a vector: with I = sum A^T S^-1 A and y = sum A^T S^-1 e
over a
snapshot's associations, P_new = (P^-1 + I)^-1, the mean moves by P_new y, and the log-weight is
-log det(1 + P I) / 2 + y^T P_new y / 2.
"""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.fastslam.state.layout import LANES, V_WEIGHT, V_Y, W_LINK

B = LANES


@njit(cache=True, error_model="numpy")
def forget(w, v, size):
    """Set the weight, y, I and the link's sums to zero."""
    for i in range(W_LINK * B, (W_LINK + 9) * B):
        w[i] = 0.0
    for i in range((V_Y + size + size * size) * B):
        v[i] = 0.0


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
def _condition_4(v, cov, change):
    """Do as `condition` for four nuisances, unrolled: each lane's matrices stay in registers."""
    info, y = (V_Y + 4) * B, V_Y * B
    for l in range(B):
        p00, p10, p20, p30 = v[cov + 0 * B + l], v[cov + 4 * B + l], v[cov + 8 * B + l], v[cov + 12 * B + l]
        p11, p21, p31 = v[cov + 5 * B + l], v[cov + 9 * B + l], v[cov + 13 * B + l]
        p22, p32 = v[cov + 10 * B + l], v[cov + 14 * B + l]
        p33 = v[cov + 15 * B + l]
        l00 = math.sqrt(max(p00, 0.0))
        r0 = 1.0 / l00 if l00 > 1e-150 else 0.0
        l10 = (p10) * r0
        l20 = (p20) * r0
        l30 = (p30) * r0
        l11 = math.sqrt(max(p11 - l10 * l10, 0.0))
        r1 = 1.0 / l11 if l11 > 1e-150 else 0.0
        l21 = (p21 - l20 * l10) * r1
        l31 = (p31 - l30 * l10) * r1
        l22 = math.sqrt(max(p22 - l20 * l20 - l21 * l21, 0.0))
        r2 = 1.0 / l22 if l22 > 1e-150 else 0.0
        l32 = (p32 - l30 * l20 - l31 * l21) * r2
        l33 = math.sqrt(max(p33 - l30 * l30 - l31 * l31 - l32 * l32, 0.0))
        r3 = 1.0 / l33 if l33 > 1e-150 else 0.0
        i00, i10, i20, i30 = v[info + 0 * B + l], v[info + 4 * B + l], v[info + 8 * B + l], v[info + 12 * B + l]
        i11, i21, i31 = v[info + 5 * B + l], v[info + 9 * B + l], v[info + 13 * B + l]
        i22, i32 = v[info + 10 * B + l], v[info + 14 * B + l]
        i33 = v[info + 15 * B + l]
        t00 = i00 * l00 + i10 * l10 + i20 * l20 + i30 * l30
        t10 = i10 * l00 + i11 * l10 + i21 * l20 + i31 * l30
        t11 = i11 * l11 + i21 * l21 + i31 * l31
        t20 = i20 * l00 + i21 * l10 + i22 * l20 + i32 * l30
        t21 = i21 * l11 + i22 * l21 + i32 * l31
        t22 = i22 * l22 + i32 * l32
        t30 = i30 * l00 + i31 * l10 + i32 * l20 + i33 * l30
        t31 = i31 * l11 + i32 * l21 + i33 * l31
        t32 = i32 * l22 + i33 * l32
        t33 = i33 * l33
        m00 = 1.0 + l00 * t00 + l10 * t10 + l20 * t20 + l30 * t30
        m10 = l11 * t10 + l21 * t20 + l31 * t30
        m11 = 1.0 + l11 * t11 + l21 * t21 + l31 * t31
        m20 = l22 * t20 + l32 * t30
        m21 = l22 * t21 + l32 * t31
        m22 = 1.0 + l22 * t22 + l32 * t32
        m30 = l33 * t30
        m31 = l33 * t31
        m32 = l33 * t32
        m33 = 1.0 + l33 * t33
        c00 = math.sqrt(max(m00, 0.0))
        r0 = 1.0 / c00 if c00 > 1e-150 else 0.0
        c10 = (m10) * r0
        c20 = (m20) * r0
        c30 = (m30) * r0
        c11 = math.sqrt(max(m11 - c10 * c10, 0.0))
        r1 = 1.0 / c11 if c11 > 1e-150 else 0.0
        c21 = (m21 - c20 * c10) * r1
        c31 = (m31 - c30 * c10) * r1
        c22 = math.sqrt(max(m22 - c20 * c20 - c21 * c21, 0.0))
        r2 = 1.0 / c22 if c22 > 1e-150 else 0.0
        c32 = (m32 - c30 * c20 - c31 * c21) * r2
        c33 = math.sqrt(max(m33 - c30 * c30 - c31 * c31 - c32 * c32, 0.0))
        r3 = 1.0 / c33 if c33 > 1e-150 else 0.0
        x00 = l00 * r0
        x10 = (-c10 * x00) * r1
        x20 = (-c20 * x00 - c21 * x10) * r2
        x30 = (-c30 * x00 - c31 * x10 - c32 * x20) * r3
        x01 = l10 * r0
        x11 = (l11 - c10 * x01) * r1
        x21 = (-c20 * x01 - c21 * x11) * r2
        x31 = (-c30 * x01 - c31 * x11 - c32 * x21) * r3
        x02 = l20 * r0
        x12 = (l21 - c10 * x02) * r1
        x22 = (l22 - c20 * x02 - c21 * x12) * r2
        x32 = (-c30 * x02 - c31 * x12 - c32 * x22) * r3
        x03 = l30 * r0
        x13 = (l31 - c10 * x03) * r1
        x23 = (l32 - c20 * x03 - c21 * x13) * r2
        x33 = (l33 - c30 * x03 - c31 * x13 - c32 * x23) * r3
        y0, y1, y2, y3 = v[y + 0 * B + l], v[y + 1 * B + l], v[y + 2 * B + l], v[y + 3 * B + l]
        z0 = x00 * y0 + x01 * y1 + x02 * y2 + x03 * y3
        z1 = x10 * y0 + x11 * y1 + x12 * y2 + x13 * y3
        z2 = x20 * y0 + x21 * y1 + x22 * y2 + x23 * y3
        z3 = x30 * y0 + x31 * y1 + x32 * y2 + x33 * y3
        p00 = x00 * x00 + x10 * x10 + x20 * x20 + x30 * x30
        v[cov + 0 * B + l] = p00
        p10 = x01 * x00 + x11 * x10 + x21 * x20 + x31 * x30
        v[cov + 4 * B + l] = p10
        v[cov + 1 * B + l] = p10
        p11 = x01 * x01 + x11 * x11 + x21 * x21 + x31 * x31
        v[cov + 5 * B + l] = p11
        p20 = x02 * x00 + x12 * x10 + x22 * x20 + x32 * x30
        v[cov + 8 * B + l] = p20
        v[cov + 2 * B + l] = p20
        p21 = x02 * x01 + x12 * x11 + x22 * x21 + x32 * x31
        v[cov + 9 * B + l] = p21
        v[cov + 6 * B + l] = p21
        p22 = x02 * x02 + x12 * x12 + x22 * x22 + x32 * x32
        v[cov + 10 * B + l] = p22
        p30 = x03 * x00 + x13 * x10 + x23 * x20 + x33 * x30
        v[cov + 12 * B + l] = p30
        v[cov + 3 * B + l] = p30
        p31 = x03 * x01 + x13 * x11 + x23 * x21 + x33 * x31
        v[cov + 13 * B + l] = p31
        v[cov + 7 * B + l] = p31
        p32 = x03 * x02 + x13 * x12 + x23 * x22 + x33 * x32
        v[cov + 14 * B + l] = p32
        v[cov + 11 * B + l] = p32
        p33 = x03 * x03 + x13 * x13 + x23 * x23 + x33 * x33
        v[cov + 15 * B + l] = p33
        v[change + 0 * B + l] = x00 * z0 + x10 * z1 + x20 * z2 + x30 * z3
        v[change + 1 * B + l] = x01 * z0 + x11 * z1 + x21 * z2 + x31 * z3
        v[change + 2 * B + l] = x02 * z0 + x12 * z1 + x22 * z2 + x32 * z3
        v[change + 3 * B + l] = x03 * z0 + x13 * z1 + x23 * z2 + x33 * z3
        v[V_WEIGHT * B + l] += 0.5 * (z0 * z0 + z1 * z1 + z2 * z2 + z3 * z3)
        v[(V_Y + 20) * B + l] = c00 * c11 * c22 * c33
    for l in range(B):
        v[V_WEIGHT * B + l] -= math.log(v[(V_Y + 20) * B + l])


@njit(cache=True, error_model="numpy")
def condition(v, cov, change, n):
    """Update theta's covariance rows (n x n at flat index `cov`), write the mean's change (n rows), add the log-weight.

    With P = L L^T and M = 1 + L^T I L = C C^T: X = C^-1 L^T, P_new = X^T X, change = X^T X y. M's eigenvalues are at
    least 1.
    """
    if n == 4:
        _condition_4(v, cov, change)
        return
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
