"""Compiled: the wrapping of one angle."""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import part

TURN = 2.0 * math.pi


@part
def wrap(angle: float) -> float:
    """Return an angle (rad) wrapped to (-pi, pi], as `frames.wrap_angle` does: exact, however many turns away."""
    if -math.pi < angle <= math.pi:
        return angle
    rest = float(np.fmod(angle, TURN))
    if rest > math.pi:
        return rest - TURN
    return rest + TURN if rest <= -math.pi else rest
