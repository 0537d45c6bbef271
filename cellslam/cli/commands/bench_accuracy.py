"""`cellslam bench accuracy`: a fixed suite, as a sweep into a store that is resumed, and its tables.

With `--check` the rows of an entry: whether they are what its estimators give on a sample of the drives.
"""

from __future__ import annotations

import math
import secrets
import shlex
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.scores.metrics import METRIC_KEYS
from cellslam.benchmarks.sweeps.executors import executor
from cellslam.benchmarks.sweeps.tasks import Lost, plan
from cellslam.benchmarks.trials.output_files import check_file, write_text
from cellslam.cli.arguments import DONE, FAILED, REPEATED, WORK, add, limits, whole
from cellslam.cli.commands.sweep import carry, in_part, processes
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.suites import Suite, points_of, suite
from cellslam.sim.errors import InputError
from cellslam.slam import registry

if TYPE_CHECKING:
    from cellslam.benchmarks.tables.suite_rows import SuiteRows

EXAMPLES = (
    "bench accuracy --trials 2 --out accuracy",
    "bench accuracy --trials 2 --scenario canyon --estimator fastslam --set estimator.fastslam.lag=0",
)
# Other versions and processors round otherwise, and an estimator's choices may hang on the last digit.
TOLERANCE = 0.01
OPTIONS_OF_ITS_OWN = (
    "an entry has estimators with the options that they have themselves: leave out --set, and give yours a class with "
    "a name and these options"
)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("--suite", metavar="NAME", default="standard", help="standard, or one version: standard-3")
    few_help = "the first N trials of each scenario alone, to try it out: not the suite's result"
    parser.add_argument("--trials", metavar="N", type=whole, help=few_help)
    scenario_help = "this scenario of the suite alone; may be repeated"
    parser.add_argument("--scenario", metavar="NAME", dest="scenarios", help=scenario_help, **REPEATED)
    add(parser, "--estimator", help="instead of all built-in ones; by name or as module:Class; may be repeated")
    set_help = (
        "change one option of an estimator, as in estimator.fastslam.lag=0; may be repeated: not the suite's result"
    )
    add(parser, "--set", help=set_help)
    add(parser, "--out", help="folder of the results; one that exists is resumed (default: results/SUITE)")
    write_help = "write the tables as Markdown, besides printing them, and beside them the ranks as FILE.png"
    parser.add_argument("--write", metavar="FILE.md", help=write_help)
    rows_help = "write the rows of the whole suite: an entry for 'bench leaderboard'"
    parser.add_argument("--rows", metavar="FILE.json", help=rows_help)
    check_help = "verify an entry instead: repeat a sample of its drives, and compare; --estimator: of which estimators"
    parser.add_argument("--check", metavar="FILE.json", help=check_help)
    sample_help = "how many drives --check takes, at random (default: 5)"
    parser.add_argument("--sample", metavar="N", type=whole, default=5, help=sample_help)
    add(parser, *WORK)


def command(arguments: Namespace) -> int:
    if arguments.check:
        if arguments.sets:
            raise InputError(OPTIONS_OF_ITS_OWN)
        return check(arguments)
    one = suite(arguments.suite)
    trials = _trials(arguments, one)
    scenarios = tuple(arguments.scenarios) or one.scenarios
    options = parse_all(arguments.sets)
    points = points_of(one, scenarios, registry.expanded(arguments.estimators) or built_in(), options)
    out = Path(arguments.out or f"results/{one.name}")
    for file in (arguments.write, arguments.rows):
        if file:
            check_file(Path(file))
            if arguments.shard:
                raise InputError("--write and --rows are of all shards: repeat the command without --shard at the end")
    if arguments.rows and (trials, scenarios) != (one.trials, one.scenarios):
        raise InputError("--rows is of a whole suite: leave out --trials and --scenario")
    if arguments.rows and options:
        raise InputError(OPTIONS_OF_ITS_OWN)
    each = [one.trials_of(name, trials) for name in scenarios]
    status = carry(arguments, points, each, one.seed, out)
    if status not in (DONE, FAILED) or in_part(arguments):
        return status
    from cellslam.benchmarks.tables import suite_rows
    from cellslam.benchmarks.tables.suite_tables import suite_markdown

    keys = {job.key for task in plan(points, each, one.seed).tasks for job in task.jobs}
    some = suite_rows.stored(out, one, scenarios, trials, keys, arguments.sets)
    page = Path(arguments.write) if arguments.write else None
    picture = draw_verdicts(some, page.with_suffix(".png")) if page else ""
    command = shlex.join(["cellslam", *arguments.words])
    text = suite_markdown(some, command, "" if arguments.estimators else _left_out(), picture)
    sys.stdout.write(text)
    if page:
        write_text(page, text)
    if arguments.rows:
        write_text(Path(arguments.rows), suite_rows.as_text(some))
    return status


def check(arguments: Namespace) -> int:
    """Drive a sample of an entry's drives again; print each beside what the entry says. FAILED: one differs."""
    from cellslam.benchmarks.tables.suite_rows import read
    from cellslam.sim.world import versions

    path = Path(arguments.check)
    entry = read(path)
    stated = {str(row["key"]): row for row in entry.rows.to_dict("records")}
    estimators = registry.expanded(arguments.estimators) or entry.rows["estimator"].unique().tolist()
    one = entry.suite
    each = [one.trials_of(name) for name in one.scenarios]
    made = plan(points_of(one, one.scenarios, estimators), each, one.seed, trajectories=False)
    if unknown := [job for task in made.tasks for job in task.jobs if job.key not in stated]:
        raise InputError(f"{path}: {unknown[0].estimator} has other options here, or {one.name} another scenario")
    if not 1 <= arguments.sample <= len(made.tasks):
        raise InputError(f"--sample {arguments.sample}: must be 1 to {len(made.tasks)}, the drives of {one.name}")
    jobs = processes(arguments)
    # Redrawn each time: who sends an entry in cannot know which drives it will be.
    chosen = secrets.SystemRandom().sample(made.tasks, arguments.sample)
    for name, text in versions().items():
        if entry.versions.get(name) != text:
            print(f"{name}: {entry.versions.get(name, 'none')} in the entry, {text} here")
    wrong = 0
    with executor(arguments.executor, jobs, limits(arguments, jobs), arguments.scheduler) as pool:
        for answer in pool(chosen):
            row = stated[answer.key]
            found = {"status": "failed", "error": answer.reason} if isinstance(answer, Lost) else answer.row
            differing = list(differences(row, found))
            wrong += bool(differing)
            verdict = ", ".join(differing) or "as the entry says"
            print(f"{row['estimator']}, {row['scenario']}, trial {row['trial']}: {verdict}")
    count = len(estimators) * len(chosen)
    print(f"{count - wrong} of {count} drives are as the entry says, to {100 * TOLERANCE:g} %")
    return FAILED if wrong else DONE


def differences(stated: Mapping[Any, Any], found: Mapping[str, Any]) -> Iterator[str]:
    """Yield in what a row differs from what was stated: its status, or metrics beyond the tolerance."""
    if stated["status"] != found["status"]:
        yield f"status {stated['status']}, here {found['status']} ({found.get('error')})"
        return
    for key in METRIC_KEYS:
        first, second = (math.nan if row.get(key) is None else float(row[key]) for row in (stated, found))
        if math.isnan(first) != math.isnan(second) or abs(first - second) > TOLERANCE * abs(second):
            yield f"{key} {first:.4g}, here {second:.4g}"


def draw_verdicts(some: SuiteRows, path: Path) -> str:
    """Draw the ranks of a suite as a picture; return its name, empty where there is nothing to draw."""
    from matplotlib.figure import Figure

    from cellslam.benchmarks.figures.style import context, save
    from cellslam.benchmarks.figures.sweep.critical_difference import draw_ranks
    from cellslam.benchmarks.tables.rankings import verdicts

    with context():
        figure = Figure(layout="constrained")
        return save(figure, path).name if draw_ranks(figure, verdicts(some.panels, some.oracles)) else ""


def built_in() -> tuple[str, ...]:
    """Return the built-in estimators whose packages are installed."""
    return tuple(e.name for e in registry.BUILT_IN if not (e.needs and e.name in registry.left_out()))


def _left_out() -> str:
    """Return one line about the built-ins that cannot be run here."""
    lacking = registry.left_out().items()
    return "".join(f"Without {name}: {why}.\n" for name, why in lacking if name not in built_in())


def _trials(arguments: Namespace, one: Suite) -> int:
    if arguments.trials is None:
        return one.trials
    if not 1 <= arguments.trials <= one.trials:
        raise InputError(f"--trials {arguments.trials}: must be 1 to {one.trials}, the trials of {one.name}")
    return int(arguments.trials)
