"""Compiled clutter: what is reported around a path besides it, and noise peaks.

Source: own derivation, docs/front-end.md, "Statistical front end".
"""

from __future__ import annotations

import math
from typing import Any

from cellslam.sim.compiling import njit
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.statistical.detector_layout import (
    DIFFUSE_SHARE,
    DIFFUSE_TO_M,
    DISTANCE,
    DISTURBED,
    ELEVATION,
    GAMMA_START_DB,
    GAMMA_STEP_DB,
    MOST_CLUTTER,
    TRAIL_BESIDE_RAD,
    TRAIL_DECAY_M,
    Array,
    Model,
)
from cellslam.sim.lte.statistical.measurement_kernel import clutter_row, detection_probability

# Few points of clutter were measured: what is drawn lies about one of them, so that no two coincide.
STRETCH, BLUR_M, BLUR_AZIMUTH_RAD, BLUR_ELEVATION_RAD = 0.3, 4.0, math.radians(4.0), math.radians(3.0)


@njit(cache=True)
def trailing(a: Array, b: Array, model: Model) -> float:
    """Return the disturbance at path a, per integrated SNR of the stronger path b: b's diffuse energy behind it and the
    sidelobes over delay, from the direction of a and from anywhere.
    """
    behind = a[0] - b[0]
    beside, aside = wrap(a[1] - b[1]) / TRAIL_BESIDE_RAD, behind / model.sidelobe_m
    fall = model.sidelobes / (1.0 + aside * aside)
    if 0.0 <= behind <= DIFFUSE_TO_M:
        fall += math.exp(-behind / TRAIL_DECAY_M)
    return float(fall * (model.trail * math.exp(-0.5 * beside * beside) + model.around))


@njit(cache=True)
def structured_clutter(path: int, paths: int, geo: Array, gamma: Array, model: Model, clutter: Any, out: Array) -> int:
    """Draw what is reported around one path besides it: pieces of its diffuse energy, ghosts of calibration error. What
    the energy of the other `paths` covers is not seen.
    """
    own = geo[path]
    nodes = len(model.clutter_mean)
    at = (10.0 * math.log10(max(gamma[path], 1e-9)) - GAMMA_START_DB) / GAMMA_STEP_DB
    at = min(max(at, 0.0), nodes - 1.001)
    low = int(at)
    part = at - low
    mean = (1.0 - part) * model.clutter_mean[low] + part * model.clutter_mean[low + 1]
    if paths > 1:
        mean *= model.company
    count = 0
    for _ in range(min(clutter.poisson(mean), MOST_CLUTTER)):
        node = low + 1 if clutter.random() < part else low
        point = model.clutter_points[node, int(clutter.random() * model.clutter_points.shape[1])]
        stretch = 1.0 + STRETCH * (2.0 * clutter.random() - 1.0)
        later = point[0] * stretch + BLUR_M * clutter.standard_normal()
        azimuth = own[1] + point[1] * stretch + BLUR_AZIMUTH_RAD * clutter.standard_normal()
        elevation = own[2] + point[2] * stretch + BLUR_ELEVATION_RAD * clutter.standard_normal()
        level = 10.0 ** (0.1 * point[3])
        row = out[count]
        clutter_row(row, own[0] + later, azimuth, elevation, level * model.samples, model)
        disturbance = 1.0
        for q in range(paths):
            if q != path and level * model.samples < DIFFUSE_SHARE * gamma[q]:
                disturbance += gamma[q] * trailing(row[DISTANCE : ELEVATION + 1], geo[q], model)
        chance = model.detection_scale
        if disturbance > DISTURBED:
            chance *= detection_probability(level * model.samples / disturbance, True, model)
        inside = model.window_min <= row[DISTANCE] <= model.window_max
        if clutter.random() < chance and inside:
            count += 1
    return count


@njit(cache=True)
def noise_clutter(model: Model, clutter: Any, out: Array) -> int:
    """Draw noise peaks over the threshold: uniform in delay window and azimuth."""
    count: int = min(clutter.poisson(model.noise_clutter), MOST_CLUTTER)
    for i in range(count):
        distance = model.window_min + (model.window_max - model.window_min) * clutter.random()
        azimuth = math.pi * (2.0 * clutter.random() - 1.0)
        elevation = math.radians(-15.0 + 75.0 * clutter.random())
        # The excess of a chi-square tail over its threshold is exponential; T = 2 + 0.93 Gamma' on average.
        excess = -math.log(1.0 - clutter.random())
        clutter_row(out[i], distance, azimuth, elevation, (model.threshold + excess - 2.0) / 0.93, model)
    return count
