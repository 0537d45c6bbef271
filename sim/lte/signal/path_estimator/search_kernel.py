"""Compiled search of a link's delay-direction spectrum for the strongest peak that stands out of its surroundings."""

from __future__ import annotations

import numpy as np
from numba import njit

from cellslam.sim.lte.statistical.detector_layout import Array

GUARD_BINS, REFERENCE_BINS = 2, 3  # cells skipped, then averaged, before and behind the cell under test
STRETCH_BINS = 31  # of delay, over which noise is taken for constant
# Disturbance below these multiples of the noise is taken for its estimate's scatter: of few cells, of all ports.
LOCAL_EXCESS, AROUND_EXCESS = 1.7, 1.15
ALIKE = 0.1  # relative difference over delay that is taken for the noise estimate's scatter
SIDELOBES = 0.01  # mean energy of a delay peak over the reference cells, relative to the peak


@njit(cache=True, nogil=True)
def look(beams: Array, on_ports: Array, working: int, energy: Array, port_energy: Array, profile: Array) -> float:
    """Write energy (K, D) of both polarisations of beam outputs (2 K, D), energy (D,) of all port outputs (ports, D),
    and the noise per sample over delay (D,): the running median of the ports' mean energy; return its median.

    Cancelling another cell colours the noise over delay; paths fill few cells of a stretch. What differs by no more
    than scatter is set to the median.
    """
    count, bins = energy.shape
    for k in range(count):
        h, v, row = beams[2 * k], beams[2 * k + 1], energy[k]
        for d in range(bins):
            row[d] = h[d].real * h[d].real + h[d].imag * h[d].imag + v[d].real * v[d].real + v[d].imag * v[d].imag
    port_energy[:] = 0.0
    for m in range(on_ports.shape[0]):
        port = on_ports[m]
        for d in range(bins):
            port_energy[d] += port[d].real * port[d].real + port[d].imag * port[d].imag
    running_median(port_energy, STRETCH_BINS, profile)
    for d in range(bins):
        profile[d] /= working
    noise = float(np.median(profile))
    for d in range(bins):
        if abs(profile[d] - noise) < ALIKE * noise:
            profile[d] = noise
    return noise


@njit(cache=True, nogil=True)
def running_median(values: Array, width: int, out: Array) -> None:
    """Write the median over `width` (odd) neighbours; the ends repeat."""
    half, last = width // 2, len(values) - 1
    window = np.empty(width)
    for i in range(width):
        window[i] = values[min(max(i - half, 0), last)]
    window.sort()
    out[0] = window[half]
    for centre in range(1, len(values)):
        gone, new = values[min(max(centre - half - 1, 0), last)], values[min(centre + half, last)]
        at = np.searchsorted(window, gone)
        while at > 0 and window[at - 1] > new:
            window[at] = window[at - 1]
            at -= 1
        while at < width - 1 and window[at + 1] < new:
            window[at] = window[at + 1]
            at += 1
        window[at] = new
        out[centre] = window[half]


@njit(cache=True, nogil=True)
def subtract_outer(matrix: Array, rows: Array, columns: Array) -> None:
    """Subtract rows x columns from `matrix` in place."""
    for i in range(matrix.shape[0]):
        row, factor = matrix[i], rows[i]
        for j in range(matrix.shape[1]):
            row[j] -= factor * columns[j]


@njit(cache=True, nogil=True)
def note_trail(trailing: Array, first: Array, last: Array, column: Array, beside: int, energy: Array) -> None:
    """Raise `trailing` (azimuths, D) to the energy (n,) of each path from bin `first` to `last`, `beside` columns to
    both sides.
    """
    for p in range(len(energy)):
        for turn in range(-beside, beside + 1):
            row = trailing[(column[p] + turn) % len(trailing)]
            for d in range(max(first[p], 0), min(last[p], len(row))):
                row[d] = max(row[d], energy[p])


@njit(cache=True, nogil=True)
def local_levels(
    directions: Array, bins: Array, energy: Array, elevations: int, port_energy: Array, ports: int, noise: Array,
    margin: Array, level: Array, asked: Array,
) -> None:  # fmt: skip
    """Write `local_level` of each of n cells whose path was taken out; `margin` (n,)."""
    for i in range(len(bins)):
        d = bins[i]
        level[i], asked[i] = local_level(
            directions[i], d, 0.0, energy, elevations, port_energy, ports, noise[d], margin[i]
        )


@njit(cache=True, nogil=True)
def _surroundings(energy: Array, k: int, elevations: int, low: int, high: int) -> float:
    """Return half the mean energy of direction k and its neighbours over bins low to high; zero outside."""
    low, high = max(low, 0), min(high, energy.shape[1])
    if high <= low:
        return 0.0
    azimuths = energy.shape[0] // elevations
    a, e = k // elevations, k % elevations
    total = 0.0
    for turn in range(-1, 2):
        column = (a + turn) % azimuths * elevations
        for rise in range(-1, 2):
            row = energy[column + min(max(e + rise, 0), elevations - 1)]
            for d in range(low, high):
                total += row[d]
    return 0.5 * total / (9 * (high - low))


@njit(cache=True, nogil=True)
def local_level(
    k: int, d: int, peak: float, energy: Array, elevations: int, port_energy: Array, ports: int, noise: float,
    margin: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the disturbance per sample around a cell of energy `peak`, and the level that the cell must stand out of.

    Disturbance is noise, or what exceeds it before or behind in the same directions (greatest-of), or in all other
    directions at the same delay. What stands before or behind counts `margin` times for the second.
    """
    near, far = GUARD_BINS + 1, GUARD_BINS + 1 + REFERENCE_BINS
    beyond = far + REFERENCE_BINS
    # Of two stretches on each side the lesser: another path there must not hide this one.
    before = min(
        _surroundings(energy, k, elevations, d - far + 1, d - near + 1),
        _surroundings(energy, k, elevations, d - beyond + 1, d - far + 1),
    )
    behind = min(
        _surroundings(energy, k, elevations, d + near, d + far),
        _surroundings(energy, k, elevations, d + far, d + beyond),
    )
    # A path's own sidelobes over delay are no disturbance.
    along = max(before, behind) - SIDELOBES * peak
    around = max(port_energy[d] - peak, 0.0) / (ports - 2)
    level, asked = noise, noise
    if along > LOCAL_EXCESS * noise:
        level, asked = along, margin * along
    if around > AROUND_EXCESS * noise:
        level, asked = max(level, around), max(asked, around)
    return level, asked


@njit(cache=True, nogil=True)
def strongest(
    energy: Array, port_energy: Array, noise: Array, coarse: float, elevations: int, ports: int, blocked: Array,
    trailing: Array, margin: float,
) -> tuple[int, int, float]:  # fmt: skip
    """Return (direction, bin, level) of the strongest cell whose energy is `coarse` times the level that it must stand
    out of; direction -1: none. `noise` (D,) per sample and delay.

    `blocked` (B, 2): cells (direction, bin) around which nothing is looked for. `trailing` (azimuths, D): energy of the
    paths in whose diffuse energy a cell lies; what is weaker must stand out `margin` times as far.
    """
    best, at, bin_at, level_at = 0.0, -1, -1, 0.0
    azimuths = energy.shape[0] // elevations
    for k in range(energy.shape[0]):
        row, behind = energy[k], trailing[k // elevations]
        for d in range(energy.shape[1]):
            if row[d] <= best or row[d] < coarse * noise[d]:
                continue
            more = margin if row[d] < behind[d] else 1.0
            _, level = local_level(k, d, row[d], energy, elevations, port_energy, ports, noise[d], more)
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
