"""Compiled: the next path of a spectrum that a one-path fit confirms; `path_estimator._Link._next_any` is its twin.

Source: own derivation, docs/explanation/front-end.md, "Estimator".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.lte.signal.path_estimator.climb_kernel import Steps, climb
from cellslam.sim.lte.signal.path_estimator.joint_fit_kernel import Normal
from cellslam.sim.lte.signal.path_estimator.search_kernel import PowerSpectrum, strongest
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


class Grid(NamedTuple):
    """Searched distances (D,) in m, azimuths and elevations (K,) in rad."""

    delays: Array
    azimuths: Array
    elevations: Array


@njit(cache=True, nogil=True)
def next_path(
    residual: Array, spectrum: PowerSpectrum, grid: Grid, cells: Array, count: int, failures: int, rules: Rules,
    steps: Steps, model: SteeringModel,
) -> tuple[int, int, int, int, Array, Normal]:  # fmt: skip
    """Return how many cells have been tried, how many in vain, and direction, bin, geometry (1, 3) and normal equations
    of the next path in the samples `residual` (ports, tones); direction -1: there is none.

    `cells` (B, 2): the first `count` have been tried before; those tried now are added.
    """
    start = np.empty((1, 3))
    while failures < rules.most:
        k, d, level = strongest(spectrum, rules.coarse, cells[:count], rules.margin)
        if k < 0:
            break
        cells[count, 0], cells[count, 1] = k, d
        count += 1
        start[0, 0], start[0, 1], start[0, 2] = grid.delays[d], grid.azimuths[k], grid.elevations[k]
        asked = rules.threshold * level
        geometry, normal = climb(residual, start, rules.least_gain * level, rules.promising * asked, steps, model)
        near = abs(geometry[0, 0] - start[0, 0]) <= rules.farthest_m
        if near and abs(geometry[0, 2] - start[0, 2]) <= rules.farthest_rad and normal.explained >= asked:
            return count, failures, k, d, geometry, normal
        failures += 1
    nothing = Normal(0.0, np.zeros((0, 2), np.complex128), np.zeros(0), np.zeros((0, 0)), np.zeros(0))
    return count, failures, -1, -1, start, nothing
