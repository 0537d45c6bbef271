"""Compiled normal equations of a fit of one path: what the search evaluates most.

Source: that of `joint_fit_kernel`, whose numbers it gives, to rounding.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.lte.signal.path_estimator.joint_fit_kernel import Normal, cholesky_inverse
from cellslam.sim.lte.statistical.detector_layout import Array

ANY_ORDER = {"reassoc", "contract", "nsz"}  # of sums: nothing is assumed about what is finite


@njit(cache=True, nogil=True, fastmath=ANY_ORDER)
def _correlate(y: Array, distance: float, rate: Array, out: Array) -> None:
    """Write (2, ports): y (ports, tones) correlated with the tones of a path at a distance, and with their derivative
    by it.
    """
    tones = len(rate)
    cosine, sine = np.empty(tones), np.empty(tones)
    for f in range(tones):
        cosine[f], sine[f] = math.cos(rate[f] * distance), math.sin(rate[f] * distance)
    for m in range(len(y)):
        row = y[m]
        real, imaginary, slope_real, slope_imaginary = 0.0, 0.0, 0.0, 0.0
        for f in range(tones):
            a, b = row[f].real, row[f].imag
            p, q = a * cosine[f] - b * sine[f], b * cosine[f] + a * sine[f]
            real += p
            imaginary += q
            slope_real -= rate[f] * q
            slope_imaginary += rate[f] * p
        out[0, m], out[1, m] = complex(real, imaginary), complex(slope_real, slope_imaginary)


@njit(cache=True, nogil=True, fastmath=ANY_ORDER)
def _inner(left: Array, right: Array) -> complex:
    """Return left^H right."""
    real, imaginary = 0.0, 0.0
    for m in range(len(left)):
        a, b, c, d = left[m].real, left[m].imag, right[m].real, right[m].imag
        real += a * c + b * d
        imaginary += a * d - b * c
    return complex(real, imaginary)


@njit(cache=True, nogil=True)
def normal_equations_of_one(y: Array, value: Array, by_az: Array, by_el: Array, rate: Array, distance: float) -> Normal:
    """Return the fit of one path to `y` (ports, tones) with steering (ports, 2), `rate` = 2 pi f / c (tones,)."""
    ports = len(y)
    correlated, steering = np.empty((2, ports), np.complex128), np.empty((2, ports), np.complex128)
    columns = np.empty((3, ports), np.complex128)
    _correlate(y, distance, rate, correlated)
    # of the tones e^(-j rate d) and their derivative: Gram matrix
    on_tones = np.empty((2, 2), np.complex128)
    on_tones[0, 0], on_tones[1, 1] = len(rate), (rate * rate).sum()
    on_tones[0, 1] = complex(0.0, -rate.sum())
    on_tones[1, 0] = on_tones[0, 1].conjugate()
    gram, seen = np.empty((2, 2), np.complex128), np.empty(2, np.complex128)
    for a in range(2):
        for m in range(ports):
            steering[a, m] = value[m, a]
    for a in range(2):
        seen[a] = _inner(steering[a], correlated[0])
        for b in range(2):
            gram[a, b] = _inner(steering[a], steering[b]) * on_tones[0, 0]
    inverse = cholesky_inverse(gram)
    w = inverse @ seen
    explained = (seen[0].conjugate() * w[0] + seen[1].conjugate() * w[1]).real
    for m in range(ports):
        columns[0, m] = value[m, 0] * w[0] + value[m, 1] * w[1]
        columns[1, m] = by_az[m, 0] * w[0] + by_az[m, 1] * w[1]
        columns[2, m] = by_el[m, 0] * w[0] + by_el[m, 1] * w[1]
    information, gradient = np.empty((3, 3)), np.empty(3)
    cross = np.empty((3, 2), np.complex128)
    for a in range(3):
        tone = 1 if a == 0 else 0
        for b in range(2):
            cross[a, b] = _inner(columns[a], steering[b]) * on_tones[tone, 0]
        slope = _inner(columns[a], correlated[tone]) - cross[a, 0] * w[0] - cross[a, 1] * w[1]
        gradient[a] = slope.real
    for a in range(3):
        for b in range(a + 1):
            own = _inner(columns[a], columns[b]) * on_tones[1 if a == 0 else 0, 1 if b == 0 else 0]
            for i in range(2):
                for j in range(2):
                    own -= cross[a, i] * inverse[i, j] * cross[b, j].conjugate()
            information[a, b] = information[b, a] = own.real
    return Normal(explained, w.reshape(1, 2), np.array([explained]), information, gradient)
