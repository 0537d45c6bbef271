"""Compiled sum of what the cells send on the reference elements of one symbol."""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.lte.statistical.detector_layout import Array
from cellslam.sim.lte.steering_kernel import write_phasors


@njit(cache=True, nogil=True)
def phasors(length: Array, rate: Array) -> Array:
    """Return e^(j rate length) (n, tones), single, of lengths (n,) in m and `rate` (tones,) in rad per m."""
    out = np.empty((len(length), len(rate)), np.complex64)
    cosine, sine = np.empty(len(rate)), np.empty(len(rate))
    for p in range(len(length)):
        write_phasors(length[p] * rate, cosine, sine)
        for f in range(len(rate)):
            out[p, f] = complex(cosine[f], sine[f])
    return out


@njit(cache=True, nogil=True)
def add_noise(total: Array, normal: Array, deviation: float) -> None:
    """Add complex noise to `total` (ports, tones) from `normal` (ports, tones, 2)."""
    for m in range(total.shape[0]):
        for f in range(total.shape[1]):
            total[m, f] += deviation * complex(normal[m, f, 0], normal[m, f, 1])


@njit(cache=True, nogil=True)
def add_pilots(total: Array, response: Array, sent: Array, normal: Array, evm: float) -> None:
    """Add response x sent, each element with a transmitter error of relative deviation `evm` (both parts)."""
    for m in range(total.shape[0]):
        for f in range(total.shape[1]):
            error = complex(1.0 + evm * normal[m, f, 0], evm * normal[m, f, 1])
            total[m, f] += response[m, f] * sent[m, f] * error


@njit(cache=True, nogil=True)
def add_data(total: Array, response: Array, words: Array, load: float, amplitude: float) -> None:
    """Add data of random 16-bit `words` (ports, tones): 14 bits decide whether an element is used, two are QPSK."""
    limit = load * 16384.0
    size = amplitude * math.sqrt(0.5)
    for m in range(total.shape[0]):
        for f in range(total.shape[1]):
            word = words[m, f]
            if (word >> 2) < limit:
                real = size if word & 1 else -size
                imaginary = size if word & 2 else -size
                total[m, f] += response[m, f] * complex(real, imaginary)
