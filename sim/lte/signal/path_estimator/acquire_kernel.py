"""Compiled search: paths of a spectrum that one-path fits confirm, one by one; `path_estimator._Link._add_any` is its
twin for any array.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.lte.signal.path_estimator.climb_kernel import Steps, climb, steering
from cellslam.sim.lte.signal.path_estimator.correlation_kernel import in_pairs, subtract_products, write_tones
from cellslam.sim.lte.signal.path_estimator.joint_fit_kernel import Normal
from cellslam.sim.lte.signal.path_estimator.search_kernel import (
    Footprint,
    Outputs,
    PowerSpectrum,
    Probe,
    both,
    cell_of,
    footprint_of,
    local_level,
    neighbours,
    note_trail,
    strongest,
    write_all_energies,
    write_energies,
    write_noise,
)
from cellslam.sim.lte.statistical.detector_layout import Array
from cellslam.sim.lte.steering_kernel import SteeringModel


class Rules(NamedTuple):
    """How cells are tried: `coarse` and `threshold` over the level, `promising` share of the threshold, `most` failures
    in all, how far a fit may end from its cell in distance and elevation, `margin` of what lies in diffuse energy,
    `least_gain` of a step over the level.
    """

    coarse: float
    threshold: float
    promising: float
    most: int
    farthest_m: float
    farthest_rad: float
    margin: float
    least_gain: float


class Trials(NamedTuple):
    """Cells (B, 2) of the spectrum that have been tried: the first `tried`, of which `failures` in vain since the last
    joint fit found more.
    """

    cells: Array
    tried: int
    failures: int


@njit(cache=True, nogil=True)
def add_paths(
    residual: Array, outputs: Outputs, taken: Footprint, spectrum: PowerSpectrum, probe: Probe, trials: Trials,
    rules: Rules, steps: Steps, model: SteeringModel, found: Array,
) -> tuple[int, Trials]:  # fmt: skip
    """Write up to len(`found`) (n, 3) more paths, the strongest first, and take them out of the samples `residual`
    (ports, tones) and of the spectrum, out of which others are `taken`; return how many, and all cells that have been
    tried by then.
    """
    added = 0
    write_all_energies(outputs, taken, spectrum)
    while added < len(found):
        trials, k, d, geometry, normal = next_path(residual, spectrum, probe, trials, rules, steps, model)
        if k < 0:
            break
        one = footprint_of(*factors(geometry, normal.weights, model), probe)
        if taken_out(geometry, normal, one, k, d, residual, outputs, taken, spectrum, probe, rules):
            found[added], taken = geometry[0], both(taken, one)
            added += 1
            write_all_energies(outputs, taken, spectrum)
        else:
            trials = Trials(trials.cells, trials.tried, trials.failures + 1)
    return added, trials


@njit(cache=True, nogil=True)
def taken_out(
    geometry: Array, normal: Normal, one: Footprint, k: int, d: int, residual: Array, outputs: Outputs,
    taken: Footprint, spectrum: PowerSpectrum, probe: Probe, rules: Rules,
) -> bool:  # fmt: skip
    """Take `one` path at `geometry` (1, 3), found in direction k and bin d, out of the samples `residual` (ports,
    tones) and the spectrum's noise, unless it does not stand out of what it leaves there; return whether.
    """
    margin = rules.margin if normal.explained < spectrum.trailing[k // spectrum.elevations, d] else 1.0
    at, bin_at = cell_of(geometry[0], probe, spectrum)
    near, rest = neighbours(at, spectrum), both(taken, one)
    port_energy, noise = spectrum.port_energy.copy(), spectrum.noise.copy()
    write_noise(outputs, rest, spectrum)
    write_energies(outputs, rest, near, spectrum)
    _, asked = local_level(at, bin_at, 0.0, spectrum, margin)
    if normal.explained < rules.threshold * asked:
        spectrum.port_energy[:], spectrum.noise[:] = port_energy, noise
        write_energies(outputs, taken, near, spectrum)
        return False
    note_trail(geometry, normal.wald, probe, spectrum)
    samples = residual.view(residual.real.dtype)
    straight, turned = in_pairs(one.on_tones, samples)
    for m in range(len(samples)):
        subtract_products(samples[m], one.on_ports[:, m], straight, turned, samples[m])
    return True


@njit(cache=True, nogil=True)
def factors(geometry: Array, weights: Array, m: SteeringModel) -> tuple[Array, Array]:
    """Return what paths at `geometry` (n, 3) with weights (n, 2) give the ports (n, ports) and the tones (n, tones)."""
    value, _, _ = steering(geometry, m)
    on_ports, tones = np.empty(value.shape[:2], np.complex128), np.empty((len(geometry), 2, len(m.rate)), np.complex128)
    for p in range(len(geometry)):
        on_ports[p] = value[p, :, 0] * weights[p, 0] + value[p, :, 1] * weights[p, 1]
        write_tones(geometry[p, 0], m.rate, tones[p])
    return on_ports, tones[:, 0].copy()


@part
def next_path(
    residual: Array, spectrum: PowerSpectrum, probe: Probe, trials: Trials, rules: Rules, steps: Steps,
    model: SteeringModel,
) -> tuple[Trials, int, int, Array, Normal]:  # fmt: skip
    """Return the cells tried by then, and direction, bin, geometry (1, 3) and normal equations of the next path in the
    samples `residual` (ports, tones) that a one-path fit confirms; direction -1: there is none.
    """
    cells, count, failures = trials
    start = np.empty((1, 3))
    while failures < rules.most:
        k, d, level = strongest(spectrum, rules.coarse, cells[:count], rules.margin)
        if k < 0:
            break
        cells[count, 0], cells[count, 1] = k, d
        count += 1
        start[0, 0], start[0, 1], start[0, 2] = probe.distances[d], probe.azimuths[k], probe.elevations[k]
        asked = rules.threshold * level
        geometry, normal = climb(residual, start, rules.least_gain * level, rules.promising * asked, steps, model)
        near = abs(geometry[0, 0] - start[0, 0]) <= rules.farthest_m
        if near and abs(geometry[0, 2] - start[0, 2]) <= rules.farthest_rad and normal.explained >= asked:
            return Trials(cells, count, failures), k, d, geometry, normal
        failures += 1
    nothing = Normal(0.0, np.zeros((0, 2), np.complex128), np.zeros(0), np.zeros((0, 0)), np.zeros(0))
    return Trials(cells, count, failures), -1, -1, start, nothing
