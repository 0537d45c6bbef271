"""Compiled normal equations of a fit of one path: what the search evaluates most.

Source: that of `joint_fit_kernel`, whose numbers it gives, to rounding.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.compiling import part
from cellslam.sim.lte.signal.path_estimator.correlation_kernel import correlate, inner, write_tones
from cellslam.sim.lte.signal.path_estimator.joint_fit_kernel import Normal, cholesky_inverse
from cellslam.sim.lte.statistical.detector_layout import Array


@part
def normal_equations_of_one(y: Array, value: Array, by_az: Array, by_el: Array, rate: Array, distance: float) -> Normal:
    """Return the fit of one path to `y` (ports, tones) with steering (ports, 2), `rate` = 2 pi f / c (tones,)."""
    ports = len(y)
    correlated, steering = np.empty((2, ports), np.complex128), np.empty((2, ports), np.complex128)
    columns = np.empty((3, ports), np.complex128)
    tones = np.empty((2, len(rate)), np.complex128)
    write_tones(distance, rate, tones)
    correlate(y, tones, correlated)
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
        seen[a] = inner(steering[a], correlated[0])
        for b in range(2):
            gram[a, b] = inner(steering[a], steering[b]) * on_tones[0, 0]
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
            cross[a, b] = inner(columns[a], steering[b]) * on_tones[tone, 0]
        slope = inner(columns[a], correlated[tone]) - cross[a, 0] * w[0] - cross[a, 1] * w[1]
        gradient[a] = slope.real
    for a in range(3):
        for b in range(a + 1):
            own = inner(columns[a], columns[b]) * on_tones[1 if a == 0 else 0, 1 if b == 0 else 0]
            for i in range(2):
                for j in range(2):
                    own -= cross[a, i] * inverse[i, j] * cross[b, j].conjugate()
            information[a, b] = information[b, a] = own.real
    return Normal(explained, w.reshape(1, 2), np.array([explained]), information, gradient)
