"""Odometry: exact inverse of the integration, and errors that follow the data sheet."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.sim.frames import integrate_pose
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.vehicle import Drive, OdometryConfig, measure_odometry, odometry_model
from cellslam.sim.world import prepare

DT_S = 0.075
PERFECT = OdometryConfig(
    wheel_scale=0, wheel_noise_m_per_sqrt_s=0, gyro_noise_deg_per_sqrt_s=0, gyro_bias_deg_per_s=0,
    gyro_bias_walk_deg_per_s_sqrt_s=0,
)  # fmt: skip


def flat_drive(count: int = 2000, speed_mps: float = 1.0) -> Drive:
    """A planar drive with a sinusoidal yaw rate; its instantaneous velocities are nobody's business."""
    poses = np.zeros((count, 6))
    poses[0] = [3.0, -2.0, 1.8, 3.0, 0.0, 0.0]
    rate = 0.2 * np.sin(np.arange(count) * 0.01)
    for t in range(1, count):
        poses[t] = integrate_pose(poses[t - 1], np.array([speed_mps, 0, 0, rate[t], 0, 0]), DT_S)
    return Drive(np.arange(count) * DT_S, poses, np.full((count, 6), np.nan))


def test_perfect_odometry_integrates_back_to_the_poses() -> None:
    driven = flat_drive()
    odometry = measure_odometry(driven, PERFECT, np.random.default_rng(0))
    pose = driven.poses[0]
    for t in range(1, len(driven.poses)):
        pose = integrate_pose(pose, odometry.velocity[t], DT_S)
        np.testing.assert_allclose(pose, driven.poses[t], atol=1e-9)
    np.testing.assert_array_equal(odometry.velocity[0], 0.0)


def test_drawn_errors_explain_the_measurement() -> None:
    driven = flat_drive()
    config = OdometryConfig(
        wheel_noise_m_per_sqrt_s=0.0, gyro_noise_deg_per_sqrt_s=0.0, gyro_bias_walk_deg_per_s_sqrt_s=0.01
    )
    odometry = measure_odometry(driven, config, np.random.default_rng(1))
    perfect = measure_odometry(driven, PERFECT, np.random.default_rng(0)).velocity[1:]
    expected = (1.0 + odometry.scale) * perfect + odometry.bias[1:]
    np.testing.assert_allclose(odometry.velocity[1:], expected, atol=1e-12)


def test_white_noise_and_walk_follow_the_data_sheet() -> None:
    driven = flat_drive(20_001)
    config = OdometryConfig(wheel_scale=0.0, gyro_bias_deg_per_s=0.0, gyro_bias_walk_deg_per_s_sqrt_s=0.02)
    odometry = measure_odometry(driven, config, np.random.default_rng(2))
    perfect = measure_odometry(driven, PERFECT, np.random.default_rng(0)).velocity
    model = odometry_model(config)
    white = (odometry.velocity - perfect - odometry.bias)[1:]
    walk = np.diff(odometry.bias, axis=0)
    # Relative error of a standard deviation of 20 000 draws: 0.5 %; 4.4 sigma is a false alarm rate of 1e-5.
    for component in (0, 3):
        assert white[:, component].std() == pytest.approx(model.noise_density[component] / np.sqrt(DT_S), rel=0.022)
    assert walk[:, 3].std() == pytest.approx(model.bias_walk_density[3] * np.sqrt(DT_S), rel=0.022)


def test_bias_and_scale_follow_the_data_sheet_over_trials() -> None:
    driven = flat_drive(3)
    trials = [measure_odometry(driven, OdometryConfig(), np.random.default_rng(seed)) for seed in range(2000)]
    bias, scale = np.array([t.bias[0] for t in trials]), np.array([t.scale for t in trials])
    model = trials[0].model
    # Relative error of a standard deviation of 2000 draws: 1.6 %; 4.4 sigma.
    np.testing.assert_allclose(bias.std(axis=0)[3], model.bias[3], rtol=0.07)
    np.testing.assert_allclose(scale.std(axis=0)[0], model.scale[0], rtol=0.07)
    assert abs(bias[:, 3].mean()) < 4.4 * model.bias[3] / np.sqrt(2000)
    assert abs(scale[:, 0].mean()) < 4.4 * model.scale[0] / np.sqrt(2000)
    assert abs(np.corrcoef(bias[:, 3], scale[:, 0])[0, 1]) < 0.1


def planar_error_m(driven: Drive, velocity: np.ndarray) -> np.ndarray:
    """Return the horizontal error (T,) of integrating forward speed and yaw rate from the true start."""
    turn = velocity[1:, 3] * DT_S
    middle = driven.poses[0, 3] + np.cumsum(turn) - 0.5 * turn
    step = velocity[1:, :1] * DT_S * np.column_stack([np.cos(middle), np.sin(middle)])
    return np.hypot(*(driven.poses[0, :2] + np.cumsum(step, axis=0) - driven.poses[1:, :2]).T)


def test_dead_reckoning_on_lund_is_as_in_the_paper() -> None:
    """Paper, section V: 20 m at most, 15 m at the end. Medians of 200 trials."""
    config = load("lund-530").world
    driven = prepare(config, 1, 0).drive
    errors = np.array(
        [
            planar_error_m(
                driven, measure_odometry(driven, config.odometry, stream(1, trial, Stream.ODOMETRY)).velocity
            )
            for trial in range(200)
        ]
    )
    assert 15.0 < np.median(errors.max(axis=1)) < 24.0
    assert 10.0 < np.median(errors[:, -1]) < 18.0
