"""Fixes far off their neighbours are not compared with; those of sharp turns, halts and after outages are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import distance_m, errors_over_time, score
from cellslam.benchmarks.scores.reference_fixes import outlying
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.recordings.inspection.inspection import inspected
from cellslam.sim.recording import Recording, Reference


def reference(position: np.ndarray, time_s: np.ndarray) -> Reference:
    unknown = np.full(len(time_s), np.nan)
    return Reference(time_s, np.column_stack([position, unknown]), unknown, unknown)


def there_and_back(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """10 m/s ahead, a U-turn on the spot, a halt, an outage of 300 m, a corner; fixes at 1 Hz, +-0.5 m."""
    out = np.column_stack([10.0 * np.arange(40.0), np.zeros(40)])
    halt = np.tile(out[5], (20, 1))
    after = np.column_stack([np.full(40, 300.0), 10.0 * np.arange(40.0)])
    corner = np.column_stack([300.0 - 10.0 * np.arange(1.0, 20.0), np.full(19, 390.0)])
    way = np.concatenate([out, out[-2:5:-1], halt, after, corner])
    time_s = np.arange(float(len(way))) + 30.0 * (np.arange(len(way)) >= 93)
    return way + 0.5 * rng.standard_normal(way.shape), time_s


def test_only_what_jumps_is_outlying() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        way, time_s = there_and_back(rng)
        assert not outlying(reference(way, time_s)).any(), seed
        wrong = [12, 70, 71, 93, len(way) - 1]
        way[wrong] += 138.0 * np.array([0.6, -0.8])
        way[30] = np.nan
        assert np.flatnonzero(outlying(reference(way, time_s))).tolist() == wrong, seed


def test_an_outlier_spoils_neither_scores_nor_figures(toy_recording: Callable[..., Recording]) -> None:
    recording = toy_recording(snapshots=400, truth=False)
    poses = np.zeros((400, 6))
    poses[:, 0] = 3.0 * recording.time_s
    position = np.column_stack([poses[::5, 0], np.full(80, 2.0)])
    position[33] += 138.0
    recording = dataclasses.replace(recording, reference=reference(position, recording.time_s[::5]))
    scores = score(recording, TrialResult("toy", poses, np.tile(np.eye(6), (400, 1, 1))), None)
    assert (scores["position_rmse_m"], scores["position_max_m"]) == pytest.approx((2.0, 2.0))
    curve = errors_over_time(recording, poses)
    assert curve is not None and len(curve[0]) == 79 and curve[1].max() == pytest.approx(2.0)
    assert distance_m(recording) == pytest.approx(3.0 * 39.5, abs=1.5)
    assert inspected(recording)["reference"]["outlying_at_s"] == [16.5]
