"""Compiled decisions of the path estimator: which cells become paths, and which paths of a joint fit stay.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.signal.path_estimator import fit_kernel, search_kernel, thresholds
from cellslam.sim.lte.signal.path_estimator.fit_kernel import Normal
from cellslam.sim.lte.signal.path_estimator.search_kernel import Footprint, PowerSpectrum, Probe
from cellslam.sim.lte.statistical.detector_layout import DIFFUSE_SHARE, GHOST_REACH_M, Array
from cellslam.sim.lte.steering_kernel import SteeringModel


class Demands(NamedTuple):
    """What a receiver demands of paths: `threshold` of their energy over the disturbance; `coarser`, resolution in
    distance over that of 100 resource blocks of LTE; more than `ghost_share` of the energy of any path within reach;
    a distance within the window.
    """

    threshold: float
    coarser: float
    ghost_share: float
    window_min_m: float
    window_max_m: float


class Trials(NamedTuple):
    """Cells (B, 2) of the spectrum that have been tried: the first `tried`, of which `failures` in vain since the last
    joint fit found more.
    """

    cells: Array
    tried: int
    failures: int


@njit(cache=True, nogil=True)
def add_paths(
    residual: Array, on_beams: Array, taken: Footprint, spectrum: PowerSpectrum, probe: Probe, trials: Trials,
    demands: Demands, model: SteeringModel, found: Array,
) -> tuple[int, Trials]:  # fmt: skip
    """Write up to len(`found`) (n, 3) more paths that one-path fits confirm, the strongest first, and take them out of
    the samples `residual` (ports, D) and of the spectrum, out of which others are `taken`; return how many, and all
    cells that have been tried by then.
    """
    (cells, tried, failures), added, start = trials, 0, np.empty((1, 3))
    coarse, at = thresholds.COARSE_SHARE * demands.threshold, 0
    search_kernel.write_all_energies(on_beams, taken, spectrum)
    promising, levels = search_kernel.standing_out(spectrum, coarse)
    while added < len(found) and failures < thresholds.MOST_FAILURES:
        while at < len(promising) and search_kernel.is_beside(promising[at], cells[:tried], spectrum):
            at += 1
        if at == len(promising):
            break
        (k, d), level = promising[at], levels[at]
        cells[tried, 0], cells[tried, 1] = k, d
        tried, failures = tried + 1, failures + 1
        start[0, 0], start[0, 1], start[0, 2] = probe.grid.distances[d], probe.azimuths[k], probe.elevations[k]
        asked = demands.threshold * level
        geometry, normal = fit_kernel.climb(
            residual, probe.grid, start, thresholds.COARSE_GAIN * level, thresholds.PROMISING_SHARE * asked, model
        )
        near = abs(geometry[0, 0] - start[0, 0]) <= thresholds.FARTHEST_M * demands.coarser
        if not near or abs(geometry[0, 2] - start[0, 2]) > thresholds.FARTHEST_RAD or normal.explained < asked:
            continue
        one = search_kernel.footprint_of(geometry, normal.weights, probe, model)
        if _taken_out(geometry, normal, one, k, d, residual, on_beams, taken, spectrum, probe, demands):
            found[added], taken = geometry[0], search_kernel.both(taken, one)
            added, failures = added + 1, failures - 1
            search_kernel.write_all_energies(on_beams, taken, spectrum)
            (promising, levels), at = search_kernel.standing_out(spectrum, coarse), 0
    return added, Trials(cells, tried, failures)


@part
def _taken_out(
    geometry: Array, normal: Normal, one: Footprint, k: int, d: int, residual: Array, on_beams: Array,
    taken: Footprint, spectrum: PowerSpectrum, probe: Probe, demands: Demands,
) -> bool:  # fmt: skip
    """Take `one` path at `geometry` (1, 3), found in direction k and bin d, out of the samples `residual` (ports,
    D) and the spectrum's noise, unless it does not stand out of what it leaves there; return whether.
    """
    diffuse = normal.explained < spectrum.trailing[k // spectrum.elevations, d]
    at, bin_at = search_kernel.cell_of(geometry[0], probe, spectrum)
    port_energy, noise, left = spectrum.port_energy.copy(), spectrum.noise.copy(), np.empty_like(residual)
    search_kernel.write_residual(residual, one, spectrum, left)
    search_kernel.write_energies_around(at, bin_at, on_beams, search_kernel.both(taken, one), spectrum)
    _, asked = search_kernel.local_level(at, bin_at, 0.0, spectrum, diffuse)
    if normal.explained < demands.threshold * asked:
        spectrum.port_energy[:], spectrum.noise[:] = port_energy, noise
        search_kernel.write_energies_around(at, bin_at, on_beams, taken, spectrum)
        return False
    search_kernel.note_trail(geometry, normal.wald, probe, spectrum)
    residual[:] = left
    return True


@njit(cache=True, nogil=True)
def judged(
    geometry: Array, normal: Normal, on_beams: Array, taken: Footprint, spectrum: PowerSpectrum, probe: Probe,
    demands: Demands,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the disturbance per sample (n,) around each path of a fit, whose paths are those taken out; the paths'
    covariances (n, 3, 3) in m, rad, rad; and which paths (n,) stay: of those that fall short, the weakest within reach
    of each other goes. Energies are written where they are looked at.
    """
    n, energy, distance = len(geometry), normal.wald, geometry[:, 0]
    level, statistic, bad = np.empty(n), np.empty(n), np.zeros(n, np.bool_)
    lowest, highest = probe.elevations[0], probe.elevations[spectrum.elevations - 1]
    beside_rad = (thresholds.BESIDE + 0.5) * 2.0 * math.pi / len(spectrum.trailing)
    for i in range(n):
        diffuse, suspect = False, False
        for j in range(n):
            behind, share = distance[i] - distance[j], energy[i] / max(energy[j], 1e-300)
            beside = abs(wrap(geometry[i, 1] - geometry[j, 1])) < beside_rad
            diffuse |= thresholds.LEAD_M < behind < thresholds.TRAIL_M and beside and share < DIFFUSE_SHARE
            suspect |= abs(behind) < GHOST_REACH_M and share < thresholds.SUSPECT_SHARE
            bad[i] |= abs(behind) < GHOST_REACH_M and share < demands.ghost_share
        k, d = search_kernel.cell_of(geometry[i], probe, spectrum)
        search_kernel.write_energies_around(k, d, on_beams, taken, spectrum)
        level[i], asked = search_kernel.local_level(k, d, 0.0, spectrum, diffuse)
        statistic[i] = energy[i] / asked
        bad[i] |= statistic[i] < demands.threshold * (thresholds.SUSPECT_MARGIN if suspect else 1.0)
        bad[i] |= distance[i] < demands.window_min_m or distance[i] > demands.window_max_m
        bad[i] |= geometry[i, 2] < lowest or geometry[i, 2] > highest
    inverse, covariance = fit_kernel.inverse_information(normal.information), np.empty((n, 3, 3))
    reliable = (thresholds.LEAST_RELIABLE_M * demands.coarser, *thresholds.LEAST_RELIABLE_RAD)
    for i in range(n):
        covariance[i] = inverse[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] * level[i]
        for c in range(3):
            bad[i] |= not 0.0 < covariance[i, c, c] < reliable[c] ** 2
    kept, reach = np.ones(n, np.bool_), thresholds.TOUCHING_M * demands.coarser
    for i in np.argsort(statistic):
        kept[i] = not bad[i] or bool((~kept & (np.abs(distance - distance[i]) <= reach)).any())
    return level, covariance, kept
