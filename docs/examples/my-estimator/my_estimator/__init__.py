"""Dead reckoning that learns the gyro's bias whenever the wheels stand still."""

import numpy as np
from cellslam.slam.api import Estimate
from cellslam.slam.dead_reckoning import DeadReckoning
from pydantic import BaseModel, ConfigDict, Field


class Options(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    standing_mps: float = Field(0.1, gt=0, description="slower than this, the vehicle stands, m/s")


class ZeroVelocity(DeadReckoning):
    name = "zero-velocity"
    Options = Options

    def __init__(self, options=None):
        self.options = options or Options()

    def start(self, setup, rng):
        super().start(setup, rng)
        self.bias, self.weight = 0.0, 0.0
        self.prior = setup.odometry_model.bias[3] ** 2
        self.noise = setup.odometry_model.noise_density[3] ** 2

    def step(self, dt_s, odometry, snapshot):
        if dt_s > 0 and abs(odometry[0]) < self.options.standing_mps and self.prior > 0:
            self.weight += dt_s
            gain = dt_s / (self.weight + self.noise / self.prior)
            self.bias += gain * (odometry[3] - self.bias)
        return super().step(dt_s, odometry - self.bias * np.eye(6)[3], snapshot)
