"""The variances of measurements whose errors persist: each draw of an error counts once; VTs that come and go."""

import numpy as np
import pytest

from cellslam.sim.recording import Links, OdometryModel, Sites
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.measurements.fusion import Fusion
from cellslam.slam.measurements.measurement_options import MeasurementOptions, existence, visibility
from cellslam.slam.measurements.readings import Readings, count_sharers, crowd, novelty, readings, repeats

ROWS = [(0, 100.0, 0.1, 0.1), (1, 100.1, 0.1, 0.1), (2, 100.0, 1.0, 0.1)]


def read(
    rows: list[tuple[int, float, float, float]], options: MeasurementOptions, turn: float, moved: float
) -> Readings:
    """Measurements (link, distance, azimuth, elevation) of three links of one site, which has one port."""
    zero, one = np.zeros(6), np.zeros(3, np.int64)
    setup = Setup(
        Links(one, np.arange(3), one), Sites(("A",), np.zeros(1), np.zeros(1)), OdometryModel(zero, zero, zero, zero),
        zero, zero,
    )  # fmt: skip
    link, *z = np.array(rows).T
    snapshot = Snapshot(0, np.arange(len(rows)), link.astype(np.int64), *z, np.full(len(rows), 20.0))
    return readings(Fusion(setup, options).fuse(snapshot), np.arange(3), options, turn, moved)


def test_links_that_measure_one_path_are_counted() -> None:
    z, q, link, one = np.array(ROWS)[:, 1:], np.tile([0.3, 1e-4, 1e-4], (3, 1)), np.arange(3), np.zeros(3, np.int64)
    assert list(count_sharers(z, link, one, q)) == [2, 2, 1]
    assert list(count_sharers(z, link, np.array([0, 1, 0]), q)) == [1, 1, 1]
    assert list(count_sharers(z, np.array([0, 0, 1]), one, q)) == [1, 1, 1]
    unknown = np.where([[False, True, False]] * 3, np.nan, z)
    assert list(count_sharers(unknown, link, one, q)) == [3, 3, 3]


def test_persisting_errors_count_once() -> None:
    options = MeasurementOptions(sharing="none")
    fast, still = (read(ROWS, options, *move) for move in ((np.radians(90.0), 100.0), (0.0, 0.0)))
    assert np.all(fast.many[:2, 1:] > fast.single[:2, 1:])
    np.testing.assert_allclose(fast.many[2, 1:], fast.single[2, 1:])
    np.testing.assert_allclose(fast.fresh, fast.many)  # every error is redrawn
    np.testing.assert_allclose(still.fresh, fast.fresh)
    assert np.all(still.many > 1e3 * still.fresh)


def test_novelty_is_what_the_last_snapshot_has_not_shown() -> None:
    white = MeasurementOptions(diffuse_scale_m=0.0, calibration_scale_deg=0.0, roof_scale_deg=0.0)
    assert novelty(white, 0.0, 0.08) == pytest.approx(1.0)
    usual = MeasurementOptions()
    standing, straight, turning = (novelty(usual, *move) for move in ((0.0, 0.0), (0.0, 0.08), (0.02, 0.08)))
    assert 0.0 < standing < 1e-4 < straight < 0.02 < turning < 0.5
    # As an update of a lone path counts it, which is seen with one port.
    lone = read([(0, 150.0, 0.3, 0.1)], usual, 0.02, 0.08)
    assert np.mean(lone.single / lone.many) == pytest.approx(turning, rel=0.05)


def test_directions_that_crowd_share_their_error() -> None:
    """Two of one direction count double, the third half as close counts for its correlation, far ones not at all."""
    azimuth, elevation = np.radians([10.0, 10.0, 14.0, -170.0]), np.zeros(4)
    near = np.exp(-0.5)
    assert crowd(azimuth, elevation, np.radians(4.0)) == pytest.approx([2 + near, 2 + near, 1 + 2 * near, 1.0])
    assert crowd(np.radians([179.0, -179.0]), np.zeros(2), np.radians(2.0)) == pytest.approx([1 + near, 1 + near])
    assert crowd(np.full(3, np.nan), np.zeros(3), 0.1) == pytest.approx([1.0, 1.0, 1.0])


def test_a_repeated_mean_has_the_variance_that_draws_promises() -> None:
    """An error with correlation exp(-x^2 / (2 scale^2)): the mean of n samples varies as std^2 repeats / n."""
    rng = np.random.default_rng(5)
    step, scale, n, runs = 0.05, 0.15, 400, 2000
    lag = step * np.arange(n)
    root = np.linalg.cholesky(np.exp(-((lag[:, None] - lag) ** 2) / (2 * scale**2)) + 1e-9 * np.eye(n))
    means = (root @ rng.standard_normal((n, runs))).mean(axis=0)
    assert means.var() == pytest.approx(repeats(scale, step) / n, rel=0.1)


def test_visibility_falls_with_misses_and_comes_back_for_known_vts() -> None:
    once = visibility(0.01, 0.99, 0.0, 0.9, 50)
    known = visibility(1.0, 0.99, 0.01, 0.9, 500)
    assert np.all(np.diff(once[1:20]) < 0)
    assert once[1] == pytest.approx(0.01 * 0.99)
    assert known[2] == pytest.approx(
        (0.99 * 0.1 / (1 - 0.99 * 0.9)) * 0.99 + (1 - 0.99 * 0.1 / (1 - 0.99 * 0.9)) * 0.01
    )
    assert 0.005 < known[-1] < 0.02
    logs, age_once, age_twice = existence(MeasurementOptions(), 0.075)
    assert np.all(logs <= 0.0)
    assert 0 < age_once < age_twice
