"""`cellslam bench accuracy`: a fixed suite, as a sweep into a store that is resumed, and its tables."""

from __future__ import annotations

import shlex
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.cli.arguments import DONE, FAILED, add_work, whole
from cellslam.benchmarks.cli.sweep import carry
from cellslam.benchmarks.trials.output_files import check_file
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.foreign_options import asking
from cellslam.scenarios.suites import Suite, scenario_of, suite
from cellslam.scenarios.sweep_points import Point
from cellslam.sim.errors import InputError
from cellslam.slam import registry


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("--suite", metavar="NAME", default="standard", help="standard, or one version: standard-1")
    few_help = "the first N trials of each scenario alone, to try it out: not the suite's result"
    parser.add_argument("--trials", metavar="N", type=whole, help=few_help)
    scenario_help = "this scenario of the suite alone; may be repeated"
    parser.add_argument("--scenario", metavar="NAME", action="append", default=[], dest="scenarios", help=scenario_help)
    estimators_help = "in place of all built-ins; by name or as module:Class; may be repeated"
    parser.add_argument(
        "--estimator", metavar="NAME", action="append", default=[], dest="estimators", help=estimators_help
    )
    parser.add_argument("--out", metavar="DIR", help="folder of the results; one that exists is resumed "
                        "(default: results/SUITE)")  # fmt: skip
    parser.add_argument("--write", metavar="FILE.md", help="write the tables as Markdown, besides printing them")
    add_work(parser)


def command(arguments: Namespace) -> int:
    """Carry out `cellslam bench accuracy`."""
    one = suite(arguments.suite)
    trials = _trials(arguments, one)
    scenarios = tuple(arguments.scenarios) or one.scenarios
    estimators = registry.expanded(arguments.estimators) or built_in()
    with asking() as ask:
        every = [scenario_of(one, name) for name in scenarios]
        points = [Point({}, s, resolve(s.estimator, estimators, ask=ask)) for s in every]
    out = Path(arguments.out or f"results/{one.name}")
    if arguments.write:
        check_file(Path(arguments.write))
    status = carry(arguments, points, trials, one.seed, out)
    if status not in (DONE, FAILED) or arguments.dry_run:
        return status
    from cellslam.benchmarks.tables.suite_tables import suite_markdown
    from cellslam.benchmarks.trials.output_files import write_text

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
