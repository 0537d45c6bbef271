"""The speed profile: starts, stops, turns, a slowly varying cruise; distance and duration are met exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.vehicle.vehicle_config import VehicleConfig

CELL_M = 0.1
SMOOTHING_S = 0.6
"""Length of the moving average that bounds the jerk."""
GREATEST_CRUISE_MPS = 20.0
VARIATION_M = 25.0
"""Correlation length of the slow variation of the speed."""
LEAST_FACTOR = 0.4


@dataclass(frozen=True)
class SpeedLimits:
    """What bounds the speed along the route, on cells of equal length: `arc_m` (n + 1,) at the cells' ends.

    `factor` (n + 1,) multiplies the cruise speed; `turn_mps` (n + 1,) is the limit in turns, zero at stops.
    """

    arc_m: Floats
    factor: Floats
    turn_mps: Floats
    acceleration_mps2: float

    def speed(self, cruise_mps: float) -> Floats:
        """Return the greatest speed (n + 1,) in m/s within limits and acceleration, at a given cruise speed."""
        square = np.minimum(cruise_mps * self.factor, self.turn_mps) ** 2
        slope = 2.0 * self.acceleration_mps2 * self.arc_m
        ahead = np.minimum.accumulate((square + slope)[::-1])[::-1] - slope
        behind = np.minimum.accumulate(square - slope) + slope
        return np.sqrt(np.maximum(np.minimum(ahead, behind), 0.0))

    def travel_time(self, cruise_mps: float) -> Floats:
        """Return the time (n + 1,) in s at which each cell's end is reached, standing phases not counted."""
        v = self.speed(cruise_mps)
        return np.concatenate([[0.0], np.cumsum(np.diff(self.arc_m) * 2.0 / (v[1:] + v[:-1]))])


def speed_profile(
    route_arc_m: Floats, curvature_per_m: Floats, config: VehicleConfig, step_s: float, steps: int,
    rng: np.random.Generator,
) -> Floats:  # fmt: skip
    """Return the mean speed (steps,) in m/s of each substep of `step_s`; they sum up to exactly `config.distance_m`.

    The cruise speed is whatever makes the drive last `steps * step_s`. Raises InputError where no speed does.
    """
    # Standing phases, spread over the route.
    slot = (np.arange(config.stops) + rng.uniform(0.25, 0.75, config.stops)) / max(config.stops, 1)
    stop_m = np.round(slot * config.distance_m / CELL_M) * CELL_M
    stand_s = config.stop_s * rng.uniform(0.5, 1.5, config.stops)
    cells = max(round(config.distance_m / CELL_M), 2)
    stop = np.clip(np.round(stop_m / config.distance_m * cells).astype(int), 0, cells)
    limits = _limits(route_arc_m, curvature_per_m, stop, cells, config, rng)
    first_s = config.stand_first_s + SMOOTHING_S
    moving_s = steps * step_s - float(stand_s.sum()) - first_s - SMOOTHING_S
    cruise_mps = _cruise(limits, moving_s, config)
    wait_s = np.zeros(cells + 1)
    np.add.at(wait_s, stop, stand_s)
    arrive_s = first_s + limits.travel_time(cruise_mps) + np.concatenate([[0.0], np.cumsum(wait_s)[:-1]])
    # Each stop stands twice: on arriving and on leaving.
    double = np.repeat(np.arange(cells + 1), np.where(wait_s > 0.0, 2, 1))
    leaving = np.concatenate([[False], double[1:] == double[:-1]])
    time_s = np.where(leaving, (arrive_s + wait_s)[double], arrive_s[double])
    edges_s = np.arange(steps + 1, dtype=np.float64) * step_s
    moved = np.diff(_position(edges_s, time_s, limits.arc_m[double], limits.speed(cruise_mps)[double]))
    width = max(round(SMOOTHING_S / step_s), 1)
    smooth = np.convolve(moved, np.full(width, 1.0 / width), mode="same")
    return np.asarray(smooth * (config.distance_m / smooth.sum() / step_s), np.float64)


def _limits(
    route_arc_m: Floats, curvature_per_m: Floats, stop: Ints, cells: int, config: VehicleConfig,
    rng: np.random.Generator,
) -> SpeedLimits:  # fmt: skip
    arc = np.linspace(0.0, config.distance_m, cells + 1)
    bend = np.maximum(np.abs(np.interp(arc, route_arc_m, curvature_per_m)), 1e-6)
    turn = np.sqrt(config.lateral_acceleration_mps2 / bend)
    turn[[0, -1]] = 0.0
    turn[stop] = 0.0
    waves = np.arange(1, max(int(config.distance_m / VARIATION_M), 1) + 1)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(waves))
    cosines = np.cos(2.0 * np.pi * np.outer(arc / config.distance_m, waves) + phase)
    factor = 1.0 + config.speed_variation * (cosines.sum(axis=1) * np.sqrt(2.0 / len(waves)))
    return SpeedLimits(arc, np.maximum(factor, LEAST_FACTOR), turn, config.acceleration_mps2)


def _cruise(limits: SpeedLimits, moving_s: float, config: VehicleConfig) -> float:
    """Return the cruise speed at which the route takes `moving_s`, by bisection."""
    least_s = float(limits.travel_time(GREATEST_CRUISE_MPS)[-1])
    if moving_s <= least_s:
        raise InputError(
            f"vehicle.duration_s = {config.duration_s:g} is too short for vehicle.distance_m = "
            f"{config.distance_m:g} with {config.stops} stops: moving takes {least_s:.0f} s at least, "
            f"{max(moving_s, 0.0):.0f} s are left besides standing; lengthen the duration, or stop less"
        )
    low, high = 1e-3, GREATEST_CRUISE_MPS
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if limits.travel_time(middle)[-1] > moving_s else (low, middle)
    return high


def _position(at_s: Floats, time_s: Floats, arc_m: Floats, speed_mps: Floats) -> Floats:
    """Return the arc position at times `at_s`, with constant acceleration between the given times."""
    i = np.clip(np.searchsorted(time_s, at_s, side="right") - 1, 0, len(time_s) - 2)
    span = np.maximum(time_s[i + 1] - time_s[i], 1e-12)
    part = np.clip((at_s - time_s[i]) / span, 0.0, 1.0)
    # Constant acceleration within a cell makes a parabola; a standing phase has both ends at rest.
    moved = span * part * (speed_mps[i] + 0.5 * part * (speed_mps[i + 1] - speed_mps[i]))
    return np.where(at_s <= time_s[0], arc_m[0], np.where(at_s >= time_s[-1], arc_m[-1], arc_m[i] + moved))
