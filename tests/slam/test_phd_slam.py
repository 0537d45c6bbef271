"""PHD-SLAM: its kernels against plain formulas, and transmitters that are known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.scenarios.known_worlds import phd_slam_3
from cellslam.sim.compiling import njit
from cellslam.sim.frames import integrate_pose, rotation
from cellslam.slam.model.matrices_kernel import mat_of, vec_of
from cellslam.slam.model.measurement_model import jacobians, predict
from cellslam.slam.phd_slam import map_kernel
from cellslam.slam.phd_slam.map_kernel import COVARIANCE, GAIN, MEAN, NAMES, VISIBLE, WIDTH, put_update, seen_from
from cellslam.slam.phd_slam.motion_kernel import factorise, inform, moved, slopes
from cellslam.slam.phd_slam.pairs_kernel import Pairs, exclusive
from cellslam.slam.phd_slam.phd_slam import TRIANGLE, PhdSlam, PhdSlamOptions
from cellslam.slam.phd_slam.snapshot_kernel import Particles, resample
from tests.slam.driving import driven

POSE, VT = np.array([3.0, -2.0, 1.5, 0.7, 0.1, -0.2]), np.array([60.0, 45.0, 20.0])
Q, UPPER = np.array([0.4, 3e-4, 5e-4]), np.triu_indices(3)


def a_row(seed: int = 0) -> tuple[Any, Any, Any]:
    """Return a map of one Gaussian at VT, its covariance and gain."""
    root, gain = np.random.default_rng(seed).normal(size=(3, 3)), np.array([-0.7, -0.5, -0.2])
    rows, covariance = np.zeros((1, WIDTH)), root @ root.T
    rows[0, MEAN:COVARIANCE], rows[0, COVARIANCE:GAIN], rows[0, GAIN:VISIBLE] = VT, covariance[UPPER], gain
    return rows, covariance, gain


@njit
def updated(place: Any, r: Any, rows: Any, offset: float, z: Any, q: Any, out: Any) -> float:
    seen = seen_from(vec_of(place), mat_of(r), rows, 0, offset)
    new = map_kernel.innovation(map_kernel.residual(seen, vec_of(z), vec_of(np.ones(3))), seen.spread, vec_of(q))
    put_update(out, 0, rows, 0, seen, new)
    return new.log_density


@njit
def informed(pose: Any, velocity: Any, std: Any, rows: Any, z: Any, q: Any, information: Any, y: Any) -> None:
    at = moved(pose, velocity, 0.5)
    seen = seen_from(at.place, at.turned.r, rows, 0, 0.0)
    new = map_kernel.innovation(map_kernel.residual(seen, vec_of(z), vec_of(np.ones(3))), seen.spread, vec_of(q))
    inform(slopes(seen, vec_of(rows[0]), at, std), new.inverse, new.e, 0.7, information, y)


def test_update_with_its_gain_is_that_of_place_and_clock_offset_together() -> None:
    """Given the offset, a VT is at mean + gain (b - b_hat): conditioning both jointly must give the same."""
    rows, covariance, gain = a_row()
    out, h, by = np.zeros((1, WIDTH)), predict(POSE, VT), jacobians(POSE, VT)[0]
    e = np.array([0.7, 0.01, -0.02])
    value = updated(POSE[:3], rotation(*POSE[3:]), rows, 12.0, h + e + [12.0, 2.0 * np.pi, 0.0], Q, out)
    s = by @ covariance @ by.T + np.diag(Q)
    assert value == pytest.approx(-0.5 * (e @ np.linalg.solve(s, e) + np.log(np.linalg.det(2.0 * np.pi * s))))
    variance, a = 9.0, by @ gain + [1.0, 0.0, 0.0]
    joint = np.zeros((4, 4))
    joint[:3, :3], joint[3, 3] = covariance + variance * np.outer(gain, gain), variance
    joint[:3, 3] = joint[3, :3] = variance * gain
    full = np.column_stack([by, [1.0, 0.0, 0.0]])
    k = joint @ full.T @ np.linalg.inv(full @ joint @ full.T + np.diag(Q))
    posterior, change = joint - k @ full @ joint, k @ e
    left = 1.0 / (1.0 / variance + a @ np.linalg.solve(s, a))
    db = left * a @ np.linalg.solve(s, e)
    assert (posterior[3, 3], change[3]) == pytest.approx((left, db))
    g = out[0, GAIN:VISIBLE]
    np.testing.assert_allclose(out[0, MEAN:COVARIANCE] + g * db, VT + change[:3], rtol=1e-9)
    given = out[0, COVARIANCE:GAIN][TRIANGLE]
    np.testing.assert_allclose(given + left * np.outer(g, g), posterior[:3, :3], rtol=1e-7, atol=1e-10)


def test_information_on_the_velocity_is_that_of_differences() -> None:
    rows, covariance, _ = a_row()
    velocity, std = np.array([3.0, 0.2, 0.0, 0.3, 0.0, 0.1]), np.array([0.5, 0.1, 0.0, 0.05, 0.01, 0.02])
    at, e = integrate_pose(POSE, velocity, 0.5), np.array([0.5, -0.02, 0.01])
    information, y, mean = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    informed(POSE, velocity, std, rows, predict(at, VT) + e, Q, information, y)
    steps = 1e-6 * np.eye(6)
    j = np.array([
        predict(integrate_pose(POSE, velocity + d, 0.5), VT) - predict(integrate_pose(POSE, velocity - d, 0.5), VT)
        for d in steps
    ]).T / 2e-6 * std  # fmt: skip
    by = jacobians(at, VT)[0]
    s = np.linalg.inv(by @ covariance @ by.T + np.diag(Q))
    np.testing.assert_allclose(np.tril(information), np.tril(0.7 * j.T @ s @ j), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(y, 0.7 * j.T @ s @ e, rtol=1e-4, atol=1e-6)
    factorise(information, y, mean)
    np.testing.assert_allclose(mean, np.linalg.solve(np.eye(6) + 0.7 * j.T @ s @ j, y), rtol=1e-3, atol=1e-6)


def test_marginals_are_those_of_all_exclusive_assignments() -> None:
    """Exact without a loop: two Gaussians that share one measurement, one of them with another."""
    found = exclusive(Pairs(*map(np.array, ([0, 0, 1], [0, 1, 1], [5.0, 2.0, 9.0]))), 2)
    # Nothing, one pair alone, or the first with 0 and the second with 1: 1 + 5 + 2 + 9 + 5 * 9 = 62.
    np.testing.assert_allclose(found, [(5.0 + 45.0) / 62.0, 2.0 / 62.0, (9.0 + 45.0) / 62.0], rtol=1e-9)


def test_merging_keeps_weight_and_moments_of_what_it_merges() -> None:
    rows, names = np.zeros((4, WIDTH)), np.zeros((4, NAMES), np.int64)
    rows[:, VISIBLE], rows[:, map_kernel.HIDDEN] = [0.5, 0.2, 0.4, 1e-9], [0.1, 0.0, 0.0, 0.0]
    rows[:, MEAN] = [0.0, 1.0, 50.0, 0.0]
    rows[:, COVARIANCE:GAIN] = np.eye(3)[UPPER]
    own = map_kernel.Map(np.zeros((8, WIDTH)), np.zeros((8, NAMES), np.int64), np.zeros(1, np.int64))
    map_kernel.condense(map_kernel.Map(rows.copy(), names, np.array([4])), own, np.empty(0, np.int64), 1e-6, 4.0)
    assert own.size[0] == 2
    share = 0.2 / 0.8
    assert own.rows[0, [VISIBLE, map_kernel.HIDDEN]] == pytest.approx([0.7, 0.1])
    assert own.rows[0, [MEAN, COVARIANCE]] == pytest.approx([share, 1.0 + share * (1.0 - share)])
    assert own.rows[1, MEAN] == 50.0


def test_resampled_particles_share_nothing() -> None:
    n = 4
    parts = [np.arange(n * k, dtype=float).reshape(n, *shape) for k, shape in ((6, (6,)), (12, (6, 2)), (18, (6, 3)))]
    maps = np.arange(n * 2 * WIDTH, dtype=float).reshape(n, 2, WIDTH), np.zeros((n, 2, NAMES), np.int64)
    p = Particles(*parts, np.zeros((n, 1)), np.zeros((n, 1)), np.ones((n, 1)), *maps, np.full((n, 1), 2))
    before = [part.copy() for part in (p.pose, p.error, p.error_variance, p.rows)]
    resample(p, np.array([1, 1, 1, 3]))
    for part, was in zip((p.pose, p.error, p.error_variance, p.rows), before, strict=True):
        np.testing.assert_array_equal(part, was[[1, 1, 1, 3]])
    p.rows[0] = -1.0
    np.testing.assert_array_equal(p.rows[1], before[3][1])
    assert not p.log_weight.any()


def test_known_transmitters_are_in_the_map_from_the_start() -> None:
    recording, options = phd_slam_3.simulate(77, 0), dict(phd_slam_3.WORLD.entries[0].options) | {"particles": 2}
    sites = replace(recording.sites, position_m=np.array([[310.0, 395.0, 0.0]]))
    vts = driven(PhdSlam(PhdSlamOptions(**options)), replace(recording, sites=sites), 1)[0].vts
    assert vts is not None
    np.testing.assert_allclose(vts.position_m, sites.position_m, atol=0.01)
