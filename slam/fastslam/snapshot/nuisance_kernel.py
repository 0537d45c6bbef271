"""Compiled: the information that a snapshot gives on the nuisances theta, and theta's update, lane by lane.

With I = sum A^T S^-1 A and y = sum A^T S^-1 e over a snapshot's associations, P_new = (P^-1 + I)^-1, the mean moves by
P_new y, and the log-weight is -log det(1 + P I) / 2 + y^T P_new y / 2. With P = L L^T and M = 1 + L^T I L = C C^T: X =
C^-1 L^T, P_new = X^T X. M's eigenvalues are at least 1.

Sources: Schoen, Gustafsson and Nordlund, "Marginalized particle filters for mixed linear/nonlinear state-space models",
IEEE Trans. Signal Processing 53(7), 2005; the measurements of a snapshot share theta, which gives the sums and the
weight, as in Bayesian linear regression (Bishop, "Pattern recognition and machine learning", 2006, section 3.3 and
3.5).
"""

from __future__ import annotations

import math

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.state.lanes_kernel import mat_at, put_where, sym_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    LANES,
    O_A,
    V_WEIGHT,
    V_Y,
    W_E,
    W_INFO,
    W_INV,
    W_MASK,
    W_Y,
    Rows,
    sums_of,
)
from cellslam.slam.fastslam.state.triangles_kernel import (
    Vec4,
    cholesky,
    dot4,
    forward,
    one_and_congruence,
    triangle_at,
    vec4_at,
)
from cellslam.slam.model.matrices_kernel import mat_sym, mat_vec, sym_plus, sym_product, transposed, vec_plus

B = LANES


@njit(cache=True, error_model="numpy")
def forget(w: Rows, v: Rows, size: int) -> None:
    """Set the weight, y, I and the link's sums to zero."""
    w[W_Y * B : (W_INFO + 6) * B] = 0.0
    v[: sums_of(size).cov * B] = 0.0


@njit(cache=True, error_model="numpy")
def absorb(w: Rows, out: Rows) -> None:
    """Add A^T S^-1 e and A^T S^-1 A of the association at hand, where W_MASK is 1, to the link's sums."""
    half = w.dtype.type(0.5)
    for l in range(B):
        on, a = w[W_MASK * B + l] > half, mat_at(out, O_A, l)
        weighed = mat_sym(transposed(a), sym_at(w, W_INV, l))
        put_where(w, W_Y, l, on, vec_plus(vec_at(w, W_Y, l), mat_vec(weighed, vec_at(w, W_E, l))))
        put_where(w, W_INFO, l, on, sym_plus(sym_at(w, W_INFO, l), sym_product(weighed, a)))


@njit(cache=True, error_model="numpy")
def collect(w: Rows, v: Rows, site: int, size: int) -> None:
    """Move the link's sums to their places in y and in the lower triangle of I."""
    index, info, k = (site, size - 2, size - 1), sums_of(size).info, 0
    for c in range(3):
        _gather(w, W_Y + c, v, V_Y + index[c])
        for d in range(c, 3):
            _gather(w, W_INFO + k, v, info + index[d] * size + index[c])
            k += 1
    w[W_Y * B : (W_INFO + 6) * B] = 0.0


@njit(cache=True, error_model="numpy")
def condition(v: Rows, n: int) -> None:
    """Update theta's covariance (n x n rows at `cov`), write the mean's change, add the log-weight."""
    if n == 4:
        _condition_4(v)
    else:
        _condition_any(v, n)


@njit(cache=True, error_model="numpy")
def _condition_4(v: Rows) -> None:
    """Do it for four nuisances: each lane's matrices stay in registers."""
    at = sums_of(4)
    for l in range(B):
        lower = cholesky(triangle_at(v, at.cov, l))
        c = cholesky(one_and_congruence(triangle_at(v, at.info, l), lower))
        x = (
            forward(c, Vec4(lower.aa, 0.0, 0.0, 0.0)),
            forward(c, Vec4(lower.ba, lower.bb, 0.0, 0.0)),
            forward(c, Vec4(lower.ca, lower.cb, lower.cc, 0.0)),
            forward(c, Vec4(lower.da, lower.db, lower.dc, lower.dd)),
        )
        y = vec4_at(v, V_Y, l)
        xy = Vec4(
            x[0].a * y.a + x[1].a * y.b + x[2].a * y.c + x[3].a * y.d,
            x[0].b * y.a + x[1].b * y.b + x[2].b * y.c + x[3].b * y.d,
            x[0].c * y.a + x[1].c * y.b + x[2].c * y.c + x[3].c * y.d,
            x[0].d * y.a + x[1].d * y.b + x[2].d * y.c + x[3].d * y.d,
        )
        for r in range(4):
            v[(at.change + r) * B + l] = dot4(x[r], xy)
            for k in range(4):
                v[(at.cov + 4 * r + k) * B + l] = dot4(x[r], x[k])
        v[V_WEIGHT * B + l] += 0.5 * dot4(xy, xy)
        v[at.lower * B + l] = c.aa * c.bb * c.cc * c.dd
    for l in range(B):
        v[V_WEIGHT * B + l] -= math.log(v[at.lower * B + l])


@njit(cache=True, error_model="numpy")
def _condition_any(v: Rows, n: int) -> None:
    """Do it row by row, in place where what was there is no longer needed."""
    _, y, info, cov, lower, product, x, change, _ = sums_of(n)
    _factor(v, cov, lower, n)
    for r in range(n):  # product = I L
        for c in range(n):
            out = product + r * n + c
            _set(v, out, 0.0)
            for k in range(c, n):
                _add_product(v, out, info + max(r, k) * n + min(r, k), lower + k * n + c)
    for r in range(n):  # M = 1 + L^T I L in I's place
        for c in range(r + 1):
            out = info + r * n + c
            _set(v, out, 1.0 if r == c else 0.0)
            for k in range(r, n):
                _add_product(v, out, lower + k * n + r, product + k * n + c)
    _factor(v, info, product, n)  # C in that of I L
    for c in range(n):  # X = C^-1 L^T
        for r in range(n):
            out = x + r * n + c
            if c >= r:
                _copy(v, out, lower + c * n + r)
            else:
                _set(v, out, 0.0)
            for k in range(r):
                _take_product(v, out, product + r * n + k, x + k * n + c)
            _divide(v, out, product + r * n + r)
    for r in range(n):  # P = X^T X
        for c in range(r + 1):
            out = cov + r * n + c
            _set(v, out, 0.0)
            for k in range(n):
                _add_product(v, out, x + k * n + r, x + k * n + c)
            _copy(v, cov + c * n + r, out)
    for r in range(n):  # X y in L's place
        _set(v, lower + r, 0.0)
        for k in range(n):
            _add_product(v, lower + r, x + r * n + k, y + k)
    for r in range(n):  # the mean moves by X^T X y
        _set(v, change + r, 0.0)
        for k in range(n):
            _add_product(v, change + r, x + k * n + r, lower + k)
    for l in range(B):  # |X y|^2 / 2 - log det C
        determinant, gain = 1.0, 0.0
        for r in range(n):
            determinant *= v[(product + r * n + r) * B + l]
            gain += v[(lower + r) * B + l] ** 2
        v[V_WEIGHT * B + l] += 0.5 * gain - math.log(determinant)


@njit(cache=True, error_model="numpy")
def _factor(v: Rows, source: int, target: int, n: int) -> None:
    """Factor n x n rows at `source` (lower triangle) into lower rows at `target`; a zero pivot gives a zero column."""
    for j in range(n):
        for i in range(j, n):
            out = target + i * n + j
            _copy(v, out, source + i * n + j)
            for k in range(j):
                _take_product(v, out, target + i * n + k, target + j * n + k)
            if i == j:
                _root(v, out)
            else:
                _divide(v, out, target + j * n + j)


@njit(cache=True, error_model="numpy")
def _gather(w: Rows, source: int, v: Rows, target: int) -> None:
    """Row `target` of v += row `source` of w."""
    a, b = _row(v, target), _row(w, source)
    for l in range(B):
        a[l] += b[l]


@njit(cache=True, error_model="numpy")
def _row(v: Rows, row: int) -> Rows:
    """Return a view of one row, whose loops the compiler knows to be LANES long."""
    view: Rows = v[row * B : row * B + B]
    return view


@njit(cache=True, error_model="numpy")
def _set(v: Rows, out: int, value: float) -> None:
    """Row out = value."""
    a = _row(v, out)
    for l in range(B):
        a[l] = value


@njit(cache=True, error_model="numpy")
def _copy(v: Rows, out: int, right: int) -> None:
    """Row out = row right."""
    a, b = _row(v, out), _row(v, right)
    for l in range(B):
        a[l] = b[l]


@njit(cache=True, error_model="numpy")
def _add_product(v: Rows, out: int, left: int, right: int) -> None:
    """Row out += row left * row right."""
    a, b, c = _row(v, out), _row(v, left), _row(v, right)
    for l in range(B):
        a[l] += b[l] * c[l]


@njit(cache=True, error_model="numpy")
def _take_product(v: Rows, out: int, left: int, right: int) -> None:
    """Row out -= row left * row right."""
    a, b, c = _row(v, out), _row(v, left), _row(v, right)
    for l in range(B):
        a[l] -= b[l] * c[l]


@njit(cache=True, error_model="numpy")
def _divide(v: Rows, out: int, right: int) -> None:
    """Row out /= row right; 0 where the divisor is 0."""
    a, b = _row(v, out), _row(v, right)
    for l in range(B):
        a[l] = a[l] / b[l] if b[l] > 1e-150 else 0.0


@njit(cache=True, error_model="numpy")
def _root(v: Rows, out: int) -> None:
    """Row out = square root of row out; of 0 where it is negative."""
    a = _row(v, out)
    for l in range(B):
        a[l] = math.sqrt(max(a[l], 0.0))
