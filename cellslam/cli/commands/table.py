"""`cellslam table`: the results of a sweep as a table."""

from __future__ import annotations

import re
import sys
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

from cellslam.benchmarks.scores.statistics import LEAST_VALUES
from cellslam.benchmarks.sweeps.rows import oracles, results
from cellslam.benchmarks.tables.formats import comparison_grid, render, summary_grid
from cellslam.benchmarks.tables.summaries import Layout, comparison, row_keys, summary
from cellslam.cli.arguments import REPEATED, add, number
from cellslam.sim.errors import InputError

EXAMPLES = (
    "table load",
    "table load --interval --format latex",
    "table load --compare fastslam,ekf-slam",
    "table parts --compare 'fastslam[lag=0],fastslam[lag=5]'",
)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder", "--rows", "--format")
    parser.add_argument("--columns", metavar="KEY", help="a column for each value of this key")
    metric_help = "what is summed up, as position_rmse_m; may be repeated"
    parser.add_argument("--metric", metavar="NAME", dest="metrics", help=metric_help, **REPEATED)
    statistic_help = "median (default), mean, rmse, min, max, q90, 'share>2'; may be repeated"
    parser.add_argument("--statistic", metavar="NAME", dest="statistics", help=statistic_help, **REPEATED)
    interval_help = "with bootstrap intervals of this confidence"
    parser.add_argument("--interval", metavar="PERCENT", type=number, nargs="?", const=95.0, help=interval_help)
    compare_help = "paired differences of two estimators, or variants as fastslam[lag=0], on the same worlds"
    parser.add_argument("--compare", metavar="A,B", help=compare_help)


def command(arguments: Namespace) -> None:
    folder = Path(arguments.folder)
    confidence = None if arguments.interval is None else arguments.interval / 100
    rows = tuple(arguments.rows) or None
    if arguments.compare is not None:
        sys.stdout.write(_compared(arguments, folder, rows, confidence))
        return
    statistics = tuple(arguments.statistics) or ("median",)
    layout = Layout(rows, arguments.columns, tuple(arguments.metrics), statistics, confidence)
    layout = replace(layout, rows=tuple(row_keys(folder, layout)))
    tidy = summary(folder, layout)
    if tidy.empty:
        raise InputError(f"{folder}: no rows yet")
    keys = [key for key in layout.rows or () if key != layout.columns]
    grid = summary_grid(tidy, keys, layout.columns, oracles(folder))
    if pooled := _pooled(folder, layout) if rows else []:
        grid = replace(grid, notes=(*grid.notes, f"pooled over all values of: {', '.join(pooled)}"))
    if confidence is not None and tidy["values"].between(1, LEAST_VALUES - 1).any():
        grid = replace(grid, notes=(*grid.notes, f"no interval where there are fewer than {LEAST_VALUES} trials"))
    sys.stdout.write(render(tidy, grid, arguments.format))


def _pooled(folder: Path, layout: Layout) -> list[str]:
    """Return what varies in a sweep and is neither in the rows nor in the columns of a table."""
    shown = {*(layout.rows or ()), layout.columns}
    varied = [key for key in row_keys(folder, Layout(columns=layout.columns)) if key not in shown]
    return [key for key in varied if key != "estimator" or results(folder, ["estimator"])["estimator"].nunique() > 1]


def _compared(arguments: Namespace, folder: Path, rows: tuple[str, ...] | None, confidence: float | None) -> str:
    both = [part.strip() for part in re.split(r",(?![^\[]*\])", arguments.compare)]  # no comma within brackets
    if len(both) != 2 or not all(both):
        raise InputError(f"--compare '{arguments.compare}': write two estimators, as in fastslam,dead-reckoning")
    if arguments.columns is not None or len(arguments.metrics) > 1 or arguments.statistics:
        raise InputError("--compare goes with --rows, --interval, --format and one --metric")
    metric = arguments.metrics[0] if arguments.metrics else "position_rmse_m"
    share = 0.95 if confidence is None else confidence
    first, second = both
    tidy = comparison(folder, first, second, metric, rows, share)
    columns = list(tidy.columns)
    keys = columns[: columns.index("metric")] if columns else []
    return render(tidy, comparison_grid(tidy, keys, first, second, 100 * share), arguments.format)
