"""Compiled search of a link's delay-direction spectrum for the strongest peak that stands out of its surroundings.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.lte.statistical.detector_layout import Array

GUARD_BINS, REFERENCE_BINS = 2, 3  # cells skipped, then averaged, before and behind the cell under test
# Disturbance below these multiples of the noise is taken for its estimate's scatter: of few cells, of all ports.
LOCAL_EXCESS, AROUND_EXCESS = 1.7, 1.15
ALIKE = 0.1  # relative difference over delay that is taken for the noise estimate's scatter
SIDELOBES = 0.01  # mean energy of a delay peak over the reference cells, relative to the peak


class PowerSpectrum(NamedTuple):
    """Energies, as in the samples, over K directions (`elevations` to an azimuth) and D delays.

    `energy` (K, D) of both polarisations of each beam; `port_energy` (D,) of all `ports` that work; `noise` (D,) per
    sample, taken for constant over `stretch` (odd) delays; `trailing` (azimuths, D): energy of the paths in whose
    diffuse energy a cell lies.
    """

    energy: Array
    port_energy: Array
    noise: Array
    trailing: Array
    stretch: int
    ports: int
    elevations: int


@njit(cache=True, nogil=True)
def write_energies(beams: Array, on_ports: Array, spectrum: PowerSpectrum) -> float:
    """Write the energies of beam outputs (2 K, D) and port outputs (ports, D), and the noise per sample over delay: the
    running median of the ports' mean energy; return its median.

    Cancelling another cell colours the noise over delay; paths fill few cells of a stretch. What differs by no more
    than scatter is set to the median.
    """
    energy, port_energy, noise = spectrum.energy, spectrum.port_energy, spectrum.noise
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
    running_median(port_energy, spectrum.stretch, noise)
    for d in range(bins):
        noise[d] /= spectrum.ports
    usual = float(np.median(noise))
    for d in range(bins):
        if abs(noise[d] - usual) < ALIKE * usual:
            noise[d] = usual
    return usual


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
    directions: Array, bins: Array, spectrum: PowerSpectrum, margin: Array, level: Array, asked: Array
) -> None:
    """Write `local_level` of each of n cells (direction, bin) whose path was taken out; all (n,), energies as there."""
    for i in range(len(bins)):
        level[i], asked[i] = local_level(directions[i], bins[i], 0.0, spectrum, margin[i])


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
def local_level(k: int, d: int, peak: float, spectrum: PowerSpectrum, margin: float) -> tuple[float, float]:
    """Return the disturbance per sample around a cell of energy `peak`, and the level that the cell must stand out of.

    Disturbance is noise, or what exceeds it before or behind in the same directions (greatest-of), or in all other
    directions at the same delay. What stands before or behind counts `margin` times for the second.
    """
    energy, elevations, noise = spectrum.energy, spectrum.elevations, spectrum.noise[d]
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
    around = max(spectrum.port_energy[d] - peak, 0.0) / (spectrum.ports - 2)
    level, asked = noise, noise
    if along > LOCAL_EXCESS * noise:
        level, asked = along, margin * along
    if around > AROUND_EXCESS * noise:
        level, asked = max(level, around), max(asked, around)
    return level, asked


@njit(cache=True, nogil=True)
def strongest(spectrum: PowerSpectrum, coarse: float, blocked: Array, margin: float) -> tuple[int, int, float]:
    """Return (direction, bin, level) of the strongest cell whose energy is `coarse` times the level that it must stand
    out of, an energy per sample and delay; direction -1: none.

    `blocked` (B, 2): cells (direction, bin) around which nothing is looked for. A cell weaker than `trailing` must
    stand out `margin` times as far.
    """
    energy, elevations = spectrum.energy, spectrum.elevations
    best, at, bin_at, level_at = 0.0, -1, -1, 0.0
    azimuths = energy.shape[0] // elevations
    for k in range(energy.shape[0]):
        row, behind = energy[k], spectrum.trailing[k // elevations]
        for d in range(energy.shape[1]):
            if row[d] <= best or row[d] < coarse * spectrum.noise[d]:
                continue
            more = margin if row[d] < behind[d] else 1.0
            _, level = local_level(k, d, row[d], spectrum, more)
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
