"""Tree trunks in laser scans: short arcs that stand free, each as range and bearing of its centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.recording import Floats, Ints

STEP_RAD = np.pi / 360.0


@dataclass(frozen=True)
class TreeRules:
    """What is taken for a trunk. Lengths in metres; `least_beams`: beams that must hit it."""

    least_range_m: float = 1.0
    most_range_m: float = 75.0
    jump_m: float = 1.5
    most_diameter_m: float = 1.0
    least_beams: int = 2
    depth_share: float = 1.0
    margin_rad: float = np.radians(2.5)


@dataclass(frozen=True)
class Trees:
    """One row a tree: scan, range and bearing of its centre (bearing 0 ahead, positive to the left), diameter."""

    scan: Ints
    range_m: Floats
    bearing_rad: Floats
    diameter_m: Floats


def find_trees(ranges_m: ArrayLike, rules: TreeRules | None = None) -> Trees:
    """Return the trunks in scans (S, 361) of ranges in metres, half a degree apart from right (-90) to left (+90 deg).

    A segment ends where the next beam hits nothing or jumps by more than `jump_m`. It is a trunk if it is no wider
    than `most_diameter_m`, as deep as a round thing of its width can be, lies inside the scan, and neither neighbour
    stands
    before it (its edge would be hidden). Diameter: range times the angle of its beams; centre: mean range plus pi/4 of
    the radius, the mean depth of a circle over evenly spread chords.
    """
    rules = rules or TreeRules()
    r = np.asarray(ranges_m, np.float64)
    scan, beam = np.nonzero((r > rules.least_range_m) & (r < rules.most_range_m))
    if not len(scan):
        return Trees(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))
    value = r[scan, beam]
    follows = (np.diff(scan) == 0) & (np.diff(beam) == 1)
    cut = ~follows | (np.abs(np.diff(value)) > rules.jump_m)
    first = np.flatnonzero(np.append(True, cut))
    last = np.append(first[1:], len(value)) - 1
    beams = last - first + 1
    mean = np.add.reduceat(value, first) / beams
    depth = np.maximum.reduceat(value, first) - np.minimum.reduceat(value, first)
    diameter = mean * 2.0 * np.tan(0.5 * STEP_RAD * beams)
    hidden = np.zeros(len(first), bool)
    joined = np.append(follows, False)
    hidden |= joined[last] & (value[np.minimum(last + 1, len(value) - 1)] < value[last])
    before = np.append(False, follows)
    hidden |= before[first] & (value[first - 1] < value[first])
    bearing = 0.5 * (beam[first] + beam[last]) * STEP_RAD - 0.5 * np.pi
    inside = np.abs(bearing) < 0.5 * np.pi - rules.margin_rad
    trunk = (
        (beams >= rules.least_beams)
        & (diameter <= rules.most_diameter_m)
        & inside
        & ~hidden
        & (depth <= rules.depth_share * diameter + 0.1)
    )
    centre = mean + 0.125 * np.pi * diameter
    return Trees(scan[first][trunk].astype(np.int64), centre[trunk], bearing[trunk], diameter[trunk])
