"""The smoother: Jacobians, odometry, a drive with wrong associations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.sim.frames import integrate_pose, rotation
from cellslam.sim.recording import Recording
from cellslam.slam.api import setup_of, snapshots_of
from cellslam.slam.model.measurement_model import predict

pytest.importorskip("gtsam", reason="GTSAM is not installed: pip install 'cellslam[gtsam]'")
from cellslam.slam.smoother.drive_factors import Drive, between, leg, local, problem_of
from cellslam.slam.smoother.factor_graph import residual, solve
from cellslam.slam.smoother.smoother_options import SmootherOptions

POSE, VT = np.array([3.0, -2.0, 1.5, 0.7, 0.1, -0.2]), np.array([60.0, 40.0, 20.0])
STEP = np.array([0.8, 0.1, 0.0, 0.05, 0.01, 0.0])


def after(pose: Any, step: Any) -> Any:
    """Return the pose at rotation vector step[:3] and translation step[3:] in the frame of `pose`, for small turns."""
    turn = np.array([step[2], step[1], step[0]])
    r = rotation(*pose[3:]) @ rotation(*turn)
    angles = np.array([np.arctan2(r[1, 0], r[0, 0]), -np.arcsin(r[2, 0]), np.arctan2(r[2, 1], r[2, 2])])
    return np.concatenate([pose[:3] + rotation(*pose[3:]) @ step[3:], angles])


def mean_residual(pose: Any, vt: Any) -> tuple[Any, Any, Any]:
    relative = np.array([[*np.eye(3).ravel(), 0, 0, 0], [*rotation(*STEP[3:]).ravel(), *STEP[:3]]], np.float64)
    z, out, by_pose, by_vt = np.array([[70.0, 0.1, 0.2], [69.0, 0.0, 0.2]]), *map(np.zeros, ((3,), (3, 6), (3, 3)))
    residual(rotation(*pose[3:]), pose[:3], vt, 5.0, relative, z, out, by_pose, by_vt)
    return out, by_pose, by_vt


def test_mean_residual_is_that_of_the_model_and_so_are_its_jacobians() -> None:
    out, by_pose, by_vt = mean_residual(POSE, VT)
    second = np.concatenate([POSE[:3] + rotation(*POSE[3:]) @ STEP[:3], np.zeros(3)])
    r = rotation(*POSE[3:]) @ rotation(*STEP[3:])
    second[3:] = [np.arctan2(r[1, 0], r[0, 0]), -np.arcsin(r[2, 0]), np.arctan2(r[2, 1], r[2, 2])]
    expected = predict(np.array([POSE, second]), VT) + np.array([5.0, 0.0, 0.0]) - [[70.0, 0.1, 0.2], [69.0, 0.0, 0.2]]
    np.testing.assert_allclose(out, expected.mean(axis=0), atol=1e-12)
    for i in range(6):
        d = np.eye(6)[i] * 1e-6
        numeric = (mean_residual(after(POSE, d), VT)[0] - mean_residual(after(POSE, -d), VT)[0]) / 2e-6
        np.testing.assert_allclose(by_pose[:, i], numeric, atol=1e-5)
    for i in range(3):
        d = np.eye(3)[i] * 1e-6
        numeric = (mean_residual(POSE, VT + d)[0] - mean_residual(POSE, VT - d)[0]) / 2e-6
        np.testing.assert_allclose(by_vt[:, i], numeric, atol=1e-6)


def test_a_leg_is_the_odometry_and_knows_its_errors(toy_recording: Callable[..., Recording]) -> None:
    model = setup_of(toy_recording()).odometry_model
    model = replace(model, bias=np.array([0, 0, 0, 0.01, 0, 0.0]), scale=np.array([0.01, 0, 0, 0, 0, 0.0]))
    velocity, dt = np.tile([2.0, 0, 0, 0.3, 0, 0], (10, 1)), np.full(10, 0.1)
    one = leg(velocity, dt, model)
    pose = np.zeros(6)
    for u, step in zip(velocity, dt, strict=True):
        pose = integrate_pose(pose, u, step)
    np.testing.assert_allclose(one.relative, pose, atol=1e-12)
    assert one.by_error.shape == (6, 2)
    biased = leg(velocity - [0, 0, 0, 1e-3, 0, 0], dt, model)
    np.testing.assert_allclose(local(one.relative, biased.relative), one.by_error[:, 0] * 1e-3, atol=1e-6)
    rng, ends = np.random.default_rng(0), []
    for _ in range(2000):
        noisy = velocity + model.noise_density / np.sqrt(0.1) * rng.standard_normal((10, 6))
        noisy_pose = np.zeros(6)
        for u in noisy:
            noisy_pose = integrate_pose(noisy_pose, u, 0.1)
        ends.append(local(one.relative, noisy_pose))
    np.testing.assert_allclose(np.std(ends, axis=0), one.std, rtol=0.1)


def drive(recording: Recording, share_wrong: float) -> tuple[Any, Any]:
    """Smooth a toy drive from true associations of which a share is wrong; return errors before and after (m)."""
    truth, rng = recording.truth, np.random.default_rng(4)
    assert truth is not None
    vt = truth.measurement_vt.copy()
    wrong = rng.random(len(vt)) < share_wrong
    vt[wrong] = (vt[wrong] + 1) % 4
    snapshots, rows = snapshots_of(recording), recording.rows
    dt = np.diff(recording.time_s, prepend=recording.time_s[0])
    poses = [np.array(recording.start_pose)]
    for u, step in zip(recording.odometry[1:], dt[1:], strict=True):
        poses.append(integrate_pose(poses[-1], u, step))
    vts = {v: truth.vts.position_m[v] + rng.normal(0.0, 3.0, 3) for v in range(4)}
    association = [vt[rows[t] : rows[t + 1]] for t in range(len(dt))]
    before = np.array(poses)
    given = Drive(setup_of(recording), dt, recording.odometry, snapshots, association, before, vts, np.zeros(2))
    options = SmootherOptions(keyframe_s=0.5)
    problem, frames = problem_of(given, options)
    solution = solve(problem, options.gate, options.huber, options.rounds, options.iterations)
    smoothed = between(solution.keyframes, problem.legs, frames)
    return [np.sqrt(np.mean(np.sum((p - truth.poses)[:, :2] ** 2, axis=1))) for p in (before, smoothed)], solution


def test_smooths_a_drive_and_leaves_wrong_associations_out(toy_recording: Callable[..., Recording]) -> None:
    recording = toy_recording(120, seed=3)
    (before, clean), solution = drive(recording, 0.0)
    assert clean < 0.7 * before
    assert solution.outlier.mean() < 0.05
    (_, spoilt), solution = drive(recording, 0.05)
    assert spoilt < 1.5 * clean + 0.02
    assert solution.outlier.sum() > 5


def test_a_survey_holds_the_graph(toy_recording: Callable[..., Recording]) -> None:
    """A transmitter that was surveyed stays where the survey has it, one without a survey follows the measurements."""
    recording = toy_recording(80, seed=3)
    truth, wrong = recording.truth, np.array([[2.0, 1.0, 0.0]])
    assert truth is not None
    for std_m, moves in ((1e-3, False), (20.0, True)):
        place = np.where([[True], [False]], truth.site_positions_m + wrong, np.nan)
        sites = replace(recording.sites, position_m=place, position_std_m=np.full((2, 3), std_m))
        _, solution = drive(replace(recording, sites=sites), 0.0)
        off = np.linalg.norm(solution.vts[0] - truth.site_positions_m[0] - wrong[0])
        assert (off > 0.3) == moves
