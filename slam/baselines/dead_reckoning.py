"""Dead reckoning: the odometry integrated from the start pose, with the covariance that its data sheet implies."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from cellslam.sim.frames import integrate_pose, rotation
from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Setup, Snapshot


class DeadReckoning:
    """Integrates mean body velocities (paper, section V: proprioception only); takes no options.

    The covariance is that of a linearised filter over pose (6), odometry biases (6) and scales (6).
    """

    name: ClassVar[str] = "dead-reckoning"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[None] = None

    def __init__(self, options: None = None) -> None:
        del options

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the start pose; nothing is drawn."""
        del rng
        model = setup.odometry_model
        self._model = model
        self._pose = setup.start_pose.copy()
        self._covariance = np.diag(np.concatenate([setup.start_std**2, model.bias**2, model.scale**2]))

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Integrate one interval; the measurements are not used."""
        if dt_s > 0.0:
            self._propagate(dt_s, odometry)
            self._pose = integrate_pose(self._pose, odometry, dt_s)
        return Estimate(self._pose.copy(), self._covariance[:6, :6].copy())

    def _propagate(self, dt_s: float, odometry: Floats) -> None:
        """Advance the joint covariance (18, 18): P = F P F^T + noise."""
        by_pose, by_velocity = _derivatives(self._pose, odometry, dt_s)
        step = np.eye(18)
        step[:6, :6] = by_pose
        step[:6, 6:12] = -by_velocity
        step[:6, 12:] = -by_velocity * odometry
        p = step @ self._covariance @ step.T
        p[:6, :6] += (by_velocity * (self._model.noise_density**2 / dt_s)) @ by_velocity.T
        walk = np.arange(6, 12)
        p[walk, walk] += self._model.bias_walk_density**2 * dt_s
        self._covariance = 0.5 * (p + p.T)


def _derivatives(pose: Floats, velocity: Floats, dt_s: float) -> tuple[Floats, Floats]:
    """Return d(next pose)/d(pose) and d(next pose)/d(velocity), each (6, 6), for small turns within an interval."""
    r = rotation(*pose[3:])
    by_pose, by_velocity = np.eye(6), np.zeros((6, 6))
    moved = velocity[:3] * dt_s
    small = 1e-6
    for i in range(3):
        turned = pose[3:].copy()
        turned[i] += small
        by_pose[:3, 3 + i] = (rotation(*turned) - r) @ moved / small
    by_velocity[:3, :3] = r * dt_s
    by_velocity[:3, 3:] = 0.5 * dt_s * by_pose[:3, 3:]
    by_velocity[3:, 3:] = np.eye(3) * dt_s
    return by_pose, by_velocity
