"""The conformance kit: all built-in estimators pass, planted defects are found, and truth is out of reach."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest

from cellslam.cli.commands.check_estimator import finding_of
from cellslam.cli.main import main
from cellslam.scenarios.estimator_options import Request
from cellslam.sim.recording import Measurements, Recording, Truth
from cellslam.slam import registry
from cellslam.slam.api import setup_of, snapshots_of
from cellslam.slam.conformance import EstimatorConformance, checks
from cellslam.slam.conformance.subject import Subject, tiny_drive

PLANTED = [
    ("Nameless", checks.declares_what_it_is, "give the class a name"),
    ("WrongShape", checks.answers_have_the_right_shapes, "its shape is (6,)"),
    ("Raises", checks.answers_have_the_right_shapes, "KeyError"),
    ("OwnSeed", checks.same_seed_same_answer, "draw from the `rng` of start()"),
    ("NoFreshStart", checks.same_seed_same_answer, "let start() set every variable"),
    ("StateInTheClass", checks.same_seed_same_answer, "two runs with one seed differ"),
    ("GlobalRandom", checks.leaves_global_randomness_alone, "instead of `random`"),
    ("WritesInput", checks.leaves_its_input_alone, "copy before writing"),
    ("GivesItsOwnArrays", checks.answers_stay_as_they_were, "return copies"),
    ("NeedsMeasurements", checks.survives_empty_snapshots, "len(snapshot) == 0"),
    ("TrustsTheOrder", checks.does_not_mind_the_order, "not by place"),
    ("SpreadsNan", checks.survives_missing_components, "leave it out"),
    ("FixedInterval", checks.survives_other_intervals, "use the dt_s"),
    ("NotPicklable", checks.pickles, "no lambdas"),
    ("BadCovariance", checks.covariances_are_positive, "symmetrise"),
    ("ClaimsToKnow", checks.covariances_are_positive, "add the odometry's noise"),
    ("Leaks", checks.memory_does_not_grow, "leave"),
    ("Hoards", checks.memory_does_not_grow, "bound the map"),
    ("GoesAstray", checks.does_no_harm, "docs/reference/conventions.md"),
]


LONG = (checks.memory_does_not_grow, checks.does_no_harm, checks.survives_missing_components)
# Options with which an estimator is fast, or sure enough on a short drive.
OPTIONS: dict[str, Any] = {
    "paper-fastslam": {"particles": 20},
    "phd-slam": {"particles": 20},
    "smoother": {"ekf_slam": {"confirm_hits": 4}},
}


class TestBuiltIn(EstimatorConformance):
    # Oracles are other estimators that know the truth: what all share is tried with these.
    @pytest.fixture(
        params=[
            pytest.param(entry.name, marks=[pytest.mark.slow] * entry.oracle)
            for entry in registry.BUILT_IN
            if entry.name not in registry.left_out()
        ]
    )
    def estimator(self, request: pytest.FixtureRequest) -> type[Any]:
        return registry.resolve(request.param)

    @pytest.fixture
    def options(self, estimator: type[Any]) -> Any:
        model = registry.options_model(estimator)
        return None if model is None else model.model_validate(OPTIONS.get(estimator.name, {}))

    @pytest.mark.parametrize(
        "check", [pytest.param(c, marks=[pytest.mark.slow] * (c in LONG), id=c.__name__) for c in checks.CHECKS]
    )
    def test_conforms(self, subject: Subject, check: checks.Check) -> None:
        check(subject)


@pytest.fixture
def planted(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(Path(__file__).parent)
    yield


@pytest.mark.usefixtures("planted")
@pytest.mark.parametrize(("name", "check", "words"), PLANTED, ids=[name for name, *_ in PLANTED])
def test_finds_the_planted_defect(name: str, check: checks.Check, words: str) -> None:
    found = finding_of(check, Request(name, registry.resolve(f"conformance_defects:{name}"), None))
    assert found is not None
    assert words in found
    assert "to fix" in found


def test_every_check_is_seen_to_fail() -> None:
    assert {check for _, check, _ in PLANTED} == set(checks.CHECKS)


@pytest.mark.usefixtures("planted")
def test_command_line_says_what_to_fix(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-estimator", "conformance_defects:Sound"]) == 0
    assert "all 14 checks passed" in capsys.readouterr().out
    assert main(["check-estimator", "conformance_defects:NotPicklable", "--quiet"]) == 1
    out = capsys.readouterr().out
    assert "FAIL  pickles" in out
    assert "to fix: keep all state in self" in out
    assert "1 of 14 checks found something to fix" in out
    assert main(["check-estimator", "conformance_defects:Nobody"]) == 2


def reachable(root: object) -> list[Any]:
    """Return everything that can be reached from `root` by references: attributes, items, base arrays."""
    found: dict[int, Any] = {}
    todo = [root]
    while todo:
        item = todo.pop()
        if id(item) in found or isinstance(item, (type, ModuleType, FunctionType)):
            continue
        found[id(item)] = item
        if isinstance(item, np.ndarray):
            todo.append(item.base)
        todo.extend(gc.get_referents(item))
    return list(found.values())


def test_estimators_cannot_reach_the_recording() -> None:
    recording = tiny_drive()
    given = (setup_of(recording), snapshots_of(recording))
    items = reachable(given)
    assert not [item for item in items if isinstance(item, (Recording, Measurements, Truth))]
    own = [a for a in reachable(recording) if isinstance(a, np.ndarray) and a.size > 1]
    arrays = [a for a in items if isinstance(a, np.ndarray)]
    assert len(own) > 20
    assert len(arrays) > 8 * len(given[1])
    assert all(a.base is None and not a.flags.writeable for a in arrays)
    ends = np.array([np.lib.array_utils.byte_bounds(a) for a in own])
    for array in arrays:
        low, high = np.lib.array_utils.byte_bounds(array)
        assert not ((ends[:, 0] < high) & (low < ends[:, 1])).any()


def test_oracles_get_a_copy_of_the_truth() -> None:
    recording = tiny_drive()
    truth = setup_of(recording, with_truth=True).truth
    assert truth is not None
    assert recording.truth is not None
    assert not np.shares_memory(truth.poses, recording.truth.poses)
    assert not truth.vts.position_m.flags.writeable
    np.testing.assert_array_equal(truth.poses, recording.truth.poses)
