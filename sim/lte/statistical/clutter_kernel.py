"""Compiled clutter: what is reported around a path besides it, and noise peaks.

What stands still is drawn from random numbers that belong to a place: the same whenever, and in whatever order, they
are asked for. A key stands for a thing (a world, a virtual transmitter, a square of ground); what is drawn of it are
functions of its key.

Source: own derivation, docs/explanation/front-end.md, "Statistical front end"; keys: SplitMix64; Steele, Lea, Flood,
"Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellslam.sim.compiling import part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import Array, Model
from cellslam.sim.lte.statistical.measurement_kernel import body_geometry, clutter_row, detection_probability, fold

# Few points of clutter were measured: what is drawn lies about one of them, so that no two coincide.
STRETCH, BLUR_AZIMUTH_RAD, BLUR_ELEVATION_RAD = 0.3, math.radians(4.0), math.radians(3.0)
_STEP, _FIRST, _SECOND = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_SHIFT = 0x5EED  # number under which a grid's shift is drawn of its key
_PER_M = 100.0  # positions of virtual transmitters count to a centimetre


@part
def joined(key: np.uint64, number: int) -> np.uint64:
    """Return the key of the thing of this number that belongs to `key`."""
    z = (key + _STEP) ^ (np.uint64(number) * _SECOND)
    z = (z ^ (z >> _30)) * _FIRST
    z = (z ^ (z >> _27)) * _SECOND
    return z ^ (z >> _31)


@part
def uniform(key: np.uint64, number: int) -> float:
    """Return the draw of this number of a key, uniform in [0, 1)."""
    return float((joined(key, number) >> _11) * 2.0**-53)


@part
def normal(key: np.uint64, number: int) -> float:
    """Return the draw of this number of a key, standard normal (Box and Muller)."""
    own = joined(key, number)
    return math.sqrt(-2.0 * math.log(1.0 - uniform(own, 0))) * math.cos(2.0 * math.pi * uniform(own, 1))


@part
def poisson(mean: float, u: float, most: int) -> int:
    """Return the Poisson number at the cumulative probability `u`, no more than `most`: it grows with the mean."""
    count, chance = 0, math.exp(-mean)
    below = chance
    while below <= u and count < most:
        count += 1
        chance *= mean / count
        below += chance
    return count


@part
def key_of_place(key: np.uint64, position: Array) -> np.uint64:
    """Return the key of a position (3,) in m."""
    for i in range(3):
        key = joined(key, round(_PER_M * position[i]))
    return key


@part
def square_of(key: np.uint64, position: Array, side: float) -> np.uint64:
    """Return the key of the square of ground in which a position is: of this side in m, in a grid of the key's own."""
    grid = joined(key, _SHIFT)
    for i in range(2):
        key = joined(key, math.floor(position[i] / side + uniform(grid, i)))
    return key


@part
def write_centre(key: np.uint64, position: Array, side: float, out: Array) -> None:
    """Write the centre of that square, at the position's height, into `out` (3,), in m."""
    grid = joined(key, _SHIFT)
    for i in range(2):
        shift = uniform(grid, i)
        out[i] = (math.floor(position[i] / side + shift) + 0.5 - shift) * side
    out[2] = position[2]


@part
def trailing(a: Array, b: Array, model: Model) -> float:
    """Return the disturbance at path a, per integrated SNR of the stronger path b: b's diffuse energy behind it and the
    sidelobes over delay, from the direction of a and from anywhere.
    """
    behind = a[0] - b[0]
    beside, aside = wrap(a[1] - b[1]) / k.TRAIL_BESIDE_RAD, behind / model.overlap.sidelobe_m
    fall = model.overlap.sidelobes / (1.0 + aside * aside)
    if 0.0 <= behind <= k.DIFFUSE_TO_M:
        fall += math.exp(-behind / k.TRAIL_DECAY_M)
    return float(fall * (model.overlap.trail * math.exp(-0.5 * beside * beside) + model.overlap.around))


@part
def expected_clutter(gamma: float, paths: int, model: Model) -> tuple[float, int, float]:
    """Return the mean clutter around one of `paths` of integrated SNR `gamma`, the node below that, and how far it is
    on the way to the next.
    """
    nodes = len(model.clutter.mean)
    at = (10.0 * math.log10(max(gamma, 1e-9)) - k.GAMMA_START_DB) / k.GAMMA_STEP_DB
    at = min(max(at, 0.0), nodes - 1.001)
    low = int(at)
    part = at - low
    mean = (1.0 - part) * model.clutter.mean[low] + part * model.clutter.mean[low + 1]
    if paths > 1:
        mean *= model.clutter.company
    return mean, low, part


@part
def uncovered(row: Array, level: float, path: int, paths: int, geo: Array, gamma: Array, model: Model) -> float:
    """Return the probability that clutter of this integrated SNR is reported beside the energy of the other paths."""
    disturbance = 1.0
    for q in range(paths):
        if q != path and level < k.DIFFUSE_SHARE * gamma[q]:
            disturbance += gamma[q] * trailing(row[k.DISTANCE : k.ELEVATION + 1], geo[q], model)
    chance = model.detection.scale
    if disturbance > k.DISTURBED:
        chance *= detection_probability(level / disturbance, True, model)
    return chance


@part
def structured_clutter(path: int, paths: int, geo: Array, gamma: Array, model: Model, clutter: Any, out: Array) -> int:
    """Draw what is reported around one path besides it: pieces of its diffuse energy, ghosts of calibration error. What
    the energy of the other `paths` covers is not seen.
    """
    own = geo[path]
    mean, low, part = expected_clutter(gamma[path], paths, model)
    count = 0
    for _ in range(min(clutter.poisson(mean * (1.0 - model.standing.share)), k.MOST_CLUTTER)):
        node = low + 1 if clutter.random() < part else low
        point = model.clutter.points[node, int(clutter.random() * model.clutter.points.shape[1])]
        stretch = 1.0 + STRETCH * (2.0 * clutter.random() - 1.0)
        later = point[0] * stretch + model.clutter.blur_m * clutter.standard_normal()
        azimuth = own[1] + point[1] * stretch + BLUR_AZIMUTH_RAD * clutter.standard_normal()
        elevation = own[2] + point[2] * stretch + BLUR_ELEVATION_RAD * clutter.standard_normal()
        level = 10.0 ** (0.1 * point[3]) * model.budget.samples
        row = out[count]
        clutter_row(row, own[0] + later, azimuth, elevation, level, model)
        inside = model.detection.window_min_m <= row[k.DISTANCE] <= model.detection.window_max_m
        if clutter.random() < uncovered(row, level, path, paths, geo, gamma, model) and inside:
            count += 1
    return count


@part
def standing_clutter(
    path: int, paths: int, geo: Array, gamma: Array, pose: Array, vt: Array, port: int, model: Model, clutter: Any,
    out: Array,
) -> int:  # fmt: skip
    """Draw what is reported around one path besides it where that stands still: virtual transmitters, the same for all
    links in a square of ground. Which of them a port sees changes over a shorter distance.
    """
    standing = model.standing
    mean, low, part = expected_clutter(gamma[path], paths, model)
    source = key_of_place(standing.world, vt)
    square = square_of(source, pose, standing.life_m)
    centre, seen, toward, scatterer = np.zeros(6), np.empty(3), np.empty(3), np.empty(3)
    write_centre(source, pose, standing.life_m, centre)
    body_geometry(centre, vt, toward)
    count, here = 0, mean * standing.share / (standing.lit * standing.reported)
    for number in range(poisson(here, uniform(square, 0), k.MOST_CLUTTER)):
        key = joined(square, 1 + number)
        spot = joined(square_of(key, pose, standing.fading_m), port)
        if uniform(spot, 0) >= standing.lit:
            continue
        node = low + 1 if uniform(key, 0) < part else low
        point = model.clutter.points[node, int(uniform(key, 1) * model.clutter.points.shape[1])]
        stretch = 1.0 + STRETCH * (2.0 * uniform(key, 2) - 1.0)
        reach = toward[0] + point[0] * stretch + model.clutter.blur_m * normal(key, 3)
        azimuth = toward[1] + point[1] * stretch + BLUR_AZIMUTH_RAD * normal(key, 4)
        elevation = toward[2] + point[2] * stretch + BLUR_ELEVATION_RAD * normal(key, 5)
        flat = reach * math.cos(elevation)
        scatterer[0] = centre[0] + flat * math.cos(azimuth)
        scatterer[1] = centre[1] + flat * math.sin(azimuth)
        scatterer[2] = centre[2] + reach * math.sin(elevation)
        body_geometry(pose, scatterer, seen)
        level = 10.0 ** (0.1 * point[3]) * model.budget.samples
        row = out[count]
        clutter_row(row, seen[0], seen[1], seen[2], level, model)
        for i in range(3):
            row[k.DISTANCE + i] += row[k.CLAIMED_STD + i] * clutter.standard_normal()
        fold(row)
        inside = model.detection.window_min_m <= row[k.DISTANCE] <= model.detection.window_max_m
        chance = standing.reported * uncovered(row, level, path, paths, geo, gamma, model)
        if clutter.random() < chance and inside:
            count += 1
    return count


@part
def noise_clutter(model: Model, clutter: Any, out: Array) -> int:
    """Draw noise peaks over the threshold: uniform in delay window and azimuth."""
    count: int = min(clutter.poisson(model.clutter.noise_peaks), k.MOST_CLUTTER)
    nearest, farthest = model.detection.window_min_m, model.detection.window_max_m
    for i in range(count):
        distance = nearest + (farthest - nearest) * clutter.random()
        azimuth = math.pi * (2.0 * clutter.random() - 1.0)
        elevation = math.radians(-15.0 + 75.0 * clutter.random())
        # The excess of a chi-square tail over its threshold is exponential; T = 2 + 0.93 Gamma' on average.
        excess = -math.log(1.0 - clutter.random())
        clutter_row(out[i], distance, azimuth, elevation, (model.detection.threshold + excess - 2.0) / 0.93, model)
    return count
