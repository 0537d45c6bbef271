"""Compiled clutter: ghosts of calibration error, diffuse clusters, noise peaks."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from cellslam.sim.lte.detector_model import GHOST_REACH_M, MOST_CLUTTER, Array, Model
from cellslam.sim.lte.measurement_kernel import clutter_row, probability


@njit(cache=True)
def ghost_clutter(geo: Array, gamma: float, model: Model, table: Array, clutter: Any, out: Array) -> int:
    """Draw ghosts that array calibration error makes of one strong path; the 25 dB rule drops the weaker
    ones.
    """
    count = 0
    for _ in range(min(clutter.poisson(model.ghosts), MOST_CLUTTER)):
        level = 10.0 ** (0.1 * (-30.0 + 4.0 * clutter.standard_normal()))
        distance = geo[0] + 0.75 * clutter.standard_normal()
        azimuth = geo[1] + math.radians(40.0) * clutter.standard_normal()
        elevation = geo[2] + math.radians(15.0) * clutter.standard_normal()
        accepted = clutter.random() < probability(gamma * level, False, table) * model.detection_scale
        if accepted and level >= model.ghost_rule:
            clutter_row(out[count], distance, azimuth, elevation, gamma * level, model)
            count += 1
    return count


@njit(cache=True)
def diffuse_clutter(geo: Array, gamma: float, model: Model, table: Array, clutter: Any, out: Array) -> int:
    """Draw components of the diffuse cluster behind one path: 5-110 m later, median 40 m; -14 to -31 dB."""
    count = 0
    for _ in range(min(clutter.poisson(model.diffuse), MOST_CLUTTER)):
        level = 10.0 ** (-0.1 * (14.0 + 17.0 * clutter.random()))
        later = 5.0 + 105.0 * clutter.random() ** 1.585
        azimuth = geo[1] + math.radians(12.0) * clutter.standard_normal()
        elevation = geo[2] + math.radians(6.0) * clutter.standard_normal()
        accepted = clutter.random() < probability(gamma * level, False, table) * model.detection_scale
        if accepted and (later >= GHOST_REACH_M or level >= model.ghost_rule):
            clutter_row(out[count], geo[0] + later, azimuth, elevation, gamma * level, model)
            count += 1
    return count


@njit(cache=True)
def noise_clutter(model: Model, table: Array, threshold: float, clutter: Any, out: Array) -> int:
    """Draw noise peaks over the threshold: uniform in delay window and azimuth."""
    count: int = min(clutter.poisson(model.noise_clutter), MOST_CLUTTER)
    for i in range(count):
        distance = model.window_min + (model.window_max - model.window_min) * clutter.random()
        azimuth = math.pi * (2.0 * clutter.random() - 1.0)
        elevation = math.radians(-30.0 + 90.0 * clutter.random())
        # The excess of a chi-square tail over its threshold is exponential; T = 2 + 0.93 Gamma' on average.
        excess = -math.log(1.0 - clutter.random())
        clutter_row(out[i], distance, azimuth, elevation, (threshold + excess - 2.0) / 0.93, model)
    return count
