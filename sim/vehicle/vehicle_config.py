"""Settings of the vehicle, its route and its odometry (tables [vehicle] and [odometry] of a scenario)."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

Point = tuple[float, float]


class VehicleConfig(BaseModel):
    """Where and how the vehicle drives. The array sits above the rear axle: no lateral body velocity."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    route: Literal["trial"] | int = Field(
        "trial", description="seed of the route on the city's streets, or 'trial': another route each trial"
    )
    waypoints_m: tuple[Point, ...] | None = Field(
        None, min_length=2, description="corners [x, y] of the route in metres; replaces the planned route"
    )
    distance_m: float = Field(530.0, gt=0.0, le=20_000.0, description="distance driven")
    duration_s: float = Field(513.75, gt=0.0, le=20_000.0, description="duration of the drive, standing included")
    snapshot_interval_s: float = Field(0.075, ge=0.005, le=1.0, description="time between snapshots")
    array_height_m: float = Field(1.8, ge=0.5, le=5.0, description="height of the array's phase centre above ground")
    wheelbase_m: float = Field(2.9, ge=1.5, le=3.2, description="distance between the axles")
    corner_radius_m: float = Field(8.0, ge=5.0, le=50.0, description="radius of the arcs that round the corners")
    clearance_m: float = Field(1.2, ge=0.5, le=5.0, description="least distance of the route from walls")
    stops: int = Field(4, ge=0, le=50, description="standing phases on the route")
    stop_s: float = Field(8.0, ge=0.0, le=120.0, description="mean length of a standing phase")
    stand_first_s: float = Field(3.0, ge=0.0, le=120.0, description="standing time before the start")
    acceleration_mps2: float = Field(0.6, ge=0.05, le=4.0, description="acceleration and braking")
    lateral_acceleration_mps2: float = Field(0.5, ge=0.05, le=4.0, description="greatest lateral acceleration in turns")
    speed_variation: float = Field(
        0.15, ge=0.0, le=0.5, description="slow relative variation of the speed, standard deviation"
    )
    pitch_gradient_deg_per_mps2: float = Field(0.25, ge=0.0, le=3.0, description="pitch (nose down) per braking")
    roll_gradient_deg_per_mps2: float = Field(0.45, ge=0.0, le=3.0, description="outward roll per lateral acceleration")
    road_height_std_m: float = Field(
        0.01, ge=0.0, le=0.1, description="road unevenness, standard deviation of its height"
    )
    road_roll_std_deg: float = Field(0.3, ge=0.0, le=3.0, description="road unevenness, standard deviation of its roll")
    road_correlation_m: float = Field(5.0, ge=2.0, le=200.0, description="correlation length of the road unevenness")
    road_slope_percent: float = Field(0.0, ge=0.0, le=10.0, description="constant uphill slope along the route")

    start_std_m: float = Field(
        0.0,
        ge=0.0,
        le=100.0,
        description="horizontal error of the start position given to the estimator, standard deviation",
    )
    start_std_deg: float = Field(
        0.0, ge=0.0, le=180.0, description="heading error of the start pose given to the estimator, standard deviation"
    )

    @property
    def start_std(self) -> tuple[float, float, float, float, float, float]:
        """Standard deviations (6,) of the start pose (m, rad); height, pitch and roll are known."""
        return self.start_std_m, self.start_std_m, 0.0, math.radians(self.start_std_deg), 0.0, 0.0

    @property
    def snapshots(self) -> int:
        """Number of snapshots T: the drive is T intervals long, and the last one interval before the end."""
        return max(round(self.duration_s / self.snapshot_interval_s), 1)


class OdometryConfig(BaseModel):
    """The odometry's data sheet, standard deviations of what a trial draws; and what goes wrong, which it does not say.

    Defaults: automotive MEMS gyro after a zero-velocity calibration, wheel speed sensors.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    wheel_scale: float = Field(0.01, ge=0.0, le=0.2, description="scale error of the wheel speed, standard deviation")
    wheel_noise_m_per_sqrt_s: float = Field(
        0.0073, ge=0.0, le=1.0, description="white noise of the wheel distance (0.0073: 2 mm in 75 ms)"
    )
    gyro_noise_deg_per_sqrt_s: float = Field(0.015, ge=0.0, le=1.0, description="angle random walk of the gyro")
    gyro_bias_deg_per_s: float = Field(
        0.024, ge=0.0, le=1.0, description="constant bias of the gyro, standard deviation"
    )
    gyro_bias_walk_deg_per_s_sqrt_s: float = Field(
        0.0001, ge=0.0, le=0.1, description="random walk of the gyro bias, in deg/s per square root of a second"
    )
    slips_per_hour: float = Field(0.0, ge=0.0, le=3600.0, description="bursts in which the wheels slip")
    slip_s: float = Field(2.0, gt=0.0, le=60.0, description="length of such a burst")
    slip_factor: float = Field(1.5, ge=0.0, le=10.0, description="factor on the measured speed in it (0: locked)")
    dropouts_per_hour: float = Field(0.0, ge=0.0, le=3600.0, description="gaps in which nothing is measured")
    dropout_s: float = Field(3.0, gt=0.0, le=60.0, description="length of such a gap")
    gyro_step_deg_per_s: float = Field(
        0.0, ge=0.0, le=1.0, description="standard deviation of the one step of the gyro's bias (0: none)"
    )
    gyro_step_s: float | None = Field(
        None, ge=0.0, le=20_000.0, description="time of that step after the start; absent: any time of the drive"
    )
