"""Compiled normal equations of a joint path fit: Kronecker Gram matrices, weights eliminated exactly.

Source: variable projection, Golub and Pereyra 1973, in the form of Kaufman 1975; products of small matrices, Richter
2005 (see `path_estimator`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.lte.signal.path_estimator.correlation_kernel import correlate, inner, write_tones
from cellslam.sim.lte.statistical.detector_layout import Array

RIDGE = 1e-10  # of the largest diagonal element: keeps coincident paths solvable


class Normal(NamedTuple):
    """A fit at given geometry: `explained` energy, weights (n, 2), `wald` (n,) energy that each path alone explains,
    `information` (3 n, 3 n) and `gradient` (3 n,) of distance, azimuth, elevation, the weights being eliminated.
    """

    explained: float
    weights: Array
    wald: Array
    information: Array
    gradient: Array


@part
def cholesky_inverse(gram: Array) -> Array:
    """Return the inverse of a Hermitian positive matrix (n, n), with a small ridge."""
    n = len(gram)
    largest = 0.0
    for i in range(n):
        largest = max(largest, gram[i, i].real)
    factor = np.zeros((n, n), np.complex128)
    for j in range(n):
        total = gram[j, j].real + RIDGE * largest
        for k in range(j):
            total -= factor[j, k].real ** 2 + factor[j, k].imag ** 2
        pivot = math.sqrt(max(total, 0.1 * RIDGE * largest))
        factor[j, j] = pivot
        for i in range(j + 1, n):
            entry = gram[i, j]
            for k in range(j):
                entry -= factor[i, k] * factor[j, k].conjugate()
            factor[i, j] = entry / pivot
    lower = np.zeros((n, n), np.complex128)
    for j in range(n):
        lower[j, j] = 1.0 / factor[j, j].real
        for i in range(j + 1, n):
            entry = 0j
            for k in range(j, i):
                entry -= factor[i, k] * lower[k, j]
            lower[i, j] = entry / factor[i, i].real
    return lower.conj().T @ lower


@njit(cache=True, nogil=True)
def normal_equations(y: Array, value: Array, by_az: Array, by_el: Array, rate: Array, distance: Array) -> Normal:
    """Return the fit of n paths to `y` (ports, tones) with steering (n, ports, 2), `rate` = 2 pi f / c (tones,)."""
    n, ports, tones = len(distance), len(y), len(rate)
    delay, correlated = np.empty((2 * n, tones), np.complex128), np.empty((2 * n, ports), np.complex128)
    steering = np.empty((2 * n, ports), np.complex128)
    for p in range(n):
        write_tones(distance[p], rate, delay[2 * p : 2 * p + 2])
        correlate(y, delay[2 * p : 2 * p + 2], correlated[2 * p : 2 * p + 2])
        for m in range(ports):
            steering[2 * p, m], steering[2 * p + 1, m] = value[p, m, 0], value[p, m, 1]
    on_tones, G = delay.conj() @ delay.T, steering.conj() @ steering.T
    b = np.empty(2 * n, np.complex128)
    for a in range(2 * n):
        path = a - a % 2
        b[a] = inner(steering[a], correlated[path])
        for c in range(2 * n):
            G[a, c] *= on_tones[path, c - c % 2]
    inverse = cholesky_inverse(G)
    w = inverse @ b
    explained = 0.0
    for a in range(2 * n):
        explained += (b[a].conjugate() * w[a]).real
    D = np.empty((3 * n, ports), np.complex128)
    for p in range(n):
        h, v = w[2 * p], w[2 * p + 1]
        for m in range(ports):
            D[3 * p, m] = value[p, m, 0] * h + value[p, m, 1] * v
            D[3 * p + 1, m] = by_az[p, m, 0] * h + by_az[p, m, 1] * v
            D[3 * p + 2, m] = by_el[p, m, 0] * h + by_el[p, m, 1] * v
    left = D.conj()
    own, C, gradient = left @ D.T, left @ steering.T, np.empty(3 * n)
    for a in range(3 * n):
        tone = _tone(a)
        slope = inner(D[a], correlated[tone])
        for c in range(3 * n):
            own[a, c] *= on_tones[tone, _tone(c)]
        for c in range(2 * n):
            C[a, c] *= on_tones[tone, c - c % 2]
            slope -= C[a, c] * w[c]
        gradient[a] = slope.real
    information = np.ascontiguousarray((own - C @ inverse @ C.conj().T).real)
    return Normal(explained, w.reshape(n, 2), _wald(inverse, w), information, gradient)


@part
def _tone(column: int) -> int:
    """Return which tones a column of the Jacobian has: a path's own, or by distance their derivative."""
    return 2 * (column // 3) + (1 if column % 3 == 0 else 0)


@part
def _wald(inverse: Array, w: Array) -> Array:
    """Return the energy w_p^H ((G^-1)_pp)^-1 w_p that would be lost with each path (n,)."""
    out = np.empty(len(w) // 2)
    for p in range(len(out)):
        i, j = 2 * p, 2 * p + 1
        a, d, b = inverse[i, i].real, inverse[j, j].real, inverse[i, j]
        determinant = max(a * d - b.real**2 - b.imag**2, 1e-300)
        wi, wj = w[i], w[j]
        energy = d * abs(wi) ** 2 + a * abs(wj) ** 2 - 2.0 * (wi.conjugate() * b * wj).real
        out[p] = energy / determinant
    return out


@njit(cache=True, nogil=True)
def inverse_information(information: Array) -> Array:
    """Return the covariance (3 n, 3 n) of all paths' geometry at unit disturbance, of their `information`."""
    scale = 1.0 / np.sqrt(np.maximum(2.0 * np.diag(information), 1e-30))
    both = np.outer(scale, scale)
    return np.linalg.inv(2.0 * information * both + 1e-9 * np.eye(len(scale))) * both
