"""Compiled search of a link's delay-direction spectrum for the strongest peak that stands out of its surroundings."""

from __future__ import annotations

import numpy as np
from numba import njit

from cellslam.sim.lte.detector_model import Array

GUARD_BINS, REFERENCE_BINS = 2, 3  # cells skipped, then averaged, before and behind the cell under test
LOCAL_EXCESS = 1.7  # disturbance below this multiple of the noise is taken for its estimate's scatter
SIDELOBES = 0.01  # mean energy of a delay peak over the reference cells, relative to the peak
DIFFUSE_MARGIN = 4.0  # by which diffuse energy may be stronger in a cell than in those around it: it falls with delay


@njit(cache=True, nogil=True)
def direction_energy(beams: Array, energy: Array) -> None:
    """Write energy (K, D), of both polarisations, of beam outputs (2 K, D)."""
    for k in range(energy.shape[0]):
        h, v = beams[2 * k], beams[2 * k + 1]
        row = energy[k]
        for d in range(energy.shape[1]):
            row[d] = h[d].real * h[d].real + h[d].imag * h[d].imag + v[d].real * v[d].real + v[d].imag * v[d].imag


@njit(cache=True, nogil=True)
def surrounding_sums(energy: Array, azimuths: int, elevations: int, running: Array) -> None:
    """Write running (K, D + 1): running sums over delay of the mean energy of a direction and its neighbours."""
    count, bins = energy.shape
    beside = np.zeros((count, bins))
    for a in range(azimuths):
        for e in range(elevations):
            left = energy[((a - 1) % azimuths) * elevations + e]
            middle = energy[a * elevations + e]
            right = energy[((a + 1) % azimuths) * elevations + e]
            total = beside[a * elevations + e]
            for d in range(bins):
                total[d] = left[d] + middle[d] + right[d]
    for a in range(azimuths):
        for e in range(elevations):
            k = a * elevations + e
            below, middle, above = beside[k - (e > 0)], beside[k], beside[k + (e < elevations - 1)]
            running[k, 0] = 0.0
            for d in range(bins):
                running[k, d + 1] = running[k, d] + (below[d] + middle[d] + above[d]) / 9.0


@njit(cache=True, nogil=True)
def subtract_outer(matrix: Array, rows: Array, columns: Array) -> None:
    """Subtract rows x columns from `matrix` in place."""
    for i in range(matrix.shape[0]):
        row, factor = matrix[i], rows[i]
        for j in range(matrix.shape[1]):
            row[j] -= factor * columns[j]


@njit(cache=True, nogil=True)
def _mean(running: Array, k: int, low: int, high: int) -> float:
    """Return half the mean energy of the surroundings of direction k over bins low to high; zero outside."""
    low, high = max(low, 0), min(high, running.shape[1] - 1)
    return float(0.5 * (running[k, high] - running[k, low]) / (high - low)) if high > low else 0.0


@njit(cache=True, nogil=True)
def local_level(k: int, d: int, energy: float, running: Array, port_energy: Array, ports: int, noise: float) -> float:
    """Return the disturbance per sample around a cell: noise, or what exceeds it before or behind in the same
    directions (greatest-of), or in all other directions at the same delay.
    """
    near, far = GUARD_BINS + 1, GUARD_BINS + 1 + REFERENCE_BINS
    beyond = far + REFERENCE_BINS
    # Of two stretches on each side the lesser: another path there must not hide this one.
    before = min(_mean(running, k, d - far + 1, d - near + 1), _mean(running, k, d - beyond + 1, d - far + 1))
    behind = min(_mean(running, k, d + near, d + far), _mean(running, k, d + far, d + beyond))
    # A path's own sidelobes over delay are no disturbance.
    before, behind = before - SIDELOBES * energy, behind - SIDELOBES * energy
    around = max(port_energy[d] - energy, 0.0) / (ports - 2)
    local = max(before, behind, around)
    return float(local if local > LOCAL_EXCESS * noise else noise)


@njit(cache=True, nogil=True)
def strongest(
    energy: Array, running: Array, port_energy: Array, noise: Array, coarse: float, elevations: int, ports: int,
    blocked: Array,
) -> tuple[int, int, float]:  # fmt: skip
    """Return (direction, bin, level) of the strongest cell whose energy is `coarse` times its level; direction -1:
    none. `noise` (D,) per sample and delay.

    `blocked` (B, 2): cells (direction, bin) around which nothing is looked for.
    """
    best, at, bin_at, level_at = 0.0, -1, -1, 0.0
    azimuths = running.shape[0] // elevations
    for k in range(energy.shape[0]):
        row = energy[k]
        for d in range(energy.shape[1]):
            if row[d] <= best or row[d] < coarse * noise[d]:
                continue
            level = local_level(k, d, row[d], running, port_energy, ports, noise[d])
            if row[d] < coarse * level * (DIFFUSE_MARGIN if level > noise[d] else 1.0):
                continue
            free = True
            for b in range(len(blocked)):
                turn = abs(k // elevations - blocked[b, 0] // elevations)
                near = min(turn, azimuths - turn) <= 1 and abs(k % elevations - blocked[b, 0] % elevations) <= 1
                free = free and not (near and abs(d - blocked[b, 1]) <= 1)
            if free:
                best, at, bin_at, level_at = row[d], k, d, level
    return at, bin_at, level_at
