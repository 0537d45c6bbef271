from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pandas as pd
import pytest

from cellslam.benchmarks import run
from cellslam.benchmarks.scores import metrics
from cellslam.benchmarks.scores.metrics import COST_KEYS, ROW_KEYS
from cellslam.benchmarks.trials import estimation, trials
from cellslam.benchmarks.trials.trials import Trial, score_recording
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.loading import load
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from tests.benchmarks.trials.hostile_estimators import Good, raising
from tests.short_drive import SET

Toy = Callable[..., Recording]


class Full(Good):
    """Answers everything that can be answered."""

    def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Estimate:
        belief = super().step(dt_s, odometry, snapshot)
        vts = VtEstimate(np.arange(2), np.array([0, 3]), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)))
        return dataclasses.replace(
            belief,
            association=np.asarray(snapshot.link),
            clock_offset_m=np.full(2, float(snapshot.index)),
            clock_offset_variance_m2=np.ones(2),
            vts=vts if snapshot.index == 39 else None,
        )


def scored(recording: Recording, *estimators: type[Any], seed: int = 4, trial: int = 2) -> Trial:
    requests = [Request(one.__name__.lower(), one, None) for one in estimators]
    return score_recording(recording, "toy", requests, trial, seed)


def without_costs(row: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in row.items() if k not in COST_KEYS}


def test_row_has_the_keys_and_is_plain_json(toy_recording: Toy) -> None:
    (plain, full) = (outcome.row for outcome in scored(toy_recording(), Good, Full).outcomes)
    for row in (plain, full):
        assert tuple(row) == ROW_KEYS
        assert json.loads(json.dumps(row, allow_nan=False)) == row
    named = {"scenario": "toy", "estimator": "good", "trial": 2, "seed": 4, "status": "ok", "error": None}
    unknown = dict.fromkeys(("clock_offset_rmse_m", "map_gospa_m", "wall_share", "association_recall"))
    assert plain.items() >= {**named, **unknown, "snapshots": 40}.items()
    assert (plain["duration_s"], plain["distance_m"]) == pytest.approx((4.0, 3.9), rel=1e-3)
    assert plain["bound_position_rmse_m"] > 0
    assert full["clock_offset_rmse_m"] is not None and full["association_recall"] is not None


def test_what_is_not_finite_becomes_null(toy_recording: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"position_rmse_m": np.float64(np.nan), "position_max_m": np.inf, "position_end_m": np.float64(1)}
    monkeypatch.setattr(metrics, "score", lambda *_: scores)
    row = scored(toy_recording(), Good).outcomes[0].row
    assert (row["position_rmse_m"], row["position_max_m"], row["position_end_m"]) == (None, None, 1.0)
    assert type(row["position_end_m"]) is float


def test_answers_are_collected_in_the_order_of_the_recording(toy_recording: Toy) -> None:
    recording = toy_recording()
    result = scored(recording, Full).outcomes[0].result
    assert result is not None
    np.testing.assert_array_equal(result.association, recording.measurements.link)
    np.testing.assert_array_equal(result.clock_offset_m[:, 1], np.arange(40.0))
    assert len(result.vts.id) == 2 and not result.smoothed


def test_same_seed_and_trial_same_draws(toy_recording: Toy) -> None:
    recording = toy_recording()
    first, again = (without_costs(o.row) for o in scored(recording, Good, Good).outcomes)
    assert first == again
    others = (scored(recording, Good, seed=5), scored(recording, Good, trial=3))
    assert len({first["position_rmse_m"], *(t.outcomes[0].row["position_rmse_m"] for t in others)}) == 3


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="this system cannot tell")
def test_runner_says_how_much_memory_the_estimator_took(toy_recording: Toy) -> None:
    class Large(Good):
        def start(self, setup: Setup, rng: np.random.Generator) -> None:
            super().start(setup, rng)
            np.ones(25_000_000)  # 200 MB, let go at once

    before, large, after = (o.row["peak_memory_mb"] for o in scored(toy_recording(), Good, Large, Good).outcomes)
    assert large == pytest.approx(200.0, abs=10.0) and before < 10.0 and after < 10.0


def test_runner_takes_the_time_of_the_estimator_alone(toy_recording: Toy, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]

    class Slow(Good):
        def warm_up(self) -> None:
            clock[0] += 1000.0

        def start(self, setup: Setup, rng: np.random.Generator) -> None:
            super().start(setup, rng)
            clock[0] += 2.0

        def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Estimate:
            clock[0] += 0.25
            return super().step(dt_s, odometry, snapshot)

        def finish(self) -> Any:
            clock[0] += 4.0
            return np.tile(self.pose, (40, 1))

    monkeypatch.setattr(estimation.time, "perf_counter", lambda: clock[0])
    outcome = scored(toy_recording(), Slow).outcomes[0]
    assert outcome.row["estimate_seconds"] == 2.0 + 40 * 0.25 + 4.0
    assert outcome.row["realtime_factor"] == pytest.approx(4.0 / 16.0)
    assert outcome.result is not None and outcome.result.smoothed
    assert np.ptp(outcome.result.poses, axis=0).max() == 0.0


def test_observables_only_and_read_only(toy_recording: Toy) -> None:
    recording, seen = toy_recording(), list[Any]()

    class Curious(Good):
        def step(self, dt_s: float, odometry: Any, snapshot: Snapshot) -> Estimate:
            seen.append(self.setup.truth)
            recorded = (recording.odometry, recording.measurements.distance_m, recording.start_pose)
            given = (odometry, snapshot.distance_m, self.setup.start_pose)
            for array, original in zip(given, recorded, strict=True):
                with pytest.raises(ValueError, match="read-only"):
                    array[...] = 0.0
                assert not np.shares_memory(array, original)
            return super().step(dt_s, odometry, snapshot)

    class Oracle(Curious):
        requires_truth = True

    curious, oracle = scored(recording, Curious, Oracle).outcomes
    assert (curious.row["status"], oracle.row["status"]) == ("ok", "ok")
    assert seen[0] is None and seen[-1] is not None
    assert oracle.result is not None and oracle.result.oracle


class Raises(Good):
    odd = raising(ZeroDivisionError("no such\nthing"))


def test_an_estimator_that_fails_costs_its_own_row_only(toy_recording: Toy) -> None:
    """How else it may fail: test_hostile.py."""
    bad, good = scored(toy_recording(), Raises, Good).outcomes
    assert tuple(bad.row) == ROW_KEYS
    assert (bad.row["status"], bad.row["position_rmse_m"], bad.row["snapshots"]) == ("failed", None, 40)
    assert "\n" not in bad.row["error"] and "Traceback" in bad.traceback
    for words in ("ZeroDivisionError: no such thing, snapshot 5", "hostile_estimators.py, line", "in odd"):
        assert words in bad.row["error"]
    assert without_costs(good.row) == without_costs(scored(toy_recording(), Good).outcomes[0].row)


def test_any_error_in_the_world_of_any_trial_costs_that_trial(monkeypatch: pytest.MonkeyPatch) -> None:
    real = trials.simulate

    def simulate(scenario: Any, seed: int, trial: int, **more: Any) -> Recording:
        return real(scenario, seed, trial, **more) if trial == 1 else 1 // 0

    monkeypatch.setattr(trials, "simulate", simulate)
    overrides = {**SET, "estimator.fastslam.particles": 5}
    frame = run("tiny", ["dead-reckoning", "fastslam"], 2, overrides=overrides, on_error="row")
    assert frame["status"].tolist() == ["failed", "failed", "ok", "ok"]
    for error in frame["error"][:2]:
        assert error.startswith("the world cannot be made: ZeroDivisionError") and "\n" not in error


def test_without_truth_there_are_no_scores(toy_recording: Toy) -> None:
    trial = scored(toy_recording(truth=False), Full)
    row = trial.outcomes[0].row
    assert trial.drive.bound is None and row["status"] == "ok"
    assert (row["distance_m"], row["position_rmse_m"], row["bound_position_rmse_m"]) == (None, None, None)
    assert row["realtime_factor"] > 0


def test_same_rows_on_any_number_of_threads() -> None:
    assert numba.config.NUMBA_NUM_THREADS >= 2, "one core: this cannot be tested"
    before, found = numba.get_num_threads(), []
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            frame = run("tiny", ["fastslam"], 1, 5, {**SET, "estimator.fastslam.particles": 50})
            found.append(frame.drop(columns=list(COST_KEYS)))
    finally:
        numba.set_num_threads(before)
    pd.testing.assert_frame_equal(*found, check_exact=True)


def test_a_scenario_that_is_loaded_takes_no_overrides() -> None:
    with pytest.raises(InputError, match="already loaded"):
        run(load("tiny"), overrides={"radio.load": 0.1})
