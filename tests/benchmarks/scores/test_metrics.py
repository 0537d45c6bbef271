"""The scores by worked numbers, and what is null when."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest

from cellslam.benchmarks.bound.cramer_rao import BoundResult
from cellslam.benchmarks.scores.map_scores import precision_recall, stand_for, tracks_of
from cellslam.benchmarks.scores.metrics import METRIC_KEYS, distance_m, score
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.scores.walls import true_walls
from cellslam.slam.api import VtEstimate, WallEstimate
from cellslam.slam.model.walls import normals


def perfect(recording):
    """The result of an estimator that knows everything."""
    truth, m = recording.truth, recording.measurements
    pairs = np.unique(np.column_stack([m.link, truth.measurement_vt])[truth.measurement_vt >= 0], axis=0)
    seen = [((m.link == link) & (truth.measurement_vt == vt)).sum() >= 20 for link, vt in pairs]
    link, vt = pairs[seen].T
    count = len(recording.time_s)
    return TrialResult(
        estimator="perfect",
        poses=truth.poses,
        covariances=np.tile(0.5 * np.eye(6), (count, 1, 1)),
        association=truth.measurement_vt,
        clock_offset_m=np.tile(truth.clock_offsets_m, (count, 1)),
        clock_offset_variance_m2=np.ones((count, len(recording.sites))),
        vts=VtEstimate(vt, link, truth.vts.position_m[vt], np.tile(np.eye(3), (len(vt), 1, 1))),
        walls=perfect_walls(recording),
    )


def perfect_walls(recording):
    true = true_walls(recording, recording.truth)
    across, along = normals(true.azimuth_rad)
    extent = np.sort((true.ends_m * along[:, None]).sum(axis=-1), axis=1)
    distance, exact = (true.ends_m[:, 0] * across).sum(axis=-1), np.zeros((len(true), 2, 2))
    return WallEstimate(np.arange(len(true)), true.azimuth_rad, distance, exact, extent)


def test_a_perfect_estimate_scores_perfectly(make_recording):
    recording = make_recording(seed=1)
    bound = BoundResult(
        np.tile(np.diag([9.0, 16.0, 0, 0, 0, 0]), (200, 1, 1)), np.zeros((200, 2)), np.zeros((200, 6)), 6.0
    )
    scores = score(recording, perfect(recording), bound)
    assert tuple(scores) == METRIC_KEYS
    assert scores["bound_position_rmse_m"] == pytest.approx(5.0) and scores["bound_merged_m"] == 6.0
    one = {"association_precision", "association_recall", "wall_share", "availability"}
    one |= {key for key in METRIC_KEYS if "coverage" in key}
    assert {key: scores[key] for key in one} == dict.fromkeys(one, 1.0)
    assert scores["map_rmse_m"] is scores["bound_map_m"] is None  # this bound is of the position alone
    sizes = {"map_rmse_m", "bound_map_m"} | {
        key for key in METRIC_KEYS if key.startswith(("protection", "claimed", "log_score", "energy_score"))
    }
    zero = set(METRIC_KEYS) - {"bound_position_rmse_m", "bound_merged_m", *one, *sizes}
    assert {key: scores[key] for key in zero} == pytest.approx(dict.fromkeys(zero, 0.0), abs=1e-9)


def test_shifted_estimate_by_worked_numbers(make_recording):
    recording = make_recording(seed=2, snapshots=4)
    result = perfect(recording)
    shift = np.zeros((4, 6))
    shift[:, :4] = [[0, 0, 100, 2 * np.pi], [3, 4, 100, 0.2], [0, 0, 100, -2 * np.pi + 0.2], [3, -4, 100, 0]]
    covariances = np.tile(np.diag([1.0, 4.0, 1, 1, 1, 1]), (4, 1, 1))
    covariances[0] = 0
    offsets = result.clock_offset_m + 99.0
    offsets[-1] = np.add(recording.truth.clock_offsets_m, [3.0, -4.0])
    poses = result.poses + shift
    changed = dataclasses.replace(result, poses=poses, covariances=covariances, clock_offset_m=offsets)
    expected = {
        "position_rmse_m": np.sqrt(50 / 4), "position_max_m": 5.0, "position_end_m": 5.0,
        "heading_rmse_rad": np.sqrt(0.08 / 4), "clock_offset_rmse_m": np.sqrt(12.5),
        # The first snapshot has a singular covariance and does not count: (9 + 16/4, 0, 9 + 16/4) / 3.
        "nees_mean": 26 / 3,
    }  # fmt: skip
    scores = score(recording, changed, None)
    assert {key: scores[key] for key in expected} == pytest.approx(expected)
    assert scores["bound_position_rmse_m"] is None


def test_without_truth_nothing_applies(make_recording):
    recording = make_recording(seed=3, snapshots=50)
    bare = dataclasses.replace(recording, truth=None)
    assert set(score(bare, perfect(recording), None).values()) == {None}
    assert distance_m(bare) is None


def test_association_by_worked_numbers():
    #                    VT 5 of link 0 has id 7; id 8 took one of its measurements and two of VT 6
    link = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1])
    true = np.array([5, 5, 5, -1, 5, 6, 6, 6, 5, -1, 5])
    said = np.array([7, 7, -1, 7, 8, 8, 8, -1, 7, 9, 9])
    tracks = tracks_of(link, said, true)
    # Link, id, VT, count. Id 9 has one measurement of VT 5 and one of clutter: the tie goes to the VT.
    expected = [(0, 7, 5, 3), (0, 8, 6, 3), (1, 7, 5, 1), (1, 9, 5, 2)]
    assert list(zip(tracks.link, tracks.id, tracks.stands_for, tracks.count, strict=True)) == expected
    # Right: two of id 7 and two of id 8 on link 0, one of id 7 and one of id 9 on link 1.
    assert precision_recall(tracks, true) == pytest.approx((6 / 9, 6 / 9))


def test_what_stands_for_nothing_is_never_right():
    def of(said, true):
        said, true = np.array(said, np.int64), np.array(true, np.int64)
        return precision_recall(tracks_of(np.zeros(len(said), np.int64), said, true), true)

    assert of([3, 3, 3, -1], [-1, -1, 0, 0]) == (0.0, 0.0)  # a track of clutter
    assert of([-1, -1, -1], [-1, 0, 0]) == (None, 0.0)
    assert of([-1], [-1]) == of([], []) == (None, None)


def test_transmitter_error_takes_the_track_with_most_measurements(make_recording):
    recording = make_recording(seed=4, sites=1, ports=1, vts_per_site=1, snapshots=100, clutter=0.0, detection=1.0)
    count, site = len(recording.measurements), recording.truth.site_positions_m[0]
    association = np.where(np.arange(count) < count // 3, 1, 2)
    position = site + np.array([[50, 0, 0], [0, 3, 4], [0, 0, 0]])
    # Once the second is dropped, the first stands for the site; without any the score is null.
    for ids, expected in (((1, 2, 2), 5.0), ((1, 3, 2), 50.0), ((4, 3, 2), None)):
        vts = VtEstimate(np.array(ids), np.array([0, 0, 9]), position, np.tile(np.eye(3), (3, 1, 1)))
        result = dataclasses.replace(perfect(recording), association=association, vts=vts)
        assert score(recording, result, None)["transmitter_rmse_m"] == (expected and pytest.approx(expected))


def test_links_of_a_site_may_share_a_map(make_recording):
    """VTs that are reported under one link of a site count for its others, unless these have a map of their own."""
    recording = make_recording(seed=5, sites=2, ports=2, vts_per_site=3, snapshots=60)
    whole = perfect(recording)
    assert whole.vts is not None
    site = recording.links.site
    assert list(site) == [0, 0, 1, 1]

    def of(kept):
        vts = VtEstimate(
            *(getattr(whole.vts, n)[np.isin(whole.vts.link, kept)] for n in ("id", "link", "position_m", "covariance"))
        )
        return score(recording, dataclasses.replace(whole, vts=vts), None)["map_gospa_m"]

    missed = [np.sqrt(200.0 * (whole.vts.link == link).sum()) for link in range(4)]
    assert of([0, 1, 2, 3]) == of([0, 2]) == of([1, 3]) == 0.0
    assert of([0, 1]) == pytest.approx((missed[2] + missed[3]) / 4)
    alone = dataclasses.replace(whole.vts, position_m=whole.vts.position_m + 1e3 * (whole.vts.link == 1)[:, None])
    far = score(recording, dataclasses.replace(whole, vts=alone), None)["map_gospa_m"]
    assert far == pytest.approx(np.sqrt(2.0) * missed[1] / 4)


def test_scatterers_are_compared_with_scatterers_and_mirror_images_with_mirror_images(make_recording):
    recording = make_recording(seed=5, sites=1, ports=1, vts_per_site=4, snapshots=60, clutter=0.0)
    kind = np.array([0, 0, 1, 1])
    truth = dataclasses.replace(recording.truth, vts=dataclasses.replace(recording.truth.vts, scatterer=kind))
    recording = dataclasses.replace(recording, truth=truth)
    whole = perfect(recording)
    assert whole.vts.id.tolist() == [0, 1, 2, 3]
    for found, wrong in ((kind, 0), (1 - kind, 4), (np.array([0, 1, 1, 1]), 1), (None, 2)):
        vts = dataclasses.replace(whole.vts, scatterer=found)
        result = dataclasses.replace(whole, vts=vts)
        # Each is a truth missed and a false estimate.
        assert score(recording, result, None)["map_gospa_m"] == pytest.approx(np.sqrt(wrong * 400.0))
        same = kind == (np.zeros(4) if found is None else found)
        assert stand_for(recording, vts, whole.association).tolist() == np.where(same, np.arange(4), -1).tolist()


def test_association_of_a_hundred_thousand_measurements_is_fast():
    rng, count = np.random.default_rng(8), 100_000
    link, true = rng.integers(0, 12, count), rng.integers(-1, 40, count)
    said = np.where(rng.random(count) < 0.9, true + 1, -1)
    begin = time.perf_counter()
    precision, recall = precision_recall(tracks_of(link, said, true), true)
    assert time.perf_counter() - begin < 1.0
    assert recall == pytest.approx(0.9, abs=0.01) and precision is not None
