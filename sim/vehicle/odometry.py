"""What wheels and gyro measure of a drive: mean body velocities, with the data sheet's errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import Described
from cellslam.sim.frames import mean_velocity
from cellslam.sim.recording import OdometryModel
from cellslam.sim.vehicle.drive import Drive
from cellslam.sim.vehicle.vehicle_config import OdometryConfig

Floats = NDArray[np.float64]

FORWARD, YAW = 0, 3


@dataclass(frozen=True, repr=False)
class Odometry(Described):
    """Measured `velocity` (T, 6): row t is the mean from time t - 1 to t, row 0 is zero.

    `model`: the data sheet; the errors drawn from it: `bias` (T, 6), the walk included, and `scale` (6,); `slip` (T,):
    factor on the measured speed (None: wheels never slip). NaN: nothing was measured.
    """

    velocity: Floats
    model: OdometryModel
    bias: Floats
    scale: Floats
    slip: Floats | None = None


def odometry_model(config: OdometryConfig) -> OdometryModel:
    """Return the data sheet as standard deviations (6,) per component; zero where nothing is measured."""
    noise, bias, walk, scale = np.zeros((4, 6))
    noise[FORWARD], noise[YAW] = config.wheel_noise_m_per_sqrt_s, np.radians(config.gyro_noise_deg_per_sqrt_s)
    bias[YAW] = np.radians(config.gyro_bias_deg_per_s)
    walk[YAW] = np.radians(config.gyro_bias_walk_deg_per_s_sqrt_s)
    scale[FORWARD] = config.wheel_scale
    return OdometryModel(noise, bias, walk, scale)


def measure_odometry(drive: Drive, config: OdometryConfig, rng: np.random.Generator) -> Odometry:
    """Return forward speed and yaw rate as measured: (1 + scale) u + bias + walk + white noise.

    u is the exact inverse of `frames.integrate_pose`. The other components are taken for zero, as in the
    paper (section V): the small vertical, lateral, pitch and roll motions of the true drive are not seen.
    """
    model = odometry_model(config)
    dt_s = np.diff(drive.time_s)
    count = len(dt_s)
    scale = model.scale * rng.standard_normal(6)
    constant = model.bias * rng.standard_normal(6)
    walk = np.cumsum(rng.standard_normal((count, 6)) * np.sqrt(dt_s)[:, None], axis=0) * model.bias_walk_density
    bias = constant + np.concatenate([np.zeros((1, 6)), walk])
    white = rng.standard_normal((count, 6)) * model.noise_density / np.sqrt(dt_s)[:, None]
    true = mean_velocity(drive.poses[:-1], drive.poses[1:], dt_s)
    velocity = np.zeros((count + 1, 6))
    measured = (1.0 + scale) * true + bias[1:] + white
    for component in (FORWARD, YAW):
        velocity[1:, component] = measured[:, component]
    return Odometry(velocity, model, bias, scale)
