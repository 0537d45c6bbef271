"""Compiled correlation of a link's samples with the tones of a path, and taking such paths out.

Complex arrays are read as real and imaginary parts in turn: products are then sums of real products, without any
reordering.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.compiling import lean, part
from cellslam.sim.lte.statistical.detector_layout import Array
from cellslam.sim.lte.steering_kernel import ANY_ORDER, write_phasors


@part
def in_pairs(columns: Array, like: Array) -> tuple[Array, Array]:
    """Return complex `columns` (n, c), and j times these, as (n, 2 c) real and imaginary parts in turn, of the type of
    `like`.
    """
    n, width = columns.shape
    straight, turned = np.empty((n, 2 * width), like.dtype), np.empty((n, 2 * width), like.dtype)
    for p in range(n):
        for j in range(width):
            real, imaginary = columns[p, j].real, columns[p, j].imag
            straight[p, 2 * j], straight[p, 2 * j + 1] = real, imaginary
            turned[p, 2 * j], turned[p, 2 * j + 1] = -imaginary, real
    return straight, turned


@part(fastmath=ANY_ORDER)
def correlate(y: Array, tones: Array, out: Array) -> None:
    """Write (2, ports): `y` (ports, tones) correlated with the `tones` (2, tones) of a path and with their derivative
    by distance, as `write_tones` gives them; in the precision of `y`.
    """
    pairs = y.view(y.real.dtype)
    straight, turned = in_pairs(tones, pairs)
    zero = pairs.dtype.type(0.0)
    for m in range(len(pairs)):
        real, imaginary, slope_real, slope_imaginary = zero, zero, zero, zero
        for i in range(pairs.shape[1]):
            real += pairs[m, i] * straight[0, i]
            imaginary += pairs[m, i] * turned[0, i]
            slope_real += pairs[m, i] * straight[1, i]
            slope_imaginary += pairs[m, i] * turned[1, i]
        out[0, m], out[1, m] = complex(real, imaginary), complex(slope_real, slope_imaginary)


@lean(fastmath=ANY_ORDER)
def inner(left: Array, right: Array) -> complex:
    """Return left^H right of vectors (n,)."""
    real, imaginary = 0.0, 0.0
    for m in range(len(left)):
        a, b, c, d = left[m].real, left[m].imag, right[m].real, right[m].imag
        real += a * c + b * d
        imaginary += a * d - b * c
    return complex(real, imaginary)


@part
def write_tones(distance: float, rate: Array, out: Array) -> None:
    """Write (2, tones): e^(-j rate d) of a path at a distance in m, and its derivative by it."""
    cosine, sine = np.empty(len(rate)), np.empty(len(rate))
    write_phasors(rate * distance, cosine, sine)
    for f in range(len(rate)):
        out[0, f] = complex(cosine[f], -sine[f])
        out[1, f] = complex(-rate[f] * sine[f], -rate[f] * cosine[f])


@lean(fastmath=ANY_ORDER)
def subtract_products(row: Array, factor: Array, straight: Array, turned: Array, out: Array) -> None:
    """Write `row` (2 c,) less the sum of complex factors (n,) times columns (n, 2 c), as `in_pairs` gives them; `out`
    may be the row itself.
    """
    for j in range(len(out)):
        out[j] = row[j]
    for p in range(len(factor)):
        real, imaginary, along, across = factor[p].real, factor[p].imag, straight[p], turned[p]
        for j in range(len(out)):
            out[j] -= real * along[j] + imaginary * across[j]
