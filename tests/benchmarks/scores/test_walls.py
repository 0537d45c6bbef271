"""Scores of walls, by worked numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cellslam.benchmarks.scores.alignment import aligned
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.scores.walls import Walls, hausdorff, true_walls
from cellslam.slam.api import WallEstimate

NORTH = np.pi / 2


@pytest.fixture
def one_wall(make_recording):
    """Sites at x = 0 and x = 60 m, whose paths to a vehicle at (20, 0) a wall at y = 10 m reflects at x = 10 and 40."""
    recording = make_recording(seed=1, sites=2, ports=2, vts_per_site=2, snapshots=60, detection=0.9)
    sites = np.array([[0.0, 0, 30], [60.0, 0, 30]])
    images = sites + np.array([0.0, 20, 0])
    truth = recording.truth
    position = np.where((truth.vts.order == 0)[:, None], sites[truth.vts.site], images[truth.vts.site])
    facets = np.where((truth.vts.order == 0)[:, None], -1, [[3, -1]])
    poses = np.zeros_like(truth.poses)
    poses[:, 0] = 20.0
    vts = dataclasses.replace(truth.vts, position_m=position, facets=facets)
    return dataclasses.replace(
        recording, truth=dataclasses.replace(truth, vts=vts, site_positions_m=sites, poses=poses)
    )


def walls(*of):
    """Return estimated walls of azimuth, distance, begin and end along them."""
    of = np.array(of, float).reshape(-1, 4)
    return WallEstimate(np.arange(len(of)), of[:, 0], of[:, 1], np.tile(np.eye(2), (len(of), 1, 1)), of[:, 2:])


def scores_of(recording, *of):
    count = len(recording.time_s)
    result = TrialResult("mapper", recording.truth.poses, np.tile(np.eye(6), (count, 1, 1)), walls=walls(*of))
    return {key[5:]: value for key, value in score(recording, result, None).items() if key.startswith("wall_")}


def test_two_sites_show_one_wall(one_wall):
    true = true_walls(one_wall, one_wall.truth)
    np.testing.assert_allclose(true.azimuth_rad, [NORTH])
    np.testing.assert_allclose(np.sort(true.ends_m[0], axis=0), [[10, 10], [40, 10]], atol=1e-9)


def test_worked_numbers(one_wall):
    # Along a wall that faces north counts what is to the west.
    perfect = scores_of(one_wall, (NORTH, 10.0, -40.0, -10.0))
    assert perfect == pytest.approx({"gospa_m": 0, "share": 1, "normal_rmse_rad": 0, "offset_rmse_m": 0}, abs=1e-9)
    shifted = scores_of(one_wall, (NORTH, 12.0, -40.0, -10.0))
    assert shifted == pytest.approx({"gospa_m": 2, "share": 1, "normal_rmse_rad": 0, "offset_rmse_m": 2}, abs=1e-9)
    # The half of it: the end of the other half is 15 m away. A second one is 6 m off: a false one, that maps nothing.
    half = scores_of(one_wall, (NORTH, 10.0, -25.0, -10.0), (NORTH, 16.0, -40.0, -25.0))
    assert half == pytest.approx(
        {"gospa_m": np.sqrt(15**2 + 20**2 / 2), "share": 0.5, "normal_rmse_rad": 0, "offset_rmse_m": 0}, abs=1e-9
    )
    # Turned by 3 degrees about the middle of the wall, (25, 10), and as long.
    turn = np.radians(3.0)
    across, along = np.array([-np.sin(turn), np.cos(turn)]), -np.array([np.cos(turn), np.sin(turn)])
    middle = np.array([25.0, 10.0])
    turned = scores_of(one_wall, (NORTH + turn, across @ middle, along @ middle - 15, along @ middle + 15))
    assert turned["normal_rmse_rad"] == pytest.approx(turn) and turned["offset_rmse_m"] == pytest.approx(0, abs=1e-9)
    assert turned["gospa_m"] == pytest.approx(15 * np.sin(turn))


def test_a_wall_that_faces_the_other_way_maps_nothing(one_wall):
    assert scores_of(one_wall, (-NORTH, -10.0, 10.0, 40.0))["share"] == 0.0


def test_without_walls(one_wall):
    missing = {"share": 0.0, "normal_rmse_rad": None, "offset_rmse_m": None}
    assert scores_of(one_wall) == {"gospa_m": pytest.approx(np.sqrt(200)), **missing}


@pytest.mark.parametrize(("gap_m", "off_m", "count"), [(9.0, 0.4, 1), (11.0, 0.0, 2), (0.0, 0.6, 2)])
def test_facets_in_one_plane_are_one_wall(one_wall, gap_m, off_m, count):
    truth = one_wall.truth
    second = (truth.vts.order == 1) & (truth.vts.site == 1)
    facets, position, sites = (a.copy() for a in (truth.vts.facets, truth.vts.position_m, truth.site_positions_m))
    facets[second, 0] = 4
    position[second] = [2 * (10.0 + gap_m) - 20.0, 2 * (10.0 + off_m), 30.0]
    sites[1, 0] = 2 * (10.0 + gap_m) - 20.0
    vts = dataclasses.replace(truth.vts, facets=facets, position_m=position)
    assert len(true_walls(one_wall, dataclasses.replace(truth, vts=vts, site_positions_m=sites))) == count


def test_distance_of_segments_is_that_of_their_points():
    rng = np.random.default_rng(4)
    ends = rng.uniform(0, 30, (2, 5, 2, 2))
    a, b = (Walls(np.arctan2(*(e[:, 1] - e[:, 0]).T), e) for e in ends)
    share = np.linspace(0, 1, 401)[:, None]
    for i in range(5):
        for j in range(5):
            p, q = (e[0] + share * (e[1] - e[0]) for e in (a.ends_m[i], b.ends_m[j]))
            apart = np.linalg.norm(p[:, None] - q, axis=-1)
            expected = max(apart.min(axis=1).max(), apart.min(axis=0).max())
            assert hausdorff(a, b)[i, j] == pytest.approx(expected, abs=0.1)


def test_walls_move_with_the_estimate_that_is_aligned(one_wall):
    poses = one_wall.truth.poses.copy()
    poses[:, 0] += np.linspace(0.0, 5.0, len(poses))
    drive = dataclasses.replace(one_wall, truth=dataclasses.replace(one_wall.truth, poses=poses))
    turn, shift = np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([3.0, -8.0])
    found = walls((NORTH, 10.0, -40.0, -10.0))
    true_ends, away = found.ends_m, poses.copy()
    away[:, :2] = (poses[:, :2] - shift) @ turn  # what alignment has to undo
    ends = (true_ends - shift) @ turn
    across = np.array([1.0, 0.0])
    moved = walls((0.0, ends[0, 0] @ across, *np.sort(ends[0, :, 1])))
    result = TrialResult("mapper", away, np.tile(np.eye(6), (len(poses), 1, 1)), walls=moved)
    back = aligned(drive, result).walls
    np.testing.assert_allclose(np.sort(back.ends_m[0], axis=0), np.sort(true_ends[0], axis=0), atol=1e-6)
    # A turn of the wall about the origin of the world moves it where it is far from there.
    np.testing.assert_allclose(back.covariance[0], np.array([[1.0, -3.0], [-3.0, 10.0]]), atol=1e-6)
