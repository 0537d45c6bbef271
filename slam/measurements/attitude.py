"""Pitch and roll of a vehicle whose odometry does not see them: followed from one snapshot to the next.

Acceleration, turns and the road tilt the array by tenths of a degree for seconds. Twenty directions at once, most of
landmarks that are well known, tell by how much; what the next snapshot measures is then turned into the level frame.
The attitude is a first-order Gauss-Markov process; an error that all directions have in common is left out.

Source: Gelb, "Applied optimal estimation", 1974, chapters 3 (Gauss-Markov process) and 4 (Kalman filter).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.measurements.attitude_kernel import level, observe
from cellslam.slam.measurements.measurement_options import MeasurementOptions

Seen = TypeVar("Seen", bound=Snapshot)


class Attitude:
    """Belief on pitch and roll: `mean` (2,) in rad, `covariance` (2, 2)."""

    def __init__(self, options: MeasurementOptions, setup: Setup) -> None:
        """Begin level. What the odometry or the start says of pitch and roll belongs to the pose: then this is off."""
        model = setup.odometry_model
        seen = np.concatenate([model.noise_density[4:], model.bias[4:], setup.start_std[4:], setup.start_pose[4:]])
        self.prior = np.radians([options.pitch_deg, options.roll_deg]) ** 2
        self.on = bool((self.prior > 0.0).all()) and not seen.any()
        self.options, self.mean, self.covariance = options, np.zeros(2), np.diag(self.prior)

    def levelled(self, dt_s: float, snapshot: Seen) -> Seen:
        """Return a snapshot's measurements as a level array would have made them, `dt_s` after the last ones."""
        if not self.on:
            return snapshot
        left = math.exp(-dt_s / self.options.attitude_scale_s)
        azimuth, elevation = level(
            self.mean, self.covariance, self.prior, left, snapshot.azimuth_rad, snapshot.elevation_rad
        )
        return replace(snapshot, azimuth_rad=azimuth, elevation_rad=elevation)

    def concluded(self, answer: Estimate, snapshot: Snapshot, variance: Floats, pose: Floats | None = None) -> Estimate:
        """Learn from a snapshot's measurements as they were made, and return the answer to them with pitch and roll.

        `variance` (m, 3): those with which an update counts for what it is worth. `pose` (6,): from where the answer's
        VTs were seen, where that is not its pose.
        """
        if not self.on:
            return answer
        if len(snapshot) and answer.association is not None and answer.vts is not None and len(answer.vts.id):
            vts, place = answer.vts, self.options.persisting[0]
            observe(
                self.mean, self.covariance, answer.pose if pose is None else pose, answer.association, vts.id,
                vts.position_m, vts.covariance, snapshot.azimuth_rad, snapshot.elevation_rad, variance, place,
            )  # fmt: skip
        mean, covariance = answer.pose.copy(), answer.covariance.copy()
        mean[4:], covariance[4:, 4:] = self.mean, self.covariance
        return replace(answer, pose=mean, covariance=covariance)


def warm_up() -> None:
    """Compile the kernels, or load them from their cache."""
    one = np.zeros(1)
    level(np.zeros(2), np.eye(2), np.ones(2), 1.0, one, one)
    names = np.zeros(1, np.int64)
    observe(
        np.zeros(2), np.eye(2), np.zeros(6), names, names, np.ones((1, 3)), np.zeros((1, 3, 3)), one, one,
        np.ones((1, 3)), np.ones(3),
    )  # fmt: skip
