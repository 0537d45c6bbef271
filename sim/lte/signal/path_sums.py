"""What many paths together give the tones: directly, or by a fast Fourier transform where it pays.

Source: Greengard and Lee, "Accelerating the nonuniform fast Fourier transform", SIAM Review 46, 2004: weights are
spread over a grid of delays by a Gaussian, whose own transform is taken off again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from cellslam.sim.compiling import njit
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.array import Floats
from cellslam.sim.lte.signal import symbol_kernel
from cellslam.sim.lte.statistical.detector_layout import Array

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
        if not self._transforms:
            return np.asarray(weights @ self._phasors, np.complex64)
        return self._transformed(weights)

    def of_every(self, step: int, weights: ComplexSingle) -> ComplexSingle:
        """Return the same sum over every `step`-th path alone."""
        if self._transforms:
            return np.asarray(weights[:, ::step] @ self._phasors_of(self.length_m[::step]), np.complex64)
        return np.asarray(weights[:, ::step] @ self._phasors[::step], np.complex64)

    @cached_property
    def _phasors(self) -> ComplexSingle:
        return self._phasors_of(self.length_m)

    def _phasors_of(self, length_m: Floats) -> ComplexSingle:
        return symbol_kernel.phasors(-length_m, 2.0 * np.pi * self.tones_hz / SPEED_OF_LIGHT_MPS)

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
