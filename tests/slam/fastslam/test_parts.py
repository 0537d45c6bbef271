"""The parts of FastSLAM: what the built-in ones return, names and errors, and the module of the documentation."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cellslam.benchmarks.trials.failures import explained
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Sites
from cellslam.slam.fastslam import parts
from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts import BUILT_IN, NO_VT, Candidates, Transmitters
from tests.slam.fastslam.drives import SHORT, driven, street

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "replace-parts-of-fastslam.md"
OWN = {
    "association": "least_distance", "birth": "patient", "proposal": "quasi_random", "update": "half_gain",
    "weight": "StudentT", "pruning": "two_minutes", "resampling": "better_half",
}  # fmt: skip


def candidates(log_ratio: Any, distance2: Any = None) -> Candidates:
    ratio = np.array(log_ratio, float)
    return Candidates(ratio, np.where(ratio > -np.inf, -ratio, np.inf) if distance2 is None else np.array(distance2),
                      np.full(len(ratio), 9))  # fmt: skip


def test_maximum_likelihood_takes_the_best_sum() -> None:
    crossed = candidates([[5.0, 4.0, -np.inf], [4.5, -np.inf, -2.0]])
    np.testing.assert_array_equal(parts.maximum_likelihood(crossed), [[1, 0, NO_VT]])
    assert parts.maximum_likelihood(candidates(np.full((2, 1), -np.inf)))[0, 0] == NO_VT


def test_nearest_neighbour_takes_the_least_distance_first() -> None:
    near = candidates(np.zeros((2, 3)), [[1.0, 2.0, np.inf], [1.5, 9.0, np.inf]])
    np.testing.assert_array_equal(parts.nearest_neighbour(near), [[0, 1, NO_VT]])


def test_second_hypothesis_is_the_second_best_assignment() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        score = rng.uniform(-3.0, 8.0, (3, 2))
        found = parts.hypotheses(candidates(score))
        every = sorted(
            (
                (sum(max(score[v, k], 0.0) for k, v in enumerate(one) if v >= 0), one)
                for one in np.ndindex(4, 4)
                for one in [tuple(v - 1 for v in one)]
                if one[0] != one[1] or one[0] < 0
                if all(v < 0 or score[v, k] > 0.0 for k, v in enumerate(one))
            ),
            reverse=True,
        )  # fmt: skip
        assert tuple(found[0].tolist()) == every[0][1]
        rivals = [one for one in every[1:] if every[0][0] - one[0] <= parts.RIVAL]
        assert len(found) == (2 if rivals else 1)
        if rivals:
            assert tuple(found[1].tolist()) == rivals[0][1]


def test_births() -> None:
    given = candidates([[3.0, 2.0, -np.inf]])
    np.testing.assert_array_equal(parts.outside_gates(given, np.array([0, NO_VT, NO_VT])), [False, False, True])
    np.testing.assert_array_equal(parts.unassigned(given, np.array([0, NO_VT, NO_VT])), [False, True, True])


@pytest.mark.parametrize("name", list(BUILT_IN["proposal"]))
def test_proposals_have_the_moments_that_are_asked_for(name: str) -> None:
    covariance, mean = np.array([[2.0, 0.6], [0.6, 0.5]]), np.tile([[1.0], [-2.0]], 40_000)
    draws, log_ratio = BUILT_IN["proposal"][name](mean, covariance, np.random.default_rng(1))
    assert not log_ratio.any()
    np.testing.assert_allclose(draws.mean(axis=1), [1.0, -2.0], atol=5.0 * np.sqrt(2.0 / 40_000))
    np.testing.assert_allclose(np.cov(draws), covariance, atol=0.05)


def test_weights_and_updates() -> None:
    W, G = np.array([[0.0, 3.0], [1.0, -4.0]]), np.eye(2)
    np.testing.assert_allclose(parts.likelihood(W), [-0.5, -12.5])
    np.testing.assert_allclose(parts.Tempered(0.5)(W), [-0.25, -6.25])
    assert parts.kalman(G, W) == (G, W) or parts.kalman(G, W)[1] is W
    np.testing.assert_array_equal(parts.bounded(G, W)[1], [[0.0, 3.0], [1.0, -3.0]])


def test_pruning() -> None:
    vts = Transmitters(
        detections=np.array([1, 3, 9]), unseen_s=np.array([2.0, 2.0, 99.0]), lifetime_s=np.array([1.0, 4.0, 4.0]),
        confirmed=np.array([False, False, True]),
    )  # fmt: skip
    np.testing.assert_array_equal(parts.unlikely(vts), [True, False, False])
    assert not parts.never(vts).any()


@pytest.mark.parametrize("slot, name", [(slot, name) for slot, some in BUILT_IN.items() for name in list(some)[1:]])
def test_each_built_in_part_runs(slot: str, name: str) -> None:
    options = FastSlamOptions(particles=20, effective_share=1.0, **{slot: name}, **SHORT)
    answer = driven(FastSlam(options), street(60, seed=2))[-1]
    assert np.linalg.norm(answer.pose[:2] - [5.9, 0.0]) < 1.0
    assert answer.vts is not None and len(answer.vts.id) == 4


@pytest.mark.parametrize("slot", list(BUILT_IN))
def test_each_part_of_the_documentation_runs(slot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_parts.py").write_text(PAGE.read_text().split("```python\n")[1].split("```")[0])
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place])  # as of the installed command
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_parts", raising=False)
    by_name = FastSlam(FastSlamOptions(particles=20, effective_share=1.0, **{slot: f"my_parts:{OWN[slot]}"}, **SHORT))
    part = getattr(sys.modules["my_parts"], OWN[slot])
    as_object = FastSlam(FastSlamOptions(particles=20, effective_share=1.0, **SHORT), **{slot: part})
    drive = street(40, seed=2)
    one, other = driven(by_name, drive)[-1], driven(as_object, drive)[-1]
    np.testing.assert_array_equal(one.pose, other.pose)
    assert np.linalg.norm(one.pose[:2] - [3.9, 0.0]) < 1.0


def test_wrong_parts_are_told_what_there_is() -> None:
    with pytest.raises(
        ValidationError, match=r"unknown association 'nearest'.*known: .*nearest-neighbour.*module:name"
    ):
        FastSlamOptions(association="nearest")
    with pytest.raises(InputError, match=r"unknown part of FastSLAM 'associator'.*association, birth"):
        FastSlam(associator=parts.nearest_neighbour)
    for wrong in (3, lambda W, more: W, type(parts.maximum_likelihood), "my_parts:weight"):
        with pytest.raises(InputError, match=r"weight: .* cannot be called with \(W\): .*give a function"):
            FastSlam(weight=wrong)
    with pytest.raises(ValidationError, match="cannot be imported"):
        FastSlamOptions(weight="no_such_module:weight")
    with pytest.raises(ValidationError, match=r"unknown part in module numpy 'clp'.*did you mean 'clip'"):
        FastSlamOptions(weight="numpy:clp")
    with pytest.raises(
        InputError, match=r"association: the part returned the numbers 7 to 7, where -1 to 0|1|2|3 may be"
    ):
        driven(FastSlam(FastSlamOptions(**SHORT), association=lambda given: [[7] * 4]), street(5, seed=1))


@pytest.mark.parametrize(
    ("slot", "part", "words"),
    [
        ("association", lambda given: np.zeros(given.distance2.shape[1], int), "candidate 0 two measurements"),
        ("association", lambda given: None, "true or false|whole numbers are needed"),
        ("birth", lambda given, candidate_of: candidate_of, "true or false are needed"),
        ("proposal", lambda mean, covariance, rng: (mean * np.nan, np.zeros(mean.shape[1])), "returned NaN"),
        ("weight", lambda W: W, "an array of shape"),
        ("pruning", lambda vts: vts.detections, "true or false are needed"),
        ("resampling", lambda weights, count, rng: np.full(count, -1), "numbers -1 to -1, where 0 to 19 may be"),
        ("resampling", lambda weights, count, rng: np.linspace(0.0, 1.0, count), "whole numbers are needed"),
    ],
)
def test_a_part_that_returns_something_else_is_told_what_is_needed(slot: str, part: Any, words: str) -> None:
    estimator = FastSlam(FastSlamOptions(particles=20, effective_share=1.0, **SHORT), **{slot: part})
    with pytest.raises(InputError, match=f"{slot}: .*({words})"):
        driven(estimator, street(60, seed=1))


def test_parts_that_were_never_called_are_remarked() -> None:
    estimator = FastSlam(FastSlamOptions(**SHORT), resampling=parts.SCHEMES["residual"])
    setup, steps = street(3, seed=1)
    driven(estimator, (replace(setup, sites=Sites(("A",), np.zeros(1), np.full(1, 50.0))), steps))
    assert any("resampling: never called" in line for line in estimator.remarks())


def test_a_part_that_is_never_called_while_others_are_is_remarked_with_what_it_waited_for() -> None:
    given = {"association": parts.nearest_neighbour, "resampling": parts.SCHEMES["residual"]}
    estimator = FastSlam(FastSlamOptions(particles=20, effective_share=0.01, **SHORT), **given)
    estimator.warm_up()  # what is called there does not count
    driven(estimator, street(30, seed=2))
    (remark,) = [line for line in estimator.remarks() if "never called" in line]
    assert remark.startswith(
        "resampling: cellslam.slam.model.resampling:residual was never called, while others were: "
    )
    assert "effective_share" in remark
    eager = FastSlam(FastSlamOptions(particles=20, effective_share=1.0, **SHORT), **given)
    driven(eager, street(30, seed=2))
    assert not [line for line in eager.remarks() if "never called" in line]


def failing(W: Any) -> Any:
    """A part with a mistake in it."""
    return W.no_such_attribute


def test_an_error_inside_a_part_says_which_part_it_is_and_the_line_of_it() -> None:
    estimator = FastSlam(FastSlamOptions(particles=20, **SHORT), weight=failing)
    with pytest.raises(AttributeError) as caught:
        driven(estimator, street(30, seed=2))
    line = failing.__code__.co_firstlineno + 2
    message = explained(caught.value)
    assert f"in the weight {__name__}:failing" in message
    assert message.endswith(f"(test_parts.py, line {line}, in failing)")
