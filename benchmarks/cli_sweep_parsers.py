"""The parsers of `sweep`, of what is made of its results, and of the benchmarks that are sweeps."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from cellslam.benchmarks.cli_options import add_estimators, add_set, number, whole

Add = Callable[[str, str, str], argparse.ArgumentParser]
FORMATS, FORMAT_HELP = ("text", "md", "csv", "latex", "json"), "csv and json hold the plain numbers"
_FLAGS = (
    ("--dry-run", "say how many trials there are and how long they may take; do nothing"),
    ("--live", "show the table of results so far every few seconds"),
    ("--retry-failed", "do trials that are stored as failed again"),
    ("--no-trajectories", "keep the rows alone: saves disk space, and costs error curves and reports"),
)


def add_sweeps(add: Add) -> None:
    """Add `sweep` and what is made of its results; `add(name, target, summary)` makes a command's parser."""
    _add_sweep(add("sweep", "cli_sweep:sweep", "many variants and trials of a scenario, in parallel, resumable"))
    _add_table(add("table", "cli_table:table", "the results of a sweep as a table"))
    consistency_help = "whether estimators know how wrong they are: errors against claimed covariances"
    _add_consistency(add("consistency", "cli_table:consistency", consistency_help))
    _add_figures(add("figures", "cli_table:figures", "the figures of a sweep, as PNG and PDF"))
    _add_report(add("report", "cli_table:report", "one HTML page of a sweep: tables, plots, worst trials"))


def add_sweep_benches(add: Add) -> None:
    """Add `accuracy` and `monte-carlo` to the benchmarks."""
    _add_accuracy(add("accuracy", "cli_suite:accuracy", "a fixed suite of scenarios, seeds and trials, for comparison"))
    _add_monte_carlo(add("monte-carlo", "cli_monte_carlo:monte_carlo", "time sweeps: rates, overhead, tables"))


def _add_sweep(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", help="a preset's name, a scenario file, or a sweep file")
    add_set(parser, "radio.load=0.5")
    parser.add_argument(
        "--sweep",
        metavar="KEY=V1,V2,...",
        action="append",
        default=[],
        dest="sweeps",
        help="values of one key; may be repeated: all combinations",
    )
    add_estimators(parser)
    parser.add_argument("--trials", metavar="N", type=whole, help="trials 0 to N-1 of each point (default: 1)")
    parser.add_argument("--seed", metavar="S", type=whole, help="root seed of all random draws (default: 0)")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder of the results; one that exists is resumed")
    _add_flags(parser, *_FLAGS)
    _add_executor(parser)


def _add_executor(parser: argparse.ArgumentParser) -> None:
    names = ("serial", "processes", "dask")
    parser.add_argument("--executor", choices=names, default="processes", help="where to work (default: processes)")
    parser.add_argument("--jobs", metavar="N", type=whole, help="number of processes (default: one a core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running Dask scheduler, as tcp://host:8786")
    time_help = "one estimator's time for one trial, then its process is killed (default: 3600)"
    parser.add_argument("--time-limit", metavar="SECONDS", type=number, default=3600.0, help=time_help)
    parser.add_argument("--memory-limit", metavar="GIB", type=number, help="memory of a process (default: fair share)")


def _add_table(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="folder of a sweep")
    several: dict[str, Any] = {"action": "append", "default": []}
    rows_help = "a line for each value of this key; may be repeated (default: estimator and all that varies)"
    parser.add_argument("--rows", metavar="KEY", help=rows_help, **several)
    parser.add_argument("--columns", metavar="KEY", help="a column for each value of this key")
    metric_help = "what is summed up, as position_rmse_m; may be repeated"
    parser.add_argument("--metric", metavar="NAME", dest="metrics", help=metric_help, **several)
    statistic_help = "median (default), mean, rmse, min, max, q90, 'share>2'; may be repeated"
    parser.add_argument("--statistic", metavar="NAME", dest="statistics", help=statistic_help, **several)
    interval_help = "with bootstrap intervals of this confidence"
    parser.add_argument("--interval", metavar="PERCENT", type=number, nargs="?", const=95.0, help=interval_help)
    parser.add_argument("--compare", metavar="A,B", help="paired differences of two estimators on the same worlds")
    parser.add_argument("--format", choices=FORMATS, default="text", help=FORMAT_HELP)


def _add_consistency(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="folder of a sweep")
    parser.add_argument("--times", metavar="N", type=whole, default=10, help="moments of the drive (default: 10)")
    rows_help = "a line for each value of this key; may be repeated (default: estimator and all that varies)"
    parser.add_argument("--rows", metavar="KEY", help=rows_help, action="append", default=[])
    parser.add_argument("--format", choices=FORMATS, default="text", help=FORMAT_HELP)


def _add_figures(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="folder of a sweep")
    parser.add_argument("--x", metavar="KEY", help="key along the sweep curve (default: the first number that varies)")
    parser.add_argument("--metric", metavar="NAME", default="position_rmse_m", help="default: position_rmse_m")
    parser.add_argument("--statistic", metavar="NAME", default="median", help="as for 'table' (default: median)")
    interval_help = "confidence of the intervals (default: 95)"
    parser.add_argument("--interval", metavar="PERCENT", type=number, default=95.0, help=interval_help)
    parser.add_argument("--out", metavar="FOLDER", help="where to write (default: DIR/figures)")


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="folder of a sweep")
    parser.add_argument("--out", metavar="FILE.html", help="the page to write (default: DIR/report.html)")
    parser.add_argument("--worst", metavar="N", type=whole, default=3, help="trials with a section each (default: 3)")
    metric_help = "by which trials are the worst (default: position_rmse_m)"
    parser.add_argument("--metric", metavar="NAME", default="position_rmse_m", help=metric_help)
    estimators_help = "whose worst trials; may be repeated (default: the estimator with the best median)"
    parser.add_argument(
        "--estimator", metavar="NAME", action="append", default=[], dest="estimators", help=estimators_help
    )


def _add_accuracy(parser: argparse.ArgumentParser) -> None:
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
    _add_flags(parser, *_FLAGS)
    _add_executor(parser)


def _add_monte_carlo(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", nargs="?", default="tiny", help="what to run (default: tiny)")
    add_set(parser, "estimator.fastslam.particles=300")
    add_estimators(parser)
    parser.add_argument("--trials", metavar="N", type=whole, default=200, help="trials to time (default: 200)")
    parser.add_argument("--jobs", metavar="N", type=whole, default=2, help="processes to compare with one (default: 2)")
    rows_help = "rows of the store that 'table' is timed with (default: 100000)"
    parser.add_argument("--rows", metavar="N", type=whole, default=100_000, help=rows_help)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON on stdout, nothing else")


def _add_flags(parser: argparse.ArgumentParser, *flags: tuple[str, str]) -> None:
    for name, meaning in flags:
        parser.add_argument(name, action="store_true", help=meaning)
