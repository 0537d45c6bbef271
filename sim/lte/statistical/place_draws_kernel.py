"""Random numbers that belong to a place: the same whenever, and in whatever order, they are asked for.

A key stands for a thing (a world, a virtual transmitter, a square of ground); what is drawn of it are functions of its
key. Source: SplitMix64; Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import part
from cellslam.sim.lte.statistical.detector_layout import Array

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
