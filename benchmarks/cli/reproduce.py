"""`cellslam reproduce`: published figures of a known world of others, and those of this package's estimators there."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from cellslam.benchmarks.cli.arguments import DONE, FAILED, add_seed, add_work, whole
from cellslam.benchmarks.cli.sweep import carry_plan
from cellslam.benchmarks.scores.statistics import interval, statistic
from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.sweeps.tasks import plan_known
from cellslam.benchmarks.trials.trials import check_counts
from cellslam.scenarios.known_worlds import NAMES, known_world

if TYPE_CHECKING:
    import pandas as pd

    from cellslam.scenarios.known_worlds.known_world import Figure, KnownWorld

CONFIDENCE = 0.95
_WIDTH = 120


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("name", metavar="NAME", help=f"the known world: {', '.join(NAMES)}")
    trials_help = "runs of each estimator, trials 0 to N-1 (default: as many as were published)"
    parser.add_argument("--trials", metavar="N", type=whole, help=trials_help)
    add_seed(parser, 0, "root seed of all random draws (default: 0)")
    out_help = "folder of the results; one that exists is resumed (default: results/NAME-SEED)"
    parser.add_argument("--out", metavar="DIR", help=out_help)
    add_work(parser)


def command(arguments: Namespace) -> int:
    """Carry out `cellslam reproduce`."""
    world = known_world(arguments.name)
    trials = world.trials if arguments.trials is None else arguments.trials
    check_counts(trials, arguments.seed)
    out = Path(arguments.out or f"results/{world.name}-{arguments.seed}")
    made = plan_known(world, trials, arguments.seed, not arguments.no_trajectories)
    names = {
        (task.world, job.estimator, job.options): entry.name
        for task in made.tasks[:1]
        for job, entry in zip(task.jobs, world.entries, strict=True)
    }
    status = carry_plan(arguments, made, world.name, names, out)
    if status not in (DONE, FAILED) or arguments.dry_run:
        return status
    rows = results(out, ["key", "status", *(figure.key for figure in world.figures)])
    keys = [[task.jobs[i].key for task in made.tasks] for i in range(len(world.entries))]
    tables = [rows[rows["key"].isin(own) & (rows["status"] == "ok")] for own in keys]
    console = Console(width=None if sys.stdout.isatty() else _WIDTH)
    console.print(escape(f"{world.title}\n{world.source}"), highlight=False)
    console.print(comparison(world, tables))
    console.print("\n".join(f"- {escape(text)}" for text in ("What differs:", *world.differences))[2:], highlight=False)
    return status


def comparison(world: KnownWorld, tables: list[pd.DataFrame]) -> Table:
    """Return published and own figures, with intervals, of the rows of each entry."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in ("", "figure", "published", "own", "95 % interval", "runs"):
        table.add_column(name, justify="left" if name in ("", "figure") else "right", no_wrap=True)
    for entry, rows in zip(world.entries, tables, strict=True):
        for place, figure in enumerate(world.figures):
            published = entry.published.get(figure.name)
            said = "-" if published is None else f"{published:.2f}"
            first = entry.name if place == 0 else ""
            table.add_row(first, f"{figure.name}, {figure.unit}", said, *_own(figure, rows))
    return table


def _own(figure: Figure, rows: pd.DataFrame) -> tuple[str, str, str]:
    values = figure.scale * rows[figure.key].dropna().to_numpy(np.float64)
    if not len(values):
        return "-", "-", "0"
    of = statistic(figure.statistic)
    low, high = interval(values, of, CONFIDENCE)
    between = "-" if np.isnan(low) else f"{low:.2f} to {high:.2f}"
    return f"{float(of.of(values)):.2f}", between, str(len(values))
