"""Four made-up snapshots: estimators compile their kernels by them, so that compiling is not timed with an estimate."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.recording import Links, Measurements, OdometryModel, Recording, Sites, Truth, VirtualTransmitters
from cellslam.slam.api import Setup, setup_of, steps_of

SNAPSHOTS = 4
_PATHS = ([600.0, 605.0, 700.0], [0.1, 1.2, 0.5], [0.1, 0.0, 0.1], [10.0, 10.0, 10.0])


def drive(estimator: Any) -> Setup:
    """Start an estimator, let it take four snapshots of two links, and return its setup.

    All is as a recording gives it: compiled code is for the types of arrays, whether they can be written included.
    """
    recording = made_up()
    setup = setup_of(recording, estimator.requires_truth)
    estimator.start(setup, np.random.default_rng(0))
    for step in steps_of(recording):
        estimator.step(*step)
    return setup


def made_up() -> Recording:
    """Return a drive past two sites with a link each, whose clock offsets are unknown."""
    sheet = OdometryModel(np.full(6, 0.01), np.full(6, 0.01), np.full(6, 0.001), np.full(6, 0.01))
    links = Links(np.array([0, 1]), np.array([1, 2]), np.array([0, 0]))
    sites = Sites(("A", "B"), np.zeros(2), np.full(2, 150.0), clock_step_std_m=np.full(2, 10.0))
    snapshot = np.repeat(np.arange(SNAPSHOTS), 3)
    columns = (np.tile(column, SNAPSHOTS) for column in ([0, 0, 1], *_PATHS))
    time_s, odometry = np.linspace(0.0, 0.1 * (SNAPSHOTS - 1), SNAPSHOTS), np.zeros((SNAPSHOTS, 6))
    odometry[:, 0] = 1.0
    return Recording(
        time_s, odometry, sheet, links, sites, Measurements(snapshot, *columns), np.zeros(6), np.zeros(6), {}, _truth()
    )  # fmt: skip


def _truth() -> Truth:
    vts = VirtualTransmitters(
        np.array([[500.0, 50.0, 50.0], [400.0, 200.0, 40.0]]), np.array([0, 1]), np.zeros(2, np.int64),
        np.full((2, 2), -1), np.array([[0, 0, SNAPSHOTS - 1], [1, 0, SNAPSHOTS - 1]]),
    )  # fmt: skip
    return Truth(
        poses=np.zeros((SNAPSHOTS, 6)), measurement_vt=np.tile([0, -1, 1], SNAPSHOTS),
        measurement_std=np.ones((3 * SNAPSHOTS, 3)), vts=vts,
        site_positions_m=np.zeros((2, 3)), clock_offsets_m=np.zeros(2), odometry_bias=np.zeros((SNAPSHOTS, 6)),
        odometry_scale=np.zeros(6),
    )  # fmt: skip
