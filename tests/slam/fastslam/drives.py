"""Drives of FastSLAM's tests: a straight street with known clock offsets, four virtual transmitters far away."""

from __future__ import annotations

import numpy as np

from cellslam.sim.frames import integrate_pose
from cellslam.sim.recording import Floats, Links, OdometryModel, Sites
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.joint.ekf_slam import JointFilter
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS
from cellslam.slam.model.measurement_model import predict

Drive = tuple[Setup, list[tuple[float, Floats, Snapshot]]]
STEP_S, NOISE = 0.1, np.array([0.5, 0.002, 0.002])  # m, rad, rad
VTS = np.array([[900.0, 150.0, 60.0], [-800.0, 500.0, 50.0], [250.0, -900.0, 60.0], [-600.0, -700.0, 40.0]])
# Options of a filter that knows how large the errors are: white ones alone, as each measurement claims.
WHITE = NOTHING_PERSISTS | {
    "noise_model": "claimed",
    "merge_rate": 0.0,
    "sharing": "none",
    "pitch_deg": 0.0,
    "roll_deg": 0.0,
}
SHORT = WHITE | {"lag": 5}  # drives of a few seconds end before the default lag has passed


def street(snapshots: int, seed: int, noise: Floats | None = None) -> Drive:
    """Return setup and steps of a drive along a street at 1 m/s; `noise` (6,): densities of the odometry's white noise,
    0.05 m/sqrt(s) of the speed and 0.001 rad/sqrt(s) of the yaw rate if none are given."""
    rng = np.random.default_rng(seed)
    density = np.array([0.05, 0.0, 0.0, 0.001, 0.0, 0.0]) if noise is None else noise
    setup = Setup(
        Links(np.zeros(1, np.int64), np.zeros(1, np.int64), np.zeros(1, np.int64)),
        Sites(("A",), np.zeros(1), np.zeros(1)),
        OdometryModel(density, np.zeros(6), np.zeros(6), np.zeros(6)), np.zeros(6), np.zeros(6),
    )  # fmt: skip
    pose, steps = np.zeros(6), []
    speed = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for t in range(snapshots):
        if t:
            pose = integrate_pose(pose, speed, STEP_S)
        z = predict(np.tile(pose, (len(VTS), 1)), VTS) + NOISE * rng.standard_normal((len(VTS), 3))
        given = speed + density / np.sqrt(STEP_S) * rng.standard_normal(6)
        number = np.arange(len(VTS))
        std = np.tile(NOISE, (len(VTS), 1)).T
        snapshot = Snapshot(t, number, np.zeros(len(VTS), np.int64), *z.T, np.full(len(VTS), 20.0), *std)
        steps.append((STEP_S if t else 0.0, given, snapshot))
    return setup, steps


def driven(estimator: JointFilter, drive: Drive, seed: int = 0) -> list[Estimate]:
    """Return the answers of a filter to all snapshots of a drive."""
    setup, steps = drive
    estimator.start(setup, np.random.default_rng(seed))
    return [estimator.step(*step) for step in steps]
