"""Known worlds of others: their geometry and statistics are the published ones."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.known_worlds import NAMES, bp_slam_testbed, known_world, phd_slam_3
from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle


def test_bp_slam_trajectory_and_ranges() -> None:
    poses = bp_slam_testbed.trajectory()
    corners = {
        81: (2.22, 7.82), 311: (2.22, 5.52), 431: (1.02, 5.52), 561: (1.02, 4.22), 611: (0.52, 4.22),
        715: (0.52, 3.18), 716: (0.520579830217, 3.175990198080), 900: (2.098366813528, 2.229318008093),
    }  # fmt: skip
    for number, corner in corners.items():
        np.testing.assert_allclose(poses[number - 1, :2], corner, atol=1e-11)
    distance = np.linalg.norm(poses[:, None, :2] - bp_slam_testbed.FEATURES_M, axis=-1)
    first = [2.650057, 5.185248, 15.028781, 8.071759, 3.394330, 4.216503, 5.934880, 10.352140, 7.306783, 10.413419,
             12.146720]  # fmt: skip
    np.testing.assert_allclose(distance[0], first, atol=1e-6)


def test_bp_slam_recording() -> None:
    recording = bp_slam_testbed.simulate(3, 0)
    m, truth = recording.measurements, recording.truth
    assert truth is not None and recording.sites.position_m is not None
    real = truth.measurement_vt >= 0
    assert real.sum() / (899 * 11) == pytest.approx(0.95, abs=0.01)
    assert (~real).sum() / (899 * 2) == pytest.approx(1.0, abs=0.12)
    vts = truth.vts.position_m[truth.measurement_vt[real]]
    error = m.distance_m[real] - np.linalg.norm(truth.poses[m.snapshot[real], :3] - vts, axis=1)
    assert np.std(error) == pytest.approx(0.1, rel=0.05)
    assert m.snapshot[0] == 1 and np.isnan(m.azimuth_rad).all()


def test_phd_slam_trajectory_meets_the_published_one() -> None:
    poses = phd_slam_3.trajectory()
    known = np.array(phd_slam_3.WAYPOINTS)
    np.testing.assert_allclose(poses[::100, :2], known[:, :2], atol=1e-6)
    np.testing.assert_allclose(wrap_angle(poses[::100, 3] - known[:, 2]), 0.0, atol=1e-8)
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    assert steps.sum() == pytest.approx(4002.0, abs=3.0)
    assert steps.std() == pytest.approx(0.05, rel=0.1)


def test_phd_slam_recording() -> None:
    recording = phd_slam_3.simulate(3, 0)
    m, truth = recording.measurements, recording.truth
    assert truth is not None
    real = truth.measurement_vt >= 0
    assert real.sum() / 4000 / 0.95 == pytest.approx(7.63, abs=0.1)
    assert (~real).sum() / 4000 == pytest.approx(4.75, abs=0.15)
    assert len(np.unique(truth.measurement_vt[real])) == 160
    w = truth.vts.position_m[truth.measurement_vt[real]] - truth.poses[m.snapshot[real], :3]
    assert np.std(m.distance_m[real] - np.linalg.norm(w, axis=1)) == pytest.approx(0.8, rel=0.03)
    bearing = np.arctan2(w[:, 1], w[:, 0]) - truth.poses[m.snapshot[real], 3]
    assert np.std(wrap_angle(m.azimuth_rad[real] - bearing)) == pytest.approx(np.radians(0.3), rel=0.03)
    assert not np.array_equal(recording.odometry, phd_slam_3.simulate(3, 1).odometry)


def test_names_and_published_figures() -> None:
    for name in NAMES:
        world = known_world(name)
        assert world.name == name and world.differences
        assert all(set(entry.published) <= {figure.name for figure in world.figures} for entry in world.entries)
    with pytest.raises(InputError, match="unknown known world 'phd-slam'"):
        known_world("phd-slam")


@pytest.mark.slow
def test_bp_slam_meets_its_own_test_bed() -> None:
    """Published: 0.08 m. Anchors are known, all else begins as lone distances with guesses all around."""
    entry, found = bp_slam_testbed.WORLD.entries[0], []
    (request,) = resolve({entry.estimator: dict(entry.options)}, (entry.estimator,))
    for trial in range(200, 204):
        recording = bp_slam_testbed.simulate(0, trial)
        found.append(score(recording, estimate(recording, request, np.random.default_rng(0)), None)["position_rmse_m"])
    assert np.median(found) < 0.08
