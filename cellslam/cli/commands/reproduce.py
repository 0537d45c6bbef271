"""`cellslam reproduce`: published figures of a known world of others, and those of this package's estimators there."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape
from rich.table import Table

from cellslam.benchmarks.scores.statistics import geometric_mean_ratio, interval, statistic
from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.sweeps.tasks import Plan, asked_by, plan_known
from cellslam.benchmarks.trials.trials import check_counts
from cellslam.cli.arguments import DONE, FAILED, WORK, add, whole
from cellslam.cli.commands.sweep import carry_plan, in_part
from cellslam.cli.output import console, plain_table
from cellslam.scenarios.known_worlds import NAMES, known_world

if TYPE_CHECKING:
    import pandas as pd

    from cellslam.scenarios.known_worlds.known_world import Entry, Figure, KnownWorld

EXAMPLES = ("reproduce paper --seed 1", "reproduce bp-slam-testbed --trials 5")
CONFIDENCE = 0.95
COMPARED = "position_rmse_m"  # key of a trial's row by which the rungs of a ladder are compared
DRAWN = ("map", "error", "associations")
PIPE_WIDTH = 120


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", help=f"the known world: {', '.join(NAMES)}")
    trials_help = "runs of each estimator, trials 0 to N-1 (default: as many as were published; 40 of paper)"
    parser.add_argument("--trials", metavar="N", type=whole, help=trials_help)
    add(parser, "--seed")
    add(parser, "--out", help="folder of the results; one that exists is resumed (default: results/NAME-SEED)")
    add(parser, *WORK)


def command(arguments: Namespace) -> int:
    world = known_world(arguments.name)
    trials = world.trials if arguments.trials is None else arguments.trials
    check_counts(trials, arguments.seed)
    out = Path(arguments.out or f"results/{world.name}-{arguments.seed}")
    made = plan_known(world, trials, arguments.seed, not arguments.no_trajectories)
    names = {asked_by(world, entry): entry.name for entry in (*world.ladder, *world.entries)}
    status = carry_plan(arguments, made, world.name, names, out)
    if status not in (DONE, FAILED) or in_part(arguments):
        return status
    tables, rungs = (_rows(out, world, made, entries) for entries in (world.entries, world.ladder))
    screen = console(PIPE_WIDTH)
    screen.print(escape(f"{world.title}\n{world.source}"), highlight=False)
    screen.print(comparison(world, tables))
    if rungs:
        screen.print(ladder(world, rungs))
    screen.print("\n".join(f"- {escape(text)}" for text in ("What differs:", *world.differences))[2:], highlight=False)
    if world.city is not None:
        _draw(world, arguments.seed, out / "figures")
    return status


def comparison(world: KnownWorld, tables: list[pd.DataFrame]) -> Table:
    """Return published and own figures, with intervals, of the rows of each entry."""
    table = plain_table("", "figure")
    for name in ("published", "own", "95 % interval", "runs"):
        table.add_column(name, justify="right", no_wrap=True)
    for entry, rows in zip(world.entries, tables, strict=True):
        for place, figure in enumerate(world.figures):
            published = entry.published.get(figure.name)
            stated = "-" if published is None else f"{published:.2f}"
            first = entry.name if place == 0 else ""
            table.add_row(first, f"{figure.name}, {figure.unit}", stated, *_own(figure, rows))
    return table


def ladder(world: KnownWorld, tables: list[pd.DataFrame]) -> Table:
    """Return the figures of each rung, and by what its position RMSE is multiplied from the rung before.

    That is the geometric mean of the ratios over the runs that both have, with its interval.
    """
    table = plain_table("one change at a time")
    for name in (*(f"{figure.name}, {figure.unit}" for figure in world.figures), "RMSE times", "95 % interval", "runs"):
        table.add_column(name, justify="right", no_wrap=name.endswith("interval"))
    before: pd.DataFrame | None = None
    for entry, rows in zip(world.ladder, tables, strict=True):
        own = [_own(figure, rows)[0] for figure in world.figures]
        table.add_row(entry.name, *own, *(("-", "-") if before is None else _ratio(before, rows)), str(len(rows)))
        before = rows
    return table


def _rows(out: Path, world: KnownWorld, made: Plan, entries: Sequence[Entry]) -> list[pd.DataFrame]:
    """Return the rows of each entry that a plan has and that did not fail."""
    columns = dict.fromkeys(("key", "status", "trial", COMPARED, *(figure.key for figure in world.figures)))
    rows = results(out, list(columns))
    keys: dict[tuple[str, str, str], list[str]] = {}
    for task in made.tasks:
        for job in task.jobs:
            keys.setdefault((task.world, job.estimator, job.options), []).append(job.key)
    fine = rows[rows["status"] == "ok"]
    return [fine[fine["key"].isin(keys[asked_by(world, entry)])] for entry in entries]


def _own(figure: Figure, rows: pd.DataFrame) -> tuple[str, str, str]:
    values = figure.scale * rows[figure.key].dropna().to_numpy(np.float64)
    if not len(values):
        return "-", "-", "0"
    of = statistic(figure.statistic)
    return f"{float(of.of(values)):.2f}", _span(*interval(values, of, CONFIDENCE)), str(len(values))


def _ratio(before: pd.DataFrame, after: pd.DataFrame) -> tuple[str, str]:
    pairs = before.merge(after, on="trial", suffixes=("_before", "_after"))
    first, second = (pairs[f"{COMPARED}_{when}"].to_numpy(np.float64) for when in ("after", "before"))
    ratio, low, high = geometric_mean_ratio(first, second, CONFIDENCE)
    return "-" if np.isnan(ratio) else f"{ratio:.2f}", _span(low, high)


def _span(low: float, high: float) -> str:
    return "-" if np.isnan(low) else f"{low:.2f} to {high:.2f}"


def _draw(world: KnownWorld, seed: int, out: Path) -> None:
    """Draw the figures of the first run, those of its entries, unless they are there."""
    from cellslam.benchmarks.figures.trial.trial_figures import draw_all
    from cellslam.benchmarks.trials.trials import score_trial
    from cellslam.scenarios.estimator_options import loaded

    if world.city is None or all((out / f"{name}.png").is_file() for name in DRAWN):
        return
    requests = [loaded(entry.estimator, {entry.estimator: entry.options}) for entry in world.entries]
    drive, outcomes = score_trial(lambda: world.simulate(seed, 0), world.name, requests, 0, seed, bounded=False)
    found = {outcome.row["estimator"]: outcome.result for outcome in outcomes if outcome.result is not None}
    if drive.recording is not None and found:
        draw_all(world.city(seed, 0), drive.recording, found, None, out, names=DRAWN)
        sys.stderr.write(f"figures of the first run are in {out}: {', '.join(DRAWN)}\n")
