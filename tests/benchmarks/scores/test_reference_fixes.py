"""Fixes far off their neighbours are not compared with; those of sharp turns, halts and after outages are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import Scored, distance_m, errors_over_time, score
from cellslam.benchmarks.scores.reference_fixes import covariances_at_fixes, outlying, unled, usable
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings.importing.campaign import Campaign, ReferenceTable, build
from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.recordings.inspection.inspection import as_text, inspected
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.recording import Floats, Recording, Reference


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
    since_1970 = recording.time_s + 1248272270.0
    late = dataclasses.replace(recording, time_s=since_1970, reference=reference(position, since_1970[::5]))
    text = as_text(Path("a.h5"), late, inspected(late))
    assert "at 1248272286.5 s: left out" in text and "every 0.1 s (0.1 to 0.1 s)" in text


def drive(odometry_s: Floats, turns: float, noise_density: Sequence[float] = (0.0,) * 6) -> Recording:
    """Return a drive of 100 s at 0.75 m/s, so many turns in all; measured in the first and the last 10 s alone."""
    fixes_s = np.arange(0.5, 100.0, 1.0)
    rate = turns * 2.0 * np.pi / 100.0
    same = np.ones(len(odometry_s))
    odometry = OdometryTable(odometry_s, {"u_x": 0.75 * same, "u_psi": rate * same})
    # An arc of length s that has turned by a: s (sin a, 1 - cos a) / a.
    angle = rate * fixes_s
    ahead, aside = np.sinc(angle / np.pi), np.sin(angle / 2.0) * np.sinc(angle / (2.0 * np.pi))
    fixes = 0.75 * fixes_s[:, None] * np.column_stack([ahead, aside])
    measured_s = np.concatenate([np.arange(0.0, 10.0, 0.2), np.arange(90.0, 100.0, 0.2)])
    return build(
        Campaign(
            measured_s, {"distance_m": 50.0 + measured_s}, odometry, start_pose=(0.0,) * 6,
            reference=ReferenceTable(fixes_s, fixes, std_m=0.1), noise={"noise_density": noise_density},
        )
    )  # fmt: skip


def scored(recording: Recording) -> Scored:
    request = resolve({}, ["dead-reckoning"], ())[0]
    return Scored(recording, estimate(recording, request, np.random.default_rng(0)), None)


def test_in_a_pause_of_the_measurements_the_odometry_leads_to_the_fixes() -> None:
    errors = scored(drive(np.arange(0.0, 101.0, 0.05), turns=1.6)).errors
    assert len(errors.position) == 100 and errors.position.max() < 0.01


def test_a_fix_in_a_pause_of_the_odometry_is_left_out() -> None:
    times = np.arange(0.0, 101.0, 0.05)
    recording = drive(times[(times < 40.0) | (times > 50.0)], turns=1.6)
    known = recording.reference
    assert known is not None
    left = known.time_s[unled(recording, known)]
    assert left.min() == pytest.approx(40.5) and left.max() == pytest.approx(89.5)
    assert len(scored(recording).errors.position) == 100 - len(left)


def test_in_a_pause_the_claimed_covariance_grows_as_that_of_dead_reckoning() -> None:
    recording = drive(np.arange(0.0, 101.0, 0.05), turns=0.0, noise_density=[0.05, 0.05, 0.0, 0.01, 0.0, 0.0])
    known, result = recording.reference, scored(recording).result
    assert known is not None
    claimed = covariances_at_fixes(recording, known, usable(recording, known), result.poses, result.covariances)
    variance = np.trace(claimed[:, :2, :2], axis1=1, axis2=2)
    assert (np.diff(variance[:90]) > 0.0).all()
    assert variance[89] == pytest.approx(np.trace(result.covariances[50, :2, :2]), rel=0.05)
