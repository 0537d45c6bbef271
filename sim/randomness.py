"""Addressable random streams: every draw of a trial comes from a generator named here.

A stream is `SeedSequence(root, spawn_key=(trial, stream))`, so a resumed or reordered sweep draws the same
numbers, and every estimator meets the same world.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


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


def stream(seed: int, trial: int, name: Stream) -> np.random.Generator:
    """Return the generator of stream `name` in trial `trial` of root seed `seed` (both non-negative)."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial, int(name))))
