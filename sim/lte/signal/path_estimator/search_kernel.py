"""Compiled search of a link's delay-direction spectrum for the strongest peak that stands out of its surroundings.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.lte.signal.path_estimator import thresholds
from cellslam.sim.lte.signal.path_estimator.fit_kernel import (
    MARGIN,
    DelayGrid,
    Normal,
    in_pairs,
    on_ports_of,
    subtract_products,
    write_on_delays,
)
from cellslam.sim.lte.statistical.detector_layout import DIFFUSE_SHARE, Array
from cellslam.sim.lte.steering_kernel import SteeringModel


class Probe(NamedTuple):
    """What samples are looked at with: two `beams` (2, K, P) a direction, of the ports that `by_set` says, of K
    directions, `azimuths`, `elevations` (K,) in rad, azimuth by azimuth, and the D distances of the `grid`.
    """

    beams: Array
    grid: DelayGrid
    azimuths: Array
    elevations: Array


class Footprint(NamedTuple):
    """What n paths give the ports (n, ports), beams (2, n, K) and searched distances (n, D)."""

    on_ports: Array
    on_beams: Array
    on_delays: Array


class PowerSpectrum(NamedTuple):
    """Energies, as in the samples, over K directions (`elevations` to an azimuth) and D delays.

    `energy` (K, D) of both beams of each direction; `port_energy` (D,) of all `ports` that work; `noise` (D,) per
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


@part
def footprint_of(geometry: Array, weights: Array, probe: Probe, model: SteeringModel) -> Footprint:
    """Return the footprint of paths at `geometry` (n, 3) in m, rad, rad, with weights (n, 2)."""
    n, (_, count, seen) = len(geometry), probe.beams.shape
    on_ports = on_ports_of(geometry, weights, model)
    on_beams = np.empty((2, n, count), np.complex64)
    on_delays = np.empty((n, len(probe.grid.distances)), np.complex64)
    if n:
        apart = on_ports.shape[1] // seen
        for s in range(2):
            on_beams[s] = np.ascontiguousarray(on_ports[:, s % apart :: apart]) @ probe.beams[s].T
    for p in range(n):
        write_on_delays(geometry[p, 0], probe.grid, on_delays[p])
    return Footprint(on_ports, on_beams, on_delays)


@part
def both(one: Footprint, other: Footprint) -> Footprint:
    """Return the footprint of the paths of both."""
    return Footprint(
        np.concatenate((one.on_ports, other.on_ports)), np.concatenate((one.on_beams, other.on_beams), 1),
        np.concatenate((one.on_delays, other.on_delays)),
    )  # fmt: skip


@part(fastmath={"contract"})
def write_energies(
    on_beams: Array, taken: Footprint, directions: Array, first: int, last: int, spectrum: PowerSpectrum
) -> None:
    """Write the energies in `directions` (n,), bins `first` to `last`, of what the beams hold, `on_beams` (2, K, 2 D)
    in real and imaginary parts, beside the paths that are taken out.
    """
    width = 2 * (last - first)
    straight, turned = in_pairs(taken.on_delays[:, first:last], spectrum.energy)
    squares, rest = np.empty(width, np.float32), np.empty(width, np.float32)
    for k in directions:
        squares[:] = 0.0
        for s in range(2):
            row = on_beams[s, k, 2 * first : 2 * last]
            subtract_products(row, taken.on_beams[s, :, k], straight, turned, rest)
            for j in range(width):
                squares[j] += rest[j] * rest[j]
        for d in range(last - first):
            spectrum.energy[k, first + d] = squares[2 * d] + squares[2 * d + 1]


@part
def write_energies_around(k: int, d: int, on_beams: Array, taken: Footprint, spectrum: PowerSpectrum) -> None:
    """Write the energies that `local_level` reads, of direction k and bin d."""
    beyond = thresholds.GUARD_BINS + 2 * thresholds.REFERENCE_BINS
    first, last = max(d - beyond, 0), min(d + beyond + 1, spectrum.energy.shape[1])
    write_energies(on_beams, taken, neighbours(k, spectrum), first, last, spectrum)


@njit(cache=True, nogil=True)
def write_all_energies(on_beams: Array, taken: Footprint, spectrum: PowerSpectrum) -> None:
    """Write the energies in all directions."""
    count, bins = spectrum.energy.shape
    write_energies(on_beams, taken, np.arange(count), 0, bins, spectrum)


@njit(cache=True, nogil=True)
def leave(
    samples: Array, geometry: Array, normal: Normal, residual: Array, spectrum: PowerSpectrum, probe: Probe,
    model: SteeringModel,
) -> tuple[Footprint, float]:  # fmt: skip
    """Write what paths, fitted at `geometry` (n, 3), m, rad, rad, leave over of `samples` (ports, D), the `residual`
    (ports, D), its noise, and where their diffuse energy is to be expected; return their footprint and the noise.
    """
    spectrum.trailing[:] = 0.0
    note_trail(geometry, normal.wald, probe, spectrum)
    taken = footprint_of(geometry, normal.weights, probe, model)
    return taken, write_residual(samples, taken, spectrum, residual)


@part(fastmath={"contract"})
def write_residual(samples: Array, taken: Footprint, spectrum: PowerSpectrum, residual: Array) -> float:
    """Write `samples` (ports, D) without the paths that are taken out, the energy of all ports there, and the noise per
    sample over delay: the running median of the ports' mean energy. Return the median of that.

    Cancelling another cell colours the noise over delay; paths fill few cells of a stretch. What differs by no more
    than scatter is set to the median.
    """
    port_energy, noise, bins = spectrum.port_energy, spectrum.noise, len(spectrum.noise)
    straight, turned = in_pairs(taken.on_delays, spectrum.energy)
    before, after = samples.view(np.float32), residual.view(np.float32)
    squares = np.zeros(2 * bins, np.float32)
    for m in range(len(before)):
        rest = after[m]
        subtract_products(before[m], taken.on_ports[:, m], straight, turned, rest)
        for j in range(2 * bins):
            squares[j] += rest[j] * rest[j]
    for d in range(bins):
        port_energy[d] = squares[2 * d] + squares[2 * d + 1]
    running_median(port_energy, spectrum.stretch, noise)
    for d in range(bins):
        noise[d] /= spectrum.ports
    usual = float(np.median(noise))
    for d in range(bins):
        if abs(noise[d] - usual) < thresholds.ALIKE * usual:
            noise[d] = usual
    return usual


@part
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


@part
def note_trail(geometry: Array, energy: Array, probe: Probe, spectrum: PowerSpectrum) -> None:
    """Note where diffuse energy of paths `geometry` (n, 3) in m, rad, rad is to be expected: at most their `energy`
    (n,).
    """
    trailing = spectrum.trailing
    for p in range(len(energy)):
        column = _column(geometry[p, 1], trailing)
        first, last = (
            _bin(geometry[p, 0] + thresholds.LEAD_M, probe),
            _bin(geometry[p, 0] + thresholds.TRAIL_M, probe) + 1,
        )
        for turn in range(-thresholds.BESIDE, thresholds.BESIDE + 1):
            row = trailing[(column + turn) % len(trailing)]
            for d in range(max(first, 0), min(last, len(row))):
                row[d] = max(row[d], np.float32(DIFFUSE_SHARE * energy[p]))


@part
def cell_of(geometry: Array, probe: Probe, spectrum: PowerSpectrum) -> tuple[int, int]:
    """Return the cell (direction, bin) nearest to a path at `geometry` (3,) in m, rad, rad."""
    steps, low, high = spectrum.elevations - 1, probe.elevations[0], probe.elevations[spectrum.elevations - 1]
    rise = min(max(round((geometry[2] - low) / (high - low) * steps), 0), steps)
    column = _column(geometry[1], spectrum.trailing) % len(spectrum.trailing)
    return column * spectrum.elevations + rise, min(max(_bin(geometry[0], probe), 0), len(probe.grid.distances) - 1)


@part
def _column(azimuth: float, trailing: Array) -> int:
    """Return the column of the searched directions nearest to an azimuth, counted beyond a turn."""
    return round((azimuth + math.pi) / (2.0 * math.pi) * len(trailing))


@part
def _bin(distance: float, probe: Probe) -> int:
    distances = probe.grid.distances
    nearest: int = round((distance - distances[0]) / (distances[1] - distances[0]))
    return nearest


@part
def neighbours(k: int, spectrum: PowerSpectrum) -> Array:
    """Return direction k and those around it (9,); at the highest and lowest elevation some come twice."""
    elevations, out = spectrum.elevations, np.empty(9, np.int64)
    azimuths, (a, e) = len(spectrum.energy) // elevations, divmod(k, elevations)
    for i in range(9):
        turn, rise = i // 3 - 1, i % 3 - 1
        out[i] = (a + turn) % azimuths * elevations + min(max(e + rise, 0), elevations - 1)
    return out


@lean
def _surroundings(energy: Array, k: int, d: int, elevations: int) -> tuple[float, float]:
    """Return half the mean energy of direction k and its neighbours before bin d, and behind: of two stretches on each
    side the lesser, for another path there must not hide one in d.
    """
    azimuths, (a, e), last = len(energy) // elevations, divmod(k, elevations), energy.shape[1] - 1
    before, long_before, behind, long_behind = 0.0, 0.0, 0.0, 0.0
    for turn in range(-1, 2):
        column = (a + turn) % azimuths * elevations
        for rise in range(-1, 2):
            beside = column + min(max(e + rise, 0), elevations - 1)
            for way in range(thresholds.GUARD_BINS + 1, thresholds.GUARD_BINS + 1 + thresholds.REFERENCE_BINS):
                far = way + thresholds.REFERENCE_BINS
                before += energy[beside, max(d - way, 0)]
                long_before += energy[beside, max(d - far, 0)]
                behind += energy[beside, min(d + way, last)]
                long_behind += energy[beside, min(d + far, last)]
    share = 0.5 / (9 * thresholds.REFERENCE_BINS)
    return share * min(before, long_before), share * min(behind, long_behind)


@lean
def local_level(k: int, d: int, peak: float, spectrum: PowerSpectrum, diffuse: bool) -> tuple[float, float]:
    """Return the disturbance per sample around a cell of energy `peak`, and the level that the cell must stand out of.

    Disturbance is noise, or what exceeds it before or behind in the same directions (greatest-of), or in all other
    directions at the same delay. Where `diffuse` energy is expected, what stands before or behind counts several
    times for the second.
    """
    noise = spectrum.noise[d]
    before, behind = _surroundings(spectrum.energy, k, d, spectrum.elevations)
    # A path's own sidelobes over delay are no disturbance.
    along = max(before, behind) - thresholds.SIDELOBES * peak
    around = level_around(d, peak, spectrum)
    level, asked = around, around
    if along > thresholds.LOCAL_EXCESS * noise:
        level, asked = max(level, along), max(asked, (thresholds.DIFFUSE_MARGIN if diffuse else 1.0) * along)
    return level, asked


@lean
def level_around(d: int, peak: float, spectrum: PowerSpectrum) -> float:
    """Return the disturbance per sample in all directions beside a cell of energy `peak` in bin d: at least noise."""
    around = max(spectrum.port_energy[d] - peak, 0.0) / (spectrum.ports - 2)
    return float(around if around > thresholds.AROUND_EXCESS * spectrum.noise[d] else spectrum.noise[d])


@part
def standing_out(spectrum: PowerSpectrum, coarse: float) -> tuple[Array, Array]:
    """Return the peaks (n, 2), direction and bin, within the window whose energy is `coarse` times the level that each
    must stand out of, the strongest first, and these levels (n,), energies per sample and delay.

    A cell weaker than `trailing` must stand out farther.
    """
    (count, bins), n = spectrum.energy.shape, 0
    cells, level, energy = np.empty((count * bins, 2), np.int64), np.empty(count * bins), np.empty(count * bins)
    least = (coarse * spectrum.noise).astype(np.float32)
    for k in range(count):
        for d in range(MARGIN, bins - MARGIN):
            own = spectrum.energy[k, d]
            if own < least[d] or own < coarse * level_around(d, own, spectrum) or not _is_peak(k, d, spectrum):
                continue
            _, asked = local_level(k, d, own, spectrum, own < spectrum.trailing[k // spectrum.elevations, d])
            if own >= coarse * asked:
                cells[n, 0], cells[n, 1], level[n], energy[n] = k, d, asked, own
                n += 1
    order = np.argsort(-energy[:n])
    return cells[order], level[order]


@lean
def _is_peak(k: int, d: int, spectrum: PowerSpectrum) -> bool:
    """Return whether no neighbour of bin d in direction k has more energy."""
    energy, elevations = spectrum.energy, spectrum.elevations
    azimuths, (a, e), most = len(energy) // elevations, divmod(k, elevations), energy[k, d]
    for turn in range(-1, 2):
        column = (a + turn) % azimuths * elevations
        for beside in range(column + max(e - 1, 0), column + min(e + 2, elevations)):
            if max(energy[beside, d - 1], energy[beside, d], energy[beside, d + 1]) > most:
                return False
    return True


@part
def is_beside(cell: Array, others: Array, spectrum: PowerSpectrum) -> bool:
    """Return whether a cell (2,) is one of `others` (n, 2), or next to it."""
    elevations, beside = spectrum.elevations, False
    for other in others:
        turn = abs(cell[0] // elevations - other[0] // elevations)
        near = min(turn, len(spectrum.energy) // elevations - turn) <= 1
        rise = abs(cell[0] % elevations - other[0] % elevations)
        beside = beside or (near and rise <= 1 and abs(cell[1] - other[1]) <= 1)
    return beside
