"""Compiled search of a link's delay-direction spectrum for the strongest peak that stands out of its surroundings."""

from __future__ import annotations

import numpy as np
from numba import njit

from cellslam.sim.lte.detector_model import Array

GUARD_BINS, REFERENCE_BINS = 2, 8  # cells skipped, then averaged, before and behind the cell under test
LOCAL_EXCESS = 1.5  # disturbance below this multiple of the noise is taken for its estimate's scatter


@njit(cache=True, nogil=True)
def direction_energy(beams: Array, energy: Array) -> None:
    """Write energy (K, D), of both polarisations, of beam outputs (2 K, D)."""
    for k in range(energy.shape[0]):
        h, v = beams[2 * k], beams[2 * k + 1]
        row = energy[k]
        for d in range(energy.shape[1]):
            row[d] = h[d].real * h[d].real + h[d].imag * h[d].imag + v[d].real * v[d].real + v[d].imag * v[d].imag


@njit(cache=True, nogil=True)
def sector_sums(energy: Array, azimuths: int, elevations: int, running: Array) -> None:
    """Write running (azimuths, D + 1): running sums over delay of the mean energy of three neighbouring azimuths."""
    bins = energy.shape[1]
    scale = 1.0 / (3.0 * elevations)
    own = np.zeros((azimuths, bins))
    for k in range(energy.shape[0]):
        row, total = energy[k], own[k // elevations]
        for d in range(bins):
            total[d] += row[d]
    for a in range(azimuths):
        left, middle, right = own[(a - 1) % azimuths], own[a], own[(a + 1) % azimuths]
        running[a, 0] = 0.0
        for d in range(bins):
            running[a, d + 1] = running[a, d] + scale * (left[d] + middle[d] + right[d])


@njit(cache=True, nogil=True)
def subtract_outer(matrix: Array, rows: Array, columns: Array) -> None:
    """Subtract rows x columns from `matrix` in place."""
    for i in range(matrix.shape[0]):
        row, factor = matrix[i], rows[i]
        for j in range(matrix.shape[1]):
            row[j] -= factor * columns[j]


@njit(cache=True, nogil=True)
def local_level(a: int, d: int, energy: float, running: Array, port_energy: Array, ports: int, noise: float) -> float:
    """Return the disturbance per sample around a cell: noise, or what exceeds it before or behind in the same
    directions (greatest-of), or in all other directions at the same delay.
    """
    bins = running.shape[1] - 1
    low, high = max(d - GUARD_BINS - REFERENCE_BINS, 0), max(d - GUARD_BINS, 0)
    before = 0.5 * (running[a, high] - running[a, low]) / (high - low) if high > low else 0.0
    low, high = min(d + GUARD_BINS + 1, bins), min(d + GUARD_BINS + REFERENCE_BINS + 1, bins)
    behind = 0.5 * (running[a, high] - running[a, low]) / (high - low) if high > low else 0.0
    around = max(port_energy[d] - energy, 0.0) / (ports - 2)
    local = max(before, behind, around)
    return float(local if local > LOCAL_EXCESS * noise else noise)


@njit(cache=True, nogil=True)
def strongest(
    energy: Array, running: Array, port_energy: Array, noise: float, coarse: float, elevations: int, ports: int,
    blocked: Array,
) -> tuple[int, int, float]:  # fmt: skip
    """Return (direction, bin, level) of the strongest cell whose energy is `coarse` times its level; direction -1:
    none.

    `blocked` (B, 2): cells (direction, bin) around which nothing is looked for.
    """
    best, at, bin_at, level_at = 0.0, -1, -1, 0.0
    azimuths = running.shape[0]
    for k in range(energy.shape[0]):
        row = energy[k]
        for d in range(energy.shape[1]):
            if row[d] <= best or row[d] < coarse * noise:
                continue
            level = local_level(k // elevations, d, row[d], running, port_energy, ports, noise)
            if row[d] < coarse * level:
                continue
            free = True
            for b in range(len(blocked)):
                turn = abs(k // elevations - blocked[b, 0] // elevations)
                near = min(turn, azimuths - turn) <= 1 and abs(k % elevations - blocked[b, 0] % elevations) <= 1
                free = free and not (near and abs(d - blocked[b, 1]) <= 1)
            if free:
                best, at, bin_at, level_at = row[d], k, d, level
    return at, bin_at, level_at
