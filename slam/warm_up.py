"""Four made-up snapshots: estimators compile their kernels by them, so that compiling is not timed with an estimate."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.recording import Links, OdometryModel, Sites, Truth, VirtualTransmitters
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.front_end import attitude, misfit

SNAPSHOTS = 4
_PATHS = ([600.0, 605.0, 700.0], [0.1, 1.2, 0.5], [0.1, 0.0, 0.1], [10.0, 10.0, 10.0])


def drive(estimator: Any) -> Setup:
    """Start an estimator, let it take four snapshots of two links, and return its setup."""
    attitude.warm_up()
    misfit.warm_up()
    setup = made_up_setup(estimator.requires_truth)
    estimator.start(setup, np.random.default_rng(0))
    for t in range(SNAPSHOTS):
        link = np.array([0, 0, 1])
        link.setflags(write=False)  # as in a drive: compiled code is typed by that
        snapshot = Snapshot(t, 3 * t + np.arange(3), link, *(np.array(c) for c in _PATHS))
        estimator.step(0.0 if t == 0 else 0.1, np.array([1.0, 0, 0, 0, 0, 0]), snapshot)
    return setup


def made_up_setup(with_truth: bool = False) -> Setup:
    """Return two sites with a link each, whose clock offsets are unknown."""
    sheet = OdometryModel(np.full(6, 0.01), np.full(6, 0.01), np.full(6, 0.001), np.full(6, 0.01))
    links = Links(np.array([0, 1]), np.array([1, 2]), np.array([0, 0]))
    sites = Sites(("A", "B"), np.zeros(2), np.array([150.0, 150.0]))
    return Setup(links, sites, sheet, np.zeros(6), np.zeros(6), _truth() if with_truth else None)


def _truth() -> Truth:
    vts = VirtualTransmitters(
        np.array([[500.0, 50.0, 50.0], [400.0, 200.0, 40.0]]), np.array([0, 1]), np.zeros(2, np.int64),
        np.full((2, 2), -1), np.zeros((2, 3), np.int64),
    )  # fmt: skip
    return Truth(
        poses=np.zeros((SNAPSHOTS, 6)), measurement_vt=np.tile([0, -1, 1], SNAPSHOTS),
        measurement_std=np.ones((3 * SNAPSHOTS, 3)), vts=vts,
        site_positions_m=np.zeros((2, 3)), clock_offsets_m=np.zeros(2), odometry_bias=np.zeros((SNAPSHOTS, 6)),
        odometry_scale=np.zeros(6),
    )  # fmt: skip
