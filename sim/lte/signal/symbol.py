"""What arrives on the elements of one symbol: sums over many paths, pilots, data, and noise, which is drawn once: what
the transmitters err by adds to its variance.

A sum over paths is direct, or a fast Fourier transform where it pays: weights are spread over a grid of delays by a
Gaussian, whose own transform is taken off again.

Source: Greengard and Lee, "Accelerating the nonuniform fast Fourier transform", SIAM Review 46, 2004; elements: the
extended FastSLAM paper, equation 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from cellslam.sim.compiling import njit
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.statistical.detector_layout import Array
from cellslam.sim.lte.steering_kernel import write_phasors

Floats = NDArray[np.float64]
ComplexSingle = NDArray[np.complex64]
REACH = 6  # cells of the grid to either side over which a weight is spread: errors of 1e-5
MANY_PATHS, MANY_TONES = 256, 1024  # from which the transform pays


@dataclass(frozen=True)
class PathSums:
    """Paths (n,) of `length_m`, and the `tones_hz` (tones,) that they arrive on."""

    length_m: Floats
    tones_hz: Floats

    def of(self, weights: ComplexSingle) -> ComplexSingle:
        """Return (ports, tones): the sum over all paths of `weights` (ports, n), in their unit."""
        return self._transformed(weights) if self._transforms else np.asarray(weights @ self._phasors, np.complex64)

    def of_every(self, step: int, weights: ComplexSingle) -> ComplexSingle:
        """Return the same sum over every `step`-th path alone, of the weights of these."""
        some = self._phasors_of(self.length_m[::step]) if self._transforms else self._phasors[::step]
        return np.asarray(weights @ some, np.complex64)

    @cached_property
    def _phasors(self) -> ComplexSingle:
        return self._phasors_of(self.length_m)

    def _phasors_of(self, length_m: Floats) -> ComplexSingle:
        return phasors(-length_m, 2.0 * np.pi * self.tones_hz / SPEED_OF_LIGHT_MPS)

    @cached_property
    def _transforms(self) -> bool:
        """Whether the transform pays, the tones being in even steps."""
        if len(self.length_m) < MANY_PATHS or len(self.tones_hz) < MANY_TONES:
            return False
        return bool(np.allclose(np.diff(self.tones_hz), self._step_hz, rtol=1e-9, atol=0.0))

    @cached_property
    def _step_hz(self) -> float:
        return float(np.ptp(self.tones_hz)) / (len(self.tones_hz) - 1)

    def _transformed(self, weights: ComplexSingle) -> ComplexSingle:
        count = len(self.tones_hz)
        cells, half = fft.next_fast_len(2 * count), count // 2
        ratio = cells / count
        width = np.pi * REACH / (count * count * ratio * (ratio - 0.5))
        phase = 2.0 * np.pi * self.length_m / SPEED_OF_LIGHT_MPS
        turned = weights * np.exp(-1j * phase * self.tones_hz[half]).astype(np.complex64)
        grid = spread(turned, np.mod(phase * self._step_hz, 2.0 * np.pi), width, cells)
        order = np.arange(count) - half
        undo = np.sqrt(np.pi / width) / cells * np.exp(order.astype(np.float64) ** 2 * width)
        return np.asarray(fft.fft(grid, axis=1)[:, order % cells] * undo.astype(np.float32), np.complex64)


@njit(cache=True, nogil=True)
def spread(weights: Array, angle: Array, width: float, cells: int) -> Array:
    """Return `weights` (ports, n), each at its `angle` (n,) from 0 to 2 pi, spread over a circle of (ports, cells) by a
    Gaussian exp(-x^2 / (4 width)).
    """
    out, step = np.zeros((len(weights), cells), np.complex64), 2.0 * np.pi / cells
    first, shape = np.empty(len(angle), np.int64), np.empty((len(angle), 2 * REACH), np.float32)
    for p in range(len(angle)):
        first[p] = int(angle[p] / step) - REACH + 1
        for i in range(2 * REACH):
            shape[p, i] = np.exp(-((angle[p] - (first[p] + i) * step) ** 2) / (4.0 * width))
    for m in range(len(weights)):
        row = out[m]
        for p in range(len(angle)):
            for i in range(2 * REACH):
                row[(first[p] + i) % cells] += weights[m, p] * shape[p, i]
    return out


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
def add_noise(total: Array, variance: Array, normal: Array) -> None:
    """Add complex noise to `total` (ports, tones) from `normal` (ports, tones, 2): each part of it has the `variance`
    (ports, tones).
    """
    for m in range(total.shape[0]):
        for f in range(total.shape[1]):
            total[m, f] += math.sqrt(variance[m, f]) * complex(normal[m, f, 0], normal[m, f, 1])


@njit(cache=True, nogil=True)
def add_pilots(total: Array, variance: Array, response: Array, sent: Array, slots: Array, evm: float) -> None:
    """Add response x what is `sent` (slots, tones) in the slot of each port to `total` (ports, tones), and to the
    `variance` of the noise a transmitter error of relative deviation `evm` (both parts).
    """
    share = np.float32(evm * evm)
    for m in range(total.shape[0]):
        row = sent[slots[m]]
        for f in range(total.shape[1]):
            value = response[m, f] * row[f]
            total[m, f] += value
            variance[m, f] += share * (value.real * value.real + value.imag * value.imag)


@njit(cache=True, nogil=True)
def add_data(total: Array, response: Array, words: Array, load: float, amplitude: float) -> None:
    """Add data of random 16-bit `words` (ports, tones): 14 bits decide whether an element is used, two are QPSK."""
    limit, size = load * 16384.0, np.float32(amplitude * math.sqrt(0.5))
    for m in range(total.shape[0]):
        for f in range(total.shape[1]):
            word, value = words[m, f], response[m, f]
            own = size if (word >> 2) < limit else np.float32(0.0)
            along, across = own if word & 1 else -own, own if word & 2 else -own
            total[m, f] += complex(along * value.real - across * value.imag, along * value.imag + across * value.real)
