"""Compile the kernels by a made-up drive, so that compiling is not timed with an estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cellslam.sim.recording import Links, OdometryModel, Sites, Truth, VirtualTransmitters
from cellslam.slam import attitude, misfit
from cellslam.slam.api import Setup, Snapshot

if TYPE_CHECKING:
    from cellslam.slam.baselines.ekf_slam.filter import JointFilter
    from cellslam.slam.baselines.ekf_slam.options import JointOptions


def warm_up(estimator: type[JointFilter], options: JointOptions) -> None:
    """Run four snapshots, the last two in the joint filter."""
    attitude.warm_up()
    misfit.warm_up()
    sheet = OdometryModel(np.full(6, 0.01), np.full(6, 0.01), np.full(6, 0.001), np.full(6, 0.01))
    links = Links(np.array([0, 1]), np.array([1, 2]), np.array([0, 0]))
    sites = Sites(("A", "B"), np.zeros(2), np.array([150.0, 150.0]))
    one = estimator(options.model_copy(update={"start_limit_s": 0.1}))
    setup = Setup(links, sites, sheet, np.zeros(6), np.zeros(6), _truth() if estimator.requires_truth else None)
    one.start(setup, np.random.default_rng(0))
    values = ([600.0, 605.0, 700.0], [0.1, 1.2, 0.5], [0.1, 0.0, 0.1], [10.0, 10.0, 10.0])
    for t in range(4):
        snapshot = Snapshot(t, np.arange(3), np.array([0, 0, 1]), *(np.array(c) for c in values))
        one.step(0.0 if t == 0 else 0.1, np.array([1.0, 0, 0, 0, 0, 0]), snapshot)


def _truth() -> Truth:
    vts = VirtualTransmitters(
        np.array([[500.0, 50.0, 50.0], [400.0, 200.0, 40.0]]), np.array([0, 1]), np.zeros(2, np.int64),
        np.full((2, 2), -1), np.zeros((2, 3), np.int64),
    )  # fmt: skip
    return Truth(
        poses=np.zeros((4, 6)), measurement_vt=np.array([0, -1, 1]), measurement_std=np.ones((3, 3)), vts=vts,
        site_positions_m=np.zeros((2, 3)), clock_offsets_m=np.zeros(2), odometry_bias=np.zeros((4, 6)),
        odometry_scale=np.zeros(6),
    )  # fmt: skip
