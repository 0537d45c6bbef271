"""Pitch, roll and heave of the body: suspension under acceleration, and an uneven road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.vehicle.vehicle_config import VehicleConfig

Floats = NDArray[np.float64]

WAVES = 32


@dataclass(frozen=True)
class Road:
    """A random road: height and roll as functions of the arc length, smooth, with a Gaussian correlation.

    Sums of `WAVES` cosines: `wavenumber` (2, W), `phase` (2, W) of height and roll. Both fade in over the
    first correlation lengths, so that a drive starts on level ground.
    """

    wavenumber: Floats
    phase: Floats
    height_std_m: float
    roll_std_rad: float
    correlation_m: float

    def height_m(self, arc_m: Floats) -> Floats:
        """Return the height (n,) at arc lengths (n,), both in m."""
        return self.height_std_m * self._wave(0, arc_m)

    def roll_rad(self, arc_m: Floats) -> Floats:
        """Return the roll (n,) in rad at arc lengths (n,) in m."""
        return self.roll_std_rad * self._wave(1, arc_m)

    def _wave(self, which: int, arc_m: Floats) -> Floats:
        total: Floats = np.zeros_like(arc_m)
        for k, phase in zip(self.wavenumber[which], self.phase[which], strict=True):
            total += np.cos(k * arc_m + phase)
        fade = -np.expm1(-0.5 * (arc_m / self.correlation_m) ** 2)
        return np.asarray(total * fade * np.sqrt(2.0 / WAVES))


def random_road(config: VehicleConfig, rng: np.random.Generator) -> Road:
    """Return a road with the unevenness of `config`; correlation exp(-(s / correlation)^2 / 2)."""
    wavenumber = rng.normal(0.0, 1.0 / config.road_correlation_m, (2, WAVES))
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, WAVES))
    roll_std_rad = float(np.radians(config.road_roll_std_deg))
    return Road(wavenumber, phase, config.road_height_std_m, roll_std_rad, config.road_correlation_m)


def body_motion(
    arc_m: Floats, speed_mps: Floats, turn_rate_radps: Floats, step_s: float, road: Road, config: VehicleConfig
) -> Floats:
    """Return height above the start's ground in m, pitch and roll in rad, (N, 3), at equidistant times.

    Braking puts the nose down (positive pitch), a left turn leans the body outward (positive roll); the
    pitch follows the road under the wheels. The attitude turns about the array's phase centre.
    """
    grade = config.road_slope_percent / 100.0
    height = road.height_m(arc_m) + grade * arc_m
    ahead = road.height_m(arc_m + config.wheelbase_m)
    # The unevenness fades in after the start, where the road under both axles counts as level.
    slope = grade + (ahead - road.height_m(arc_m)) / config.wheelbase_m * -np.expm1(
        -0.5 * (arc_m / road.correlation_m) ** 2
    )
    acceleration = np.gradient(speed_mps, step_s)
    pitch = -np.arctan(slope) - np.radians(config.pitch_gradient_deg_per_mps2) * acceleration
    lateral = speed_mps * turn_rate_radps
    roll = road.roll_rad(arc_m) + np.radians(config.roll_gradient_deg_per_mps2) * lateral
    return np.column_stack([height, pitch, roll])
