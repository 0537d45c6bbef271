"""Dead reckoning: the odometry integrated from the start pose, with the covariance that its data sheet implies.

State
    pose (6), and those biases b and scale errors s of the odometry that its data sheet has, with their covariance P:
    the joint EKF (`joint/ekf_slam.py`) without clocks and virtual transmitters
Recursion, for odometry u over dt with white noise of density q
    predict     pose <- pose + (u - b) / (1 + s) dt in the frame of the middle heading
                P <- F P F^T + Q,  Q = B diag(q^2 / dt) B^T             `move` of joint/snapshot/motion_kernel.py
No measurement is used: there is no update, b and s stay at zero, and there is no weight.

Source: the extended FastSLAM paper, section V (proprioception only), with the velocities of eq. 14.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Links, OdometryModel, Sites
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.joint.new_filters import NO_ERRORS, core_of, new_mixture
from cellslam.slam.joint.snapshot.motion_kernel import Interval, Step, move
from cellslam.slam.joint.state.layout import one_of


class DeadReckoning:
    """Integrates mean body velocities (eq. 14) and their covariance; takes no options; see the module."""

    name: ClassVar[str] = "dead-reckoning"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[None] = None

    def __init__(self, options: None = None) -> None:
        del options

    def warm_up(self) -> None:
        """Compile the motion, or load it from its cache."""
        none = np.zeros(6)
        links, sites = Links(*np.zeros((3, 1), np.int64)), Sites(("A",), np.zeros(1), np.zeros(1))
        other = DeadReckoning()
        other.start(Setup(links, sites, OdometryModel(none, none, none, none), none, none), np.random.default_rng(0))
        other.step(0.1, none, Snapshot(0, *np.zeros((2, 0), np.int64), *np.zeros((4, 0))))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the start pose; nothing is drawn."""
        del rng
        self._model = setup.odometry_model
        none = replace(setup, sites=Sites((), np.zeros(0), np.zeros(0)), links=Links(*np.zeros((3, 0), np.int64)))
        mixture = new_mixture(none, core_of(none, NO_ERRORS), NO_ERRORS, np.zeros((1, 0)), np.zeros(0))
        self._filter, size = one_of(mixture.arrays, 0), mixture.core.size
        self._buffers = Step(np.empty((6, size + 6)), np.empty((6, mixture.arrays.x.shape[1])))

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Integrate one interval; the measurements are not used.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        if dt_s > 0.0:
            noise, walk = np.array(self._model.noise_density, float), np.array(self._model.bias_walk_density, float)
            move(self._filter, Interval(float(dt_s), np.array(odometry, float), noise, walk), self._buffers)
        pose = self._filter.x[:6].copy()
        pose[3:] = wrap_angle(pose[3:])
        return Estimate(pose, self._filter.p[:6, :6].copy())
