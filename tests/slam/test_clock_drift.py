"""Clocks whose offset changes at a constant unknown rate: simulated, and followed by the filters."""

from typing import Any

import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, integrate_pose
from cellslam.sim.recording import Floats, Links, OdometryModel, Recording, Sites
from cellslam.sim.world import simulate
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS
from cellslam.slam.model.measurement_model import jacobians, predict

DRIFT = 1e-9


def test_distances_drift_and_nothing_else_changes(tiny: Recording) -> None:
    drifting, constant = simulate(load("tiny", {"radio.clock_drift": DRIFT}).world, 3, 0), tiny
    assert constant.truth is not None and drifting.truth is not None and drifting.truth.clock_drift_m_s is not None
    m, rate = drifting.measurements, drifting.truth.clock_drift_m_s
    assert np.allclose(drifting.sites.drift_std_m_s, SPEED_OF_LIGHT_MPS * DRIFT) and np.abs(rate).max() < 4 * 0.3
    grown = m.distance_m - constant.measurements.distance_m
    site = drifting.links.site[m.link]
    np.testing.assert_allclose(grown, rate[site] * drifting.elapsed_s[m.snapshot], atol=1e-9)
    np.testing.assert_array_equal(m.azimuth_rad, constant.measurements.azimuth_rad)
    np.testing.assert_array_equal(drifting.truth.poses, constant.truth.poses)
    offsets = drifting.truth.clock_offsets_at(drifting.elapsed_s)
    np.testing.assert_allclose(offsets[-1] - constant.truth.clock_offsets_m, rate * drifting.elapsed_s[-1])
    assert constant.sites.clock_drift_std_m_s is None and constant.truth.clock_drift_m_s is None


VTS = np.array([[60.0, 45.0, 20.0], [-40.0, 70.0, 15.0], [30.0, -80.0, 25.0], [120.0, 10.0, 12.0]])
STD = np.array([0.1, np.radians(0.05), np.radians(0.05)])
PRIOR_M, PRIOR_M_S, DT, STEPS = 5.0, 0.05, 0.1, 300
OFFSET_M, RATE_M_S = 3.0, -0.04
QUIET: dict[str, Any] = {
    **NOTHING_PERSISTS, "noise_unit_snr_m": 0.0,
    "noise_unit_snr_azimuth_deg": 0.0, "noise_unit_snr_elevation_deg": 0.0, "noise_floor_m": STD[0],
    "noise_floor_azimuth_deg": 0.05, "noise_floor_elevation_deg": 0.05, "pitch_deg": 0.0, "roll_deg": 0.0,
    "misfit_scale_s": 0.0,
}  # fmt: skip


def drive() -> tuple[list[Snapshot], Floats]:
    """A circle that is known exactly, with one VT hidden for a while and another from then on."""
    rng, pose, poses, snapshots = np.random.default_rng(8), np.zeros(6), [], []
    for t in range(STEPS):
        pose = integrate_pose(pose, np.array([1.0, 0, 0, 0.05, 0, 0]), DT if t else 0.0)
        z = predict(pose, VTS) + STD * rng.standard_normal((4, 3))
        z[:, 0] += OFFSET_M + RATE_M_S * t * DT
        seen = np.flatnonzero([True, not 60 <= t < 200, t < 150, True])
        link, snr = np.zeros(len(seen), np.int64), np.full(len(seen), 20.0)
        snapshots.append(Snapshot(t, seen, link, *z[seen].T.copy(), snr))
        poses.append(pose)
    return snapshots, np.array(poses)


def batch(snapshots: list[Snapshot], poses: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of (offset, rate) given all measurements at once, by Gauss-Newton."""
    x = np.concatenate([[0.0, 0.0], VTS.ravel()])
    for _ in range(8):
        information = np.zeros((14, 14))
        information[[0, 1], [0, 1]] = PRIOR_M**-2, PRIOR_M_S**-2
        score = -information @ x
        for snapshot, pose in zip(snapshots, poses, strict=True):
            elapsed = snapshot.index * DT
            for i, v in enumerate(snapshot.row):
                vt = x[2 + 3 * v : 5 + 3 * v]
                h = predict(pose, vt[None])[0]
                by_vt = jacobians(pose, vt[None])[0][0]
                a = np.zeros((3, 14))
                a[0, :2], a[:, 2 + 3 * v : 5 + 3 * v] = (1.0, elapsed), by_vt
                z = np.array([snapshot.distance_m[i], snapshot.azimuth_rad[i], snapshot.elevation_rad[i]])
                e = z - h - [x[0] + elapsed * x[1], 0, 0]
                information += a.T @ (a / STD[:, None] ** 2)
                score += a.T @ (e / STD**2)
        x = x + np.linalg.solve(information, score)
    return x[:2], np.linalg.inv(information)[:2, :2]


@pytest.mark.slow
def test_offset_and_rate_are_found_as_a_batch_does() -> None:
    snapshots, poses = drive()
    mean, cov = batch(snapshots, poses)
    zero = np.zeros(6)
    setup = Setup(
        Links(*np.zeros((3, 1), np.int64)), Sites(("A",), np.zeros(1), np.array([PRIOR_M]), np.array([PRIOR_M_S])),
        OdometryModel(zero, zero, zero, zero), zero, zero,
    )  # fmt: skip
    estimator = EkfSlam(EkfSlamOptions(**QUIET))
    estimator.start(setup, np.random.default_rng(0))
    for t, snapshot in enumerate(snapshots):
        estimate = estimator.step(DT if t else 0.0, np.array([1.0, 0, 0, 0.05, 0, 0]), snapshot)
    by = np.array([1.0, (STEPS - 1) * DT])
    assert estimate.clock_offset_m is not None and estimate.clock_offset_variance_m2 is not None
    std = np.sqrt(by @ cov @ by)
    assert abs(estimate.clock_offset_m[0] - by @ mean) < 0.2 * std
    assert np.sqrt(estimate.clock_offset_variance_m2[0]) == pytest.approx(std, rel=0.03)
