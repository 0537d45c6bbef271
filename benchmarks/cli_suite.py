"""`cellslam bench accuracy`: a fixed suite, as a sweep into a store that is resumed, and its tables."""

from __future__ import annotations

import shlex
import sys
from argparse import Namespace
from pathlib import Path

from cellslam.benchmarks.cli import DONE, FAILED
from cellslam.benchmarks.cli_sweep import carry
from cellslam.benchmarks.output import check_file
from cellslam.scenarios.options import resolve
from cellslam.scenarios.suites import Suite, scenario_of, suite
from cellslam.scenarios.sweep import Point
from cellslam.sim.errors import InputError
from cellslam.slam import registry


def accuracy(arguments: Namespace) -> int:
    """Carry out `cellslam bench accuracy`."""
    one = suite(arguments.suite)
    trials = _trials(arguments, one)
    scenarios = tuple(arguments.scenarios) or one.scenarios
    estimators = registry.expanded(arguments.estimators) or built_in()
    points = []
    for name in scenarios:
        scenario = scenario_of(one, name)
        points.append(Point({}, scenario, resolve(scenario.estimator, estimators)))
    out = Path(arguments.out or f"results/{one.name}")
    if arguments.write:
        check_file(Path(arguments.write))
    status = carry(arguments, points, trials, one.seed, out)
    if status not in (DONE, FAILED) or arguments.dry_run:
        return status
    from cellslam.benchmarks.output import write_text
    from cellslam.benchmarks.suite_tables import suite_markdown

    command = shlex.join(["cellslam", *arguments.words])
    left = "" if arguments.estimators else _left_out()
    text = suite_markdown(out, one, scenarios, trials, command, left)
    sys.stdout.write(text)
    if arguments.write:
        write_text(Path(arguments.write), text)
    return status


def built_in() -> tuple[str, ...]:
    """Return the built-in estimators whose packages are installed."""
    lacking = {entry.name for entry in registry.BUILT_IN if entry.needs and entry.name in registry.left_out()}
    return tuple(entry.name for entry in registry.BUILT_IN if entry.name not in lacking)


def _left_out() -> str:
    """Return one line about the built-ins that cannot be run here."""
    chosen = built_in()
    lacking = {n: why for n, why in registry.left_out().items() if n not in chosen}
    return "".join(f"Without {name}: {why}.\n" for name, why in lacking.items())


def _trials(arguments: Namespace, one: Suite) -> int:
    if arguments.trials is None:
        return one.trials
    if not 1 <= arguments.trials <= one.trials:
        raise InputError(f"--trials {arguments.trials}: {one.name} has 1 to {one.trials}")
    return int(arguments.trials)
