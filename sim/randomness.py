"""Addressable random streams: every draw of a trial comes from a generator named here.

A stream is `SeedSequence(root, spawn_key=(trial, stream))`, so a resumed or reordered sweep draws the same
numbers, and every estimator meets the same world.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from cellslam.sim.recording import Floats


class Stream(IntEnum):
    """Streams of one trial; their numbers are part of the reproducibility contract and never change."""

    CITY = 0
    ROUTE = 1
    ODOMETRY = 2
    NOISE = 3
    DETECTION = 4
    CLUTTER = 5
    OFFSETS = 6
    ESTIMATOR = 7
    SITES = 8
    VEHICLE = 9
    RECEIVER = 10
    TRAFFIC = 11
    ARRAY = 12
    CLOCKS = 13
    SENSORS = 14
    REPORTS = 15
    SURVEY = 16
    SCATTERERS = 17


def stream(seed: int, trial: int, name: Stream) -> np.random.Generator:
    """Return the generator of stream `name` in trial `trial` of root seed `seed` (both non-negative)."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial, int(name))))


def quasi_random(count: int, dimensions: int, rng: np.random.Generator) -> Floats:
    """Return `count` points (count, dimensions) in the open unit cube: Roberts' R-sequence, randomly shifted.

    Source: M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018): steps by powers of the root of
    x^(d + 1) = x + 1.
    """
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    points = (rng.random(dimensions) + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.clip(points, 1e-9, 1 - 1e-9)
