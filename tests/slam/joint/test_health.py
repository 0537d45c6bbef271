"""EKF-SLAM stays finite and its covariances positive definite, whatever it is fed, for as long as it is fed.

`CELLSLAM_SNAPSHOTS=100000 pytest tests/slam/joint/test_health.py` drives as far; the suite until all has happened once.
"""

import os

import numpy as np
import pytest

from cellslam.sim.frames import integrate_pose, wrap_angle
from cellslam.sim.recording import Floats, Links, OdometryModel, Sites
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.model.measurement_model import predict

EVERY = 4000  # snapshots, in which everything happens once
SNAPSHOTS = int(os.environ.get("CELLSLAM_SNAPSHOTS", EVERY))
DT, SPEED, TURN = 0.075, 1.0, 0.02
OFFSET = np.array([35.0, -80.0])
OVERHEAD = np.array([60.0, 50.0, 12.0])  # the drive, a circle of 50 m, passes below it
VTS = [
    np.array([[200.0, 30.0, 40.0], [-150.0, 90.0, 30.0], [30.0, -220.0, 25.0], [30.0, 260.0, 35.0], OVERHEAD]),
    np.array([[-180.0, -120.0, 40.0], [250.0, 180.0, 30.0], [90.0, -140.0, 20.0], [10.0, 50.0, 1.9]]),
]


def setup() -> Setup:
    zero = np.zeros(6)
    noise = np.array([0.01, 0, 0, np.radians(0.1), 0, 0])
    bias, scale = np.array([0, 0, 0, np.radians(0.05), 0, 0]), np.array([0.01, 0, 0, 0, 0, 0])
    return Setup(
        links=Links(np.array([0, 1]), np.array([1, 2]), np.array([0, 0])),
        sites=Sites(("A", "B"), np.zeros(2), np.full(2, 150.0)),
        odometry_model=OdometryModel(noise, bias, zero, scale), start_pose=np.array([0, 0, 1.8, 0, 0, 0]),
        start_std=zero,
    )  # fmt: skip


def seen(t: int, pose: Floats, rng: np.random.Generator) -> Snapshot:
    """What is measured at snapshot t: noise and clutter, and by turns one trouble after the other."""
    phase, columns = t % EVERY, []
    for link, vts in enumerate(VTS):
        z = predict(pose, vts)
        z[:, 0] += OFFSET[link]
        z = z[rng.random(len(z)) < 0.9]
        if phase == 300 and link == 0:
            z = np.concatenate([z, np.column_stack([rng.uniform(1, 1500, 200), *rng.uniform(-1, 1, (2, 200))])])
        z += rng.standard_normal(z.shape) * np.radians([40.0, 0.8, 0.8])
        snr = np.full(len(z), 15.0)
        if rng.random() < 0.3:
            z, snr = np.append(z, [[rng.uniform(20, 600), *rng.uniform(-1, 1, 2)]], axis=0), np.append(snr, 0.0)
        if 400 <= phase < 500:
            snr[:] = -40.0
        if 500 <= phase < 600:
            snr[:] = 60.0
        if 600 <= phase < 620:
            z[:, 1] = np.where(rng.random(len(z)) < 0.5, np.pi, -np.pi)
        if 700 <= phase < 720:
            z, snr = np.repeat(z, 2, axis=0), np.repeat(snr, 2)
        if phase == 800:
            z[:, 0] = OFFSET[link]
        if phase == 801:
            z[:, 0] = 0.0
        if phase == 802:
            z[:, 2] = np.pi / 2
        if 1000 <= phase < 3000:  # two and a half minutes of silence
            z, snr = z[:0], snr[:0]
        columns.append(np.column_stack([np.full(len(z), link), z, snr]))
    rows = np.concatenate(columns)
    rows[:, 2] = wrap_angle(rows[:, 2])
    return Snapshot(t, np.arange(len(rows)), rows[:, 0].astype(np.int64), *rows[:, 1:].T.copy())


def healthy(t: int, estimate: Estimate) -> None:
    told = (estimate.pose, estimate.covariance, estimate.clock_offset_m, estimate.clock_offset_variance_m2)
    assert all(np.isfinite(array).all() for array in told), t
    known = np.ix_([0, 1, 3], [0, 1, 3])
    assert np.linalg.eigvalsh(estimate.covariance[known]).min() > (-1e-12 if t < 10 else 0.0), t
    assert estimate.clock_offset_variance_m2.min() > 0.0, t
    assert np.isfinite(estimate.vts.position_m).all() and np.isfinite(estimate.vts.covariance).all(), t
    if len(estimate.vts.id):
        assert np.linalg.eigvalsh(estimate.vts.covariance).min() > 0.0, t


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_stays_healthy_whatever_happens() -> None:
    rng, estimator = np.random.default_rng(3), EkfSlam()
    given = setup()
    estimator.start(given, np.random.default_rng(0))
    pose, velocity = given.start_pose.copy(), np.array([SPEED, 0, 0, TURN, 0, 0])
    worst = 0.0
    for t in range(SNAPSHOTS):
        dt = DT if t else 0.0
        pose = integrate_pose(pose, velocity, dt)
        odometry = velocity + np.array([0.002, 0, 0, 2e-4, 0, 0])
        estimate = estimator.step(dt, odometry, seen(t, pose, rng))
        if t % 50 == 0 or t % EVERY in (301, 401, 501, 601, 701, 801, 802, 803):
            healthy(t, estimate)
            worst = max(worst, float(np.hypot(*(estimate.pose - pose)[:2])))
    assert worst < 20.0
