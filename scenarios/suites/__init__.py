"""Fixed suites: scenarios with every value written out, so that results of different hands can be compared.

A suite never changes: what would change its results is another version, under another name. What most of its scenarios
have in common stands in the base of their files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from cellslam.scenarios.estimator_options import called, resolve
from cellslam.scenarios.external_options import asking
from cellslam.scenarios.loading import load, tables_of
from cellslam.scenarios.overrides import apply, split
from cellslam.scenarios.scenario import Scenario
from cellslam.scenarios.sweep_points import Point
from cellslam.sim.errors import InputError, unknown_name


@dataclass(frozen=True)
class Suite:
    """A suite by its versioned name: scenarios (files beside this one), root seed, trials 0 to `trials` - 1, and of
    scenarios that take long only the `fewer` first."""

    name: str
    scenarios: tuple[str, ...]
    seed: int
    trials: int
    fewer: Mapping[str, int] = field(default_factory=dict)

    def trials_of(self, scenario: str, most: int | None = None) -> int:
        """Return how many trials a scenario has, and no more than `most` (None: all)."""
        all_of_it = self.fewer.get(scenario, self.trials)
        return all_of_it if most is None else min(all_of_it, most)


_SECOND = ("clutter", "traffic", "clocks", "canyon", "full", "anywhere", "one-site", "signal")
_THIRD = (*_SECOND, "noisy-odometry", "relocation")
_FOURTH = (*_THIRD, "known-sites")
_VERSIONS = {"standard-2": _SECOND, "standard-3": _THIRD, "standard-4": _FOURTH}
SUITES = {
    name: Suite(name, scenarios, seed=530, trials=20, fewer={"signal": 5}) for name, scenarios in _VERSIONS.items()
}
# What a name without a version stands for.
LATEST = {"standard": "standard-4"}
FOLDER = Path(__file__).with_name("standard")  # of the scenarios, which versions share


def suite(name: str) -> Suite:
    """Return the suite of that name, with or without its version. Raises InputError."""
    known = LATEST.get(name, name)
    if known not in SUITES:
        raise unknown_name("suite", name, (*LATEST, *SUITES))
    return SUITES[known]


def superseded_by(one: Suite) -> str | None:
    """Return the name of the version that has taken the place of this one; None: it is the latest."""
    latest = LATEST.get(one.name.rpartition("-")[0], one.name)
    return None if latest == one.name else latest


def digest(one: Suite) -> str:
    """Return the SHA-256 of all that a suite is: what it is called, and every value of its scenarios."""
    # Layout and comments of the files do not count, the order of their keys does.
    texts = {scenario: tomli_w.dumps(tables_of(FOLDER / f"{scenario}.toml")) for scenario in one.scenarios}
    fewer = [dict(one.fewer)] if one.fewer else []
    content = json.dumps([one.name, one.scenarios, one.seed, one.trials, texts, *fewer])
    return hashlib.sha256(content.encode()).hexdigest()


def scenario_of(one: Suite, name: str) -> Scenario:
    """Return a scenario of a suite. Raises InputError for one that is not in it."""
    if name not in one.scenarios:
        raise unknown_name(f"scenario of {one.name}", name, one.scenarios)
    return load(FOLDER / f"{name}.toml")


def points_of(
    one: Suite, scenarios: Sequence[str], estimators: Sequence[str], options: Mapping[str, Any] | None = None
) -> list[Point]:
    """Return what is driven: each of the `scenarios` with all estimators.

    `options` are values of dotted keys, all of them estimators' options. Raises InputError for any other key, as the
    worlds of a suite do not change, and for an estimator that is not driven.
    """
    changed = dict(options or {})
    for key in changed:
        if not key.startswith("estimator."):
            raise InputError(f"{key}: the worlds of a suite are fixed; 'cellslam sweep' changes those of a scenario")
    with asking() as ask:
        points = []
        for name in scenarios:
            scenario = scenario_of(one, name)
            tables = apply({"estimator": scenario.estimator}, changed)["estimator"]
            points.append(Point({}, scenario, resolve(tables, estimators, changed, ask)))
    driven = called(request for point in points for request in point.requests)
    for key in changed:
        if split(key)[1] not in driven:
            raise InputError(f"{key}: that estimator is not run here (run: {', '.join(sorted(driven))})")
    return points
