"""What goes wrong with odometry now and then: wheels that slip, seconds without a value, a gyro whose bias steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.vehicle.odometry import FORWARD, YAW, Floats, Odometry
from cellslam.sim.vehicle.vehicle_config import OdometryConfig


def with_faults(odometry: Odometry, time_s: Floats, config: OdometryConfig, rng: np.random.Generator) -> Odometry:
    """Return odometry with the faults of a drive, at snapshots time_s (T,) in s; the same where there are none."""
    velocity, bias, slip = odometry.velocity.copy(), odometry.bias.copy(), None
    slips, dropped = (
        _bursts(time_s, rate, lasts_s, rng)
        for rate, lasts_s in ((config.slips_per_hour, config.slip_s), (config.dropouts_per_hour, config.dropout_s))
    )
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
