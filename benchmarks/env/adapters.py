"""Adapters: an estimator as an agent of `cellslam/Localization-v0`, and an agent as an estimator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from cellslam.benchmarks.env.localization import action_between, action_unit, compose, observation, snapshot_of
from cellslam.benchmarks.env.scenario_env import Observation
from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Estimator, Setup, Snapshot

Policy = Callable[[Observation], Floats]


class EstimatorAgent:
    """Drives an estimator from observations: its poses are those that `cellslam run` gives, bit for bit.

    `poses` holds them; the actions, beyond 1 where need be, are what their increments differ by from the odometry. The
    environment's belief differs by rounding.
    """

    def __init__(self, estimator: Estimator, setup: Setup, rng: np.random.Generator) -> None:
        estimator.start(setup, rng)
        self._estimator, self._belief, self._row = estimator, np.array(setup.start_pose), 0
        self.poses: list[Floats] = []
        self.covariance: Floats | None = None

    def __call__(self, observed: Observation) -> Floats:
        """Return the action for an observation."""
        snapshot = snapshot_of(observed, len(self.poses), self._row)
        self._row += len(snapshot)
        answer = self._estimator.step(float(observed["dt_s"][0]), np.array(observed["odometry"]), snapshot)
        self.poses.append(np.array(answer.pose))
        self.covariance = np.array(answer.covariance)
        action = action_between(self._belief, observed, self.poses[-1])
        self._belief = compose(self._belief, observed, action)
        return action


class AgentEstimator:
    """An agent as an estimator: subclass it, and let `policy()` return a function from observation to action.

    The covariance is what the agent cannot say: a constant, `position_std_m` and `angle_std_rad`.
    """

    name: ClassVar[str] = "agent"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[None] = None
    max_paths: ClassVar[int] = 128
    position_std_m: ClassVar[float] = 1.0
    angle_std_rad: ClassVar[float] = 0.02

    def __init__(self, options: Any = None) -> None:
        self.options = options

    def policy(self) -> Policy:
        """Return the agent: a function from observation to action, new for each drive."""
        raise NotImplementedError("override policy(): let it return a function from observation to action")

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Begin a drive at the start pose."""
        del rng
        self._policy, self._pose, self._action = self.policy(), np.array(setup.start_pose), np.zeros(6)
        self._model = setup.odometry_model

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Show the snapshot and odometry (6,), in m/s and rad/s, to the agent, and add what it says to the odometry."""
        unit = action_unit(self._model, dt_s, odometry)
        shown = observation(snapshot, dt_s, odometry, unit, self._action, self.max_paths)
        self._action = np.array(self._policy(shown), np.float64)
        self._pose = compose(self._pose, shown, self._action)
        covariance = np.diag([self.position_std_m**2] * 3 + [self.angle_std_rad**2] * 3)
        return Estimate(self._pose.copy(), covariance)
