"""What wheels and gyro measure of a drive: mean body velocities, with the data sheet's errors; and what goes wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import Described
from cellslam.sim.frames import mean_velocity
from cellslam.sim.recording import Floats, OdometryModel
from cellslam.sim.vehicle.drive import Drive
from cellslam.sim.vehicle.vehicle_config import OdometryConfig

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
    velocity, seen = np.zeros((count + 1, 6)), [FORWARD, YAW]
    velocity[1:, seen] = ((1.0 + scale) * true + bias[1:] + white)[:, seen]
    return Odometry(velocity, model, bias, scale)


def with_faults(odometry: Odometry, time_s: Floats, config: OdometryConfig, rng: np.random.Generator) -> Odometry:
    """Return odometry with the faults of a drive, at snapshots time_s (T,) in s: wheels that slip, seconds without a
    value, a gyro whose bias steps.
    """
    velocity, bias, slip = odometry.velocity.copy(), odometry.bias.copy(), None
    slips = _bursts(time_s, config.slips_per_hour, config.slip_s, rng)
    dropped = _bursts(time_s, config.dropouts_per_hour, config.dropout_s, rng)
    if config.slips_per_hour > 0.0:
        slip = np.where(slips, config.slip_factor, 1.0)
        velocity[:, FORWARD] *= slip
    if config.gyro_step_deg_per_s > 0.0:
        size, at = np.radians(config.gyro_step_deg_per_s) * rng.standard_normal(), rng.uniform(time_s[0], time_s[-1])
        step = np.where(time_s >= (at if config.gyro_step_s is None else time_s[0] + config.gyro_step_s), size, 0.0)
        velocity[1:, YAW] += step[1:]
        bias[:, YAW] += step
    velocity[dropped, FORWARD] = np.nan
    velocity[dropped, YAW] = np.nan
    return replace(odometry, velocity=velocity, bias=bias, slip=slip)


def _bursts(time_s: Floats, per_hour: float, lasts_s: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which intervals (T,) bursts that begin at random fall in; the first row is before the drive."""
    duration_s = time_s[-1] - time_s[0]
    begin = time_s[0] + rng.uniform(0.0, duration_s, rng.poisson(per_hour * duration_s / 3600.0))
    within = ((time_s[:, None] > begin) & (time_s[:, None] <= begin + lasts_s)).any(axis=1)
    within[0] = False
    return np.asarray(within)
