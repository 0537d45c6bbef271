"""The scores of a claimed Gaussian: closed forms, and whom they rank first."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from cellslam.benchmarks.scores.belief import AS_CLAIMED, LEVELS, Claim, energy_score, log_score, squared_error
from cellslam.benchmarks.scores.metrics import METRIC, RISK, score
from cellslam.benchmarks.scores.trial_result import TrialResult

TILTED = np.array([[4.0, 1.5], [1.5, 1.0]])


def test_nees_with_correlation() -> None:
    e = np.array([1.0, -2.0])
    assert squared_error(e[None], TILTED[None])[0] == pytest.approx(e @ np.linalg.inv(TILTED) @ e)


def test_log_score_is_minus_the_logarithm_of_the_density() -> None:
    error = np.array([[1.0, -2.0], [0.0, 0.0]])
    claims = np.stack([TILTED, np.zeros((2, 2))])
    found = log_score(error, claims)
    assert found[0] == pytest.approx(-multivariate_normal.logpdf(error[0], cov=TILTED))
    assert math.isnan(found[1])  # a position that was claimed to be exact


@pytest.mark.parametrize("ratio", [1.0, 0.3, 0.1])
def test_energy_score_is_that_of_samples(ratio: float) -> None:
    rng, P, e = np.random.default_rng(1), np.diag([4.0, 4.0 * ratio**2]), np.array([1.2, -0.5 * ratio])
    X, Y = (rng.multivariate_normal(np.zeros(2), P, 200_000) for _ in range(2))
    expected = np.hypot(*(X - e).T).mean() - np.hypot(*(X - Y).T).mean() / 2.0
    assert energy_score(e[None], P[None])[0] == pytest.approx(expected, rel=0.01)


def test_a_radius_is_exceeded_as_often_as_it_says() -> None:
    assert AS_CLAIMED.radius(np.eye(2)[None], 1e-3)[0] == pytest.approx(math.sqrt(-2.0 * math.log(1e-3)))
    line = np.diag([9.0, 0.0])[None]
    assert AS_CLAIMED.radius(line, 1e-3)[0] == pytest.approx(3.0 * 3.2905, rel=1e-4)
    assert AS_CLAIMED.half_width(np.array([9.0]), 1e-3)[0] == pytest.approx(3.0 * 3.2905, rel=1e-4)
    rng, n, risk = np.random.default_rng(2), 400_000, 0.01
    wide = Claim(1.5, 4.0)
    for claim, drawn in (
        (AS_CLAIMED, rng.multivariate_normal(np.zeros(2), TILTED, n)),
        (wide, multivariate_t.rvs(np.zeros(2), 1.5**2 * TILTED, 4.0, n, random_state=rng)),
    ):
        assert (np.hypot(*drawn.T) > claim.radius(TILTED[None], risk)).mean() == pytest.approx(risk, rel=0.05)
        assert (np.abs(drawn[:, 0]) > claim.half_width(TILTED[None, 0, 0], risk)).mean() == pytest.approx(
            risk, rel=0.05
        )
        squared = np.einsum("ni,ij,nj->n", drawn, np.linalg.inv(TILTED), drawn)
        assert (squared > 9.0).mean() == pytest.approx(float(claim.beyond(np.array([9.0]))[0]), rel=0.05)


def claiming(recording: Any, factor: float) -> TrialResult:
    """The answers of an estimator that knows how wrong it is, with its covariances times a factor."""
    rng, truth, count = np.random.default_rng(5), recording.truth, len(recording.time_s)
    covariance = np.diag([0.0, 0.0, 1.0, 0.01, 1e-4, 1e-4])
    covariance[:2, :2] = TILTED
    offsets = truth.clock_offsets_at(recording.elapsed_s)
    return TrialResult(
        "mine",
        truth.poses + rng.multivariate_normal(np.zeros(6), covariance, count),
        np.tile(factor * covariance, (count, 1, 1)),
        clock_offset_m=offsets + 0.5 * rng.standard_normal(offsets.shape),
        clock_offset_variance_m2=np.full(offsets.shape, factor * 0.25),
    )


def test_every_score_ranks_too_bold_and_too_timid_a_claim_below_an_honest_one(make_recording: Any) -> None:
    recording = make_recording(seed=1, snapshots=2000)
    bold, honest, timid = (score(recording, claiming(recording, factor), None) for factor in (0.25, 1.0, 4.0))
    for key in ("log_score", "energy_score_m"):
        assert honest[key] < bold[key] and honest[key] < timid[key]
    for key in ("coverage", "heading_coverage", "clock_coverage"):
        for level in LEVELS:
            mine = [abs(one[f"{key}_{100 * level:g}"] - level) for one in (bold, honest, timid)]
            assert mine[1] < 0.02 < min(mine[0], mine[2]) or (level == 0.99 and mine[1] < mine[2] < mine[0])
    for way in ("", "_along", "_across"):
        # An error beyond the protection level is dear; a protection level that need not be so wide is, too.
        assert honest[f"misleading{way}"] < 0.004 < bold[f"misleading{way}"] and timid[f"misleading{way}"] == 0.0
        assert timid[f"protection{way}_m"] == pytest.approx(2.0 * honest[f"protection{way}_m"])
    assert honest["claimed_95_m"] == pytest.approx(AS_CLAIMED.radius(TILTED[None], 0.05)[0])
    assert bold["availability"] >= honest["availability"] >= timid["availability"]
    assert 0.0 < RISK < 0.01


def test_along_is_where_the_vehicle_heads(make_recording: Any) -> None:
    recording = make_recording(seed=2, snapshots=300)
    heading = recording.truth.poses[:, 3]
    count, along = len(heading), np.stack([np.cos(heading), np.sin(heading)], axis=1)
    covariance = np.tile(np.eye(6), (count, 1, 1))
    covariance[:, :2, :2] += 8.0 * along[:, :, None] * along[:, None]
    poses = recording.truth.poses.copy()
    poses[:, :2] += 5.0 * along  # within three claimed deviations
    scores = score(recording, TrialResult("mine", poses, covariance), None)
    assert scores["protection_along_m"] == pytest.approx(3.0 * scores["protection_across_m"])
    assert scores["misleading_along"] == scores["misleading_across"] == 0.0
    poses[:, :2] += 5.0 * along[:, ::-1] * [-1.0, 1.0]
    scores = score(recording, TrialResult("mine", poses, covariance), None)
    assert scores["misleading_along"] == 0.0 and scores["misleading_across"] == 1.0


def test_a_smoother_claims_nothing(make_recording: Any) -> None:
    recording = make_recording(seed=3, snapshots=50)
    scores = score(recording, dataclasses.replace(claiming(recording, 1.0), smoothed=True), None)
    new = [
        key for key in METRIC if key.startswith(("coverage", "misleading", "protection", "log_", "energy", "claimed"))
    ]
    assert len(new) == 13 and {scores[key] for key in new} == {None}
    assert scores["position_rmse_m"] is not None


@pytest.mark.slow
def test_scores_take_milliseconds(make_recording: Any) -> None:
    recording = make_recording(seed=4, snapshots=5000)
    result = claiming(recording, 1.0)
    score(recording, result, None)
    begin = time.perf_counter()
    score(recording, result, None)
    assert time.perf_counter() - begin < 0.2
