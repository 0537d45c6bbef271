"""Compiled: random functions of a direction, as sums of bells on a grid that covers the sphere.

Independent weights of variance one on bells exp(-chord^2 / scale^2) make a field whose values at two directions
correlate by exp(-chord^2 / (2 scale^2)): the convolution of a bell with itself. At each direction the bells that reach
it are scaled so that the field's variance is one. The cells of the grid have fixed numbers, whichever were met first.

Source: Higdon, "Space and space-time modeling using process convolutions", 2002: a Gaussian process as smoothed white
noise on a grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, njit
from cellslam.sim.recording import Floats, Ints

MOST_BELLS = 48  # that reach one direction, at the spacings and radii in use


class Grid(NamedTuple):
    """Cells in rows of constant elevation, `step` (rad) apart, the middle one on the horizon.

    `scale` (rad) of the field; `reach2`: squared chord within which a bell counts; `beyond`: rows so far away count at
    most; `around`, `first` (R,): cells in each row, and the number of the first of them; `cells`: of all rows;
    `heights` (R, 2), `turns` (cells, 2): cosine and sine of the elevation of each row, and of the azimuth of each cell.
    """

    scale: float
    step: float
    reach2: float
    beyond: int
    around: Ints
    first: Ints
    cells: int
    heights: Floats
    turns: Floats


def grid(scale_rad: float, spacing: float, reach: float) -> Grid:
    """Return a grid for a field of this scale (rad); `spacing` of the cells and `reach` of a bell in scales."""
    step = spacing * scale_rad
    half = math.floor(0.5 * math.pi / step)
    height = step * np.arange(-half, half + 1)
    around = np.maximum(np.round(2.0 * np.pi * np.cos(height) / step), 1).astype(np.int64)
    azimuth = np.concatenate([2.0 * np.pi / n * np.arange(n) for n in around])
    heights, turns = (np.stack([np.cos(angle), np.sin(angle)], axis=1) for angle in (height, azimuth))
    first, beyond = np.cumsum(around) - around, math.ceil(reach / spacing)
    return Grid(scale_rad, step, (reach * scale_rad) ** 2, beyond, around, first, len(azimuth), heights, turns)


@lean
def bells(g: Grid, azimuth: float, elevation: float, cells: Ints, values: Floats) -> int:
    """Write the numbers of the cells whose bells reach a direction (rad), and their values there; return how many.

    cells, values (MOST_BELLS,): written; the squares of the values sum to one.
    """
    count, total, rows = 0, 0.0, len(g.around)
    middle, level, rise = round(elevation / g.step) + rows // 2, math.cos(elevation), math.sin(elevation)
    east, north = math.cos(azimuth), math.sin(azimuth)
    for row in range(max(middle - g.beyond, 0), min(middle + g.beyond + 1, rows)):
        around, flat, up = g.around[row], level * g.heights[row, 0], rise * g.heights[row, 1]
        width = 2.0 * math.pi / around
        across = g.reach2 - 2.0 + 2.0 * (flat + up)  # what the chord's square may gain by azimuth
        if across <= 0.0:
            continue
        turn = 2.0 * math.asin(math.sqrt(min(across / (4.0 * max(flat, 1e-12)), 1.0)))
        low, high = math.ceil((azimuth - turn) / width), math.floor((azimuth + turn) / width)
        for j in range(low, min(high, low + around - 1) + 1):
            if count == MOST_BELLS:
                break
            cell = g.first[row] + j % around
            chord2 = 2.0 - 2.0 * (flat * (east * g.turns[cell, 0] + north * g.turns[cell, 1]) + up)
            values[count], cells[count] = math.exp(-chord2 / (g.scale * g.scale)), cell
            total += values[count] * values[count]
            count += 1
    for k in range(count):
        values[k] /= math.sqrt(total)
    return count


@njit(cache=True)
def loads(g: Grid, directions: Floats) -> Floats:
    """Return the values (n, cells) of all bells at directions (n, 2): azimuth and elevation, rad."""
    out, cells, values = np.zeros((len(directions), g.cells)), np.empty(MOST_BELLS, np.int64), np.empty(MOST_BELLS)
    for n in range(len(directions)):
        for k in range(bells(g, directions[n, 0], directions[n, 1], cells, values)):
            out[n, cells[k]] = values[k]
    return out
