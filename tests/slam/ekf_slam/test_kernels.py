"""EKF-SLAM's kernels against plain formulas: prediction, birth, update, marginalisation, motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.sim.frames import integrate_pose
from cellslam.slam.api import setup_of
from cellslam.slam.conformance.subject import tiny_drive
from cellslam.slam.ekf_slam.association_kernel import log_density
from cellslam.slam.ekf_slam.filter_bank import new_bank
from cellslam.slam.ekf_slam.map_kernel import remove
from cellslam.slam.ekf_slam.state_layout import FREE, Core
from cellslam.slam.ekf_slam.update_kernel import expect, update
from cellslam.slam.ekf_slam.vt_kernel import covariance, give_birth
from cellslam.slam.model.downdate_kernel import downdate
from cellslam.slam.model.measurement_model import birth as born_at
from cellslam.slam.model.measurement_model import predict

POSE = np.array([3.0, -2.0, 1.5, 0.7, 0.1, -0.2])


def slopes(function: Callable[[Any], Any], x: Any) -> Any:
    """Return the numeric Jacobian of a function at x."""
    steps = 1e-6 * np.eye(len(x))
    return np.array([(function(x + step) - function(x - step)) / 2e-6 for step in steps]).T


def test_prediction_and_jacobians_are_those_of_the_model(one_filter: Any) -> None:
    one, root = one_filter(1), np.random.default_rng(0).normal(size=(10, 10))
    one.put(POSE, 15.0, [90.0, 2.5, 0.3], anchor=[-4.0, 6.0, 2.0])
    one.f.p[:] = root @ root.T
    mean = one.f.x.copy()

    def expected(x: Any) -> Any:
        one.f.x[:] = x
        return one.model(0)[0]

    h, by = one.model(0)
    np.testing.assert_allclose(h - [15.0, 0.0, 0.0], predict(POSE, one.place(0)), rtol=1e-12)
    np.testing.assert_allclose(by, slopes(expected, mean), rtol=1e-6, atol=1e-7)
    one.f.x[:] = mean
    spread = (by @ one.f.p @ by.T)[np.triu_indices(3)]
    np.testing.assert_allclose(expect(one.f, 0, 6, one.w.h, one.w.t)[1], spread, rtol=1e-10)
    np.testing.assert_allclose(covariance(one.f, 0, 6, one.w.h, one.w.narrow), spread, rtol=1e-10)


def test_birth_is_exact_and_correlated_with_pose_and_offset(one_filter: Any) -> None:
    one, z, q, b = one_filter(1), np.array([120.0, 1.0, 0.2]), np.array([0.4, 2e-4, 3e-4]), 15.0
    root = np.random.default_rng(0).normal(size=(7, 7)) * 0.01
    one.put(POSE, b)
    one.f.p[:7, :7] = before = root @ root.T

    def born(x: Any) -> Any:
        """Return range, azimuth, elevation about POSE's place of what pose, offset and measurement point to."""
        out = born_at(x[:6], x[7] - x[6], x[8], x[9]) - POSE[:3]
        flat = np.hypot(out[0], out[1])
        return np.array([np.hypot(flat, out[2]), np.arctan2(out[1], out[0]), np.arctan2(out[2], flat)])

    give_birth(one.f, 0, 6, z, q, True)
    given = np.concatenate([POSE, [b], z])
    by, p = slopes(born, given), one.f.p
    np.testing.assert_allclose(one.f.x[7:], born(given), rtol=1e-12)
    np.testing.assert_allclose(p[7:, :7], by[:, :7] @ before, rtol=1e-5, atol=1e-9)
    spread = by[:, :7] @ before @ by[:, :7].T + (by[:, 7:] * q) @ by[:, 7:].T
    np.testing.assert_allclose(p[7:, 7:], spread, rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(p, p.T)


def test_updates_are_textbook_kalman_updates_also_while_they_wait(one_filter: Any, kalman: Callable[..., Any]) -> None:
    one, root = one_filter(2), np.random.default_rng(1).normal(size=(13, 13)) * 0.02
    q, turn, k = np.array([0.3, 1e-4, 2e-4]), np.array([0.0, 2.0 * np.pi, 0.0]), 0
    one.put(POSE, 5.0, [80.0, 0.5, 0.2], [60.0, -1.0, 0.1])
    x, p = one.f.x, one.f.p
    p[:] = root @ root.T
    mean, cov = x.copy(), p.copy()
    for j, e in ((0, [0.2, 0.01, -0.02]), (1, [-0.3, 0.01, 0.01]), (0, [0.1, np.nan, 0.01]), (1, [0.1, 0.0, 0.0])):
        h, by = one.model(j)
        mean, cov, value = kalman(mean, cov, by, np.array(e), q)
        got, k = update(one.f, j, 6, h + e + turn, q, one.w, k)
        np.testing.assert_allclose(got, value, rtol=1e-8)
        np.testing.assert_allclose(x, mean, rtol=1e-9, atol=1e-12)
    downdate(p, 13, one.w.pending, k)
    np.testing.assert_allclose(p, cov, rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(p, p.T)


def test_density_of_a_pair_ends_at_the_gate(one_filter: Any, kalman: Callable[..., Any]) -> None:
    one, root, q = one_filter(1), np.random.default_rng(1).normal(size=(10, 10)) * 0.02, np.array([0.3, 1e-4, 2e-4])
    one.put(POSE, 5.0, [80.0, 0.5, 0.2])
    one.f.p[:] = root @ root.T
    h, by = one.model(0)
    given = expect(one.f, 0, 6, one.w.h, one.w.t)
    for e in np.array([[0.2, 0.01, -0.02], [0.3, np.nan, 0.02]]):
        there = np.isfinite(e)
        s = (by @ one.f.p @ by.T + np.diag(q))[np.ix_(there, there)]
        e /= np.sqrt(e[there] @ np.linalg.solve(s, e[there]))
        near, far = np.sqrt(one.rules.gate - 0.01) * e, np.sqrt(one.rules.gate + 0.01) * e
        seen = one.seen(h + np.array([near, far]), np.array([q, q]))
        assert log_density(one.f, seen, 0, 6, *given) == pytest.approx(kalman(one.f.x, one.f.p, by, near, q)[2])
        assert log_density(one.f, seen, 1, 6, *given) == -np.inf


def test_dropping_a_vt_marginalises_it(one_filter: Any) -> None:
    f, rng, kept = one_filter(3).f, np.random.default_rng(2), np.r_[0:7, 13:16, 10:13]
    root = rng.normal(size=(16, 16))
    f.x[:], f.p[:], f.anchor[:] = rng.normal(size=16), root @ root.T, rng.normal(size=f.anchor.shape)
    f.slots[:], f.count[0] = np.arange(12).reshape(3, 4), 3
    mean, cov, left = f.x[kept], f.p[np.ix_(kept, kept)], f.anchor[[2, 1]]
    remove(f, 0)
    assert f.count[0] == 2
    np.testing.assert_array_equal(f.x[:13], mean)
    np.testing.assert_array_equal(f.p[:13, :13], cov)
    np.testing.assert_array_equal(f.anchor[:2], left)
    np.testing.assert_array_equal(f.slots[:2, 0], [8, 4])


def test_motion_is_that_of_the_frames_module() -> None:
    setup = setup_of(tiny_drive())
    sheet = replace(setup.odometry_model, bias=np.full(6, 0.02), scale=np.full(6, 0.01), noise_density=np.full(6, 0.01))
    writable = replace(sheet, bias_walk_density=np.full(6, 1e-3))
    setup = replace(setup, odometry_model=writable, start_pose=POSE, start_std=np.full(6, 0.05))
    core = Core.of(setup)
    bank = new_bank(setup, core, FREE, 2, np.zeros((1, 2)), np.ones(2))
    u, dt, n = np.array([2.0, 0.3, -0.1, 0.4, -0.2, 0.1]), 0.3, core.size
    bank.x[0, core.bias], bank.x[0, core.scale] = 0.01, 0.02
    before, p = np.concatenate([bank.x[0, :n], np.zeros(6)]), bank.p[0, :n, :n].copy()

    def moved(x: Any) -> Any:
        """Return the core that a core, and behind it the odometry's noise, move to."""
        velocity = (u - x[core.bias] - x[n:]) / (1.0 + x[core.scale])
        return np.concatenate([integrate_pose(x[:6], velocity, dt), x[6:n]])

    bank.move(setup, dt, u)
    by = slopes(moved, before)
    expected = by[:, :n] @ p @ by[:, :n].T + by[:, n:] @ by[:, n:].T * 0.01**2 / dt
    expected[core.bias, core.bias] += 1e-6 * dt
    np.testing.assert_allclose(bank.x[0, :n], moved(before), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(bank.p[0, :n, :n], expected, rtol=1e-6, atol=1e-10)
