"""Points that fill the unit cube evenly."""

from __future__ import annotations

import numpy as np

from cellslam.sim.recording import Floats


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
