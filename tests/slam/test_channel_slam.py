"""Channel-SLAM: updates against a plain Kalman filter, delay tracks, the kit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cellslam.slam.api import Snapshot
from cellslam.slam.channel_slam.channel_slam import ChannelSlam
from cellslam.slam.channel_slam.channel_slam_kernel import COMPONENT, COV, MEAN, TRIG, describe, face, weigh
from cellslam.slam.channel_slam.delay_tracks import Tracks
from cellslam.slam.conformance import EstimatorConformance

ANCHOR, USER = np.array([1.0, 2.0, 0.5]), np.array([9.0, -3.0, 0.5, 0.0, 0.0, 0.0])
UPPER = np.triu_indices(4)


def distance(state: Any) -> Any:
    """Return the distance from USER, with the clock offset, of (pseudo-range, azimuth, elevation, offset)."""
    s, az, el, b = state
    n = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    return np.linalg.norm(ANCHOR + (s - b) * n - USER[:3]) + b


def test_one_distance_updates_and_weighs_as_in_a_kalman_filter() -> None:
    rng = np.random.default_rng(0)
    mean, root = np.array([150.0, 0.8, 0.1, 20.0]), rng.normal(size=(4, 4)) * 0.05
    cov, measured, variance = root @ root.T + 1e-4 * np.eye(4), distance(mean) + 0.3, 0.4
    slope = np.array([(distance(mean + d) - distance(mean - d)) / 2e-5 for d in np.eye(4) * 1e-5])
    s = slope @ cov @ slope + variance
    gain = cov @ slope / s
    mixture = np.zeros((1, 1, 1, COMPONENT))
    mixture[0, 0, 0, 0], mixture[0, 0, 0, MEAN:COV], mixture[0, 0, 0, COV:TRIG] = 1.0, mean, cov[UPPER]
    face(mixture)
    log_weight, one = np.zeros(1), np.ones((1, 1), np.int64)
    weigh(
        USER[None], ANCHOR[None, None], mixture, one, np.zeros(1, np.int64), np.array([measured]),
        np.array([variance]), 0.0, 1e-3, log_weight,
    )  # fmt: skip
    np.testing.assert_allclose(mixture[0, 0, 0, MEAN:COV], mean + gain * 0.3, rtol=1e-7)
    np.testing.assert_allclose(mixture[0, 0, 0, COV:TRIG], (cov - np.outer(gain, gain) * s)[UPPER], atol=1e-7)
    assert log_weight[0] == pytest.approx(-0.5 * (0.09 / s + np.log(2 * np.pi * s)), rel=1e-6)


def test_moments_of_a_mixture_are_those_of_samples() -> None:
    rng = np.random.default_rng(1)
    means = np.array([[120.0, 0.3, 0.1, 10.0], [130.0, 0.6, 0.0, -5.0]])
    root = np.diag([0.5, 0.05, 0.04, 3.0])
    root[3, 1] = 1.5
    mixture = np.zeros((2, COMPONENT))
    mixture[:, 0], mixture[:, MEAN:COV], mixture[:, COV:TRIG] = [0.3, 0.7], means, (root @ root.T)[UPPER]
    out = np.zeros((5, 4))
    describe(ANCHOR, mixture, 2, np.zeros((4, 8)), out)
    drawn = means[(rng.random(200_000) < 0.7).astype(int)] + rng.normal(size=(200_000, 4)) @ root.T
    rho, az, el = drawn[:, 0] - drawn[:, 3], drawn[:, 1], drawn[:, 2]
    flat = rho * np.cos(el)
    points = np.stack(
        [*(ANCHOR[:2, None] + flat * [np.cos(az), np.sin(az)]), ANCHOR[2] + rho * np.sin(el), drawn[:, 3]]
    )
    np.testing.assert_allclose(out[0], points.mean(axis=1), atol=0.15)
    np.testing.assert_allclose(out[1:], np.cov(points), rtol=0.05, atol=1.0)


def test_a_path_is_followed_by_its_distance() -> None:
    tracks, rng, ids = Tracks.none(), np.random.default_rng(2), []
    for t in range(100):
        distances = np.array([300.0 - 0.1 * t, 340.0, *([rng.uniform(400.0, 900.0)] if t % 3 == 0 else [])])
        nothing = np.zeros(len(distances))
        snapshot = Snapshot(
            t, np.arange(len(distances)), nothing.astype(np.int64), distances, nothing, nothing, nothing
        )
        ids.append(tracks.follow(snapshot, 0.1 * t, 0.1 if t else 0.0, 3.0, 1.5, 10 * t))
    assert len({int(row[0]) for row in ids}) == 1
    assert len({int(row[1]) for row in ids}) == 1
    assert ids[0][0] != ids[0][1]
    j = int(np.flatnonzero(tracks.id == ids[0][0])[0])
    assert tracks.distance_m[j] == pytest.approx(290.1, abs=0.3)
    assert tracks.rate_mps[j] == pytest.approx(-1.0, abs=0.3)
    assert len(tracks) < 12  # clutter has gone


class TestChannelSlam(EstimatorConformance):
    @pytest.fixture
    def estimator(self) -> type[Any]:
        return ChannelSlam

    @pytest.fixture
    def options(self, estimator: type[Any]) -> Any:
        return estimator.Options(particles=40, directions=16)
