"""Compiled normal equations of a joint path fit: Kronecker Gram matrices, weights eliminated exactly.

Source: variable projection, Golub and Pereyra 1973, in the form of Kaufman 1975; products of small matrices, Richter
2005 (see `path_estimator`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
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


@njit(cache=True, nogil=True)
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
    n, ports, tones = len(distance), y.shape[0], y.shape[1]
    delay = np.empty((tones, 2 * n), np.complex128)
    for p in range(n):
        for f in range(tones):
            angle = -rate[f] * distance[p]
            d = complex(math.cos(angle), math.sin(angle))
            delay[f, p] = d
            delay[f, n + p] = complex(0.0, -rate[f]) * d
    correlated = y @ delay.conj()
    on_tones = delay.conj().T @ delay
    steering = np.empty((ports, 2 * n), np.complex128)
    for p in range(n):
        for m in range(ports):
            steering[m, 2 * p] = value[p, m, 0]
            steering[m, 2 * p + 1] = value[p, m, 1]
    gram = steering.conj().T @ steering
    seen = np.zeros(2 * n, np.complex128)
    for a in range(2 * n):
        for m in range(ports):
            seen[a] += steering[m, a].conjugate() * correlated[m, a // 2]
        for b in range(2 * n):
            gram[a, b] *= on_tones[a // 2, b // 2]
    inverse = cholesky_inverse(gram)
    w = inverse @ seen
    explained = 0.0
    for a in range(2 * n):
        explained += (seen[a].conjugate() * w[a]).real
    columns = np.empty((ports, 3 * n), np.complex128)
    for p in range(n):
        h, v = w[2 * p], w[2 * p + 1]
        for m in range(ports):
            columns[m, 3 * p] = value[p, m, 0] * h + value[p, m, 1] * v
            columns[m, 3 * p + 1] = by_az[p, m, 0] * h + by_az[p, m, 1] * v
            columns[m, 3 * p + 2] = by_el[p, m, 0] * h + by_el[p, m, 1] * v
    own = columns.conj().T @ columns
    cross = columns.conj().T @ steering
    gradient = np.zeros(3 * n, np.complex128)
    for a in range(3 * n):
        tone_a = a // 3 + (n if a % 3 == 0 else 0)
        for m in range(ports):
            gradient[a] += columns[m, a].conjugate() * correlated[m, tone_a]
        for b in range(3 * n):
            own[a, b] *= on_tones[tone_a, b // 3 + (n if b % 3 == 0 else 0)]
        for b in range(2 * n):
            cross[a, b] *= on_tones[tone_a, b // 2]
            gradient[a] -= cross[a, b] * w[b]
    information = (own - cross @ inverse @ cross.conj().T).real
    slope = np.ascontiguousarray(gradient.real)
    return Normal(explained, w.reshape(n, 2), _wald(inverse, w), np.ascontiguousarray(information), slope)


@njit(cache=True, nogil=True)
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
