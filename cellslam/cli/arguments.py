"""What several commands share: exit statuses and options."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.child_process import Limits

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130  # exit statuses
FORMATS, FORMAT_HELP = ("text", "md", "csv", "latex", "json"), "csv and json hold the plain numbers"
_FLAGS = (
    ("--dry-run", "say how many trials there are and how long they may take; do nothing"),
    ("--live", "show the table of results so far every few seconds"),
    ("--retry-failed", "do trials that are stored as failed again"),
    ("--no-trajectories", "keep the rows alone: saves disk space, and costs error curves and reports"),
)


def add_set(parser: argparse.ArgumentParser, example: str) -> None:
    """Add `--set`."""
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="sets",
        help=f"change one key, as in {example}; may be repeated; 'cellslam show' lists the keys",
    )


def add_options_file(parser: argparse.ArgumentParser) -> None:
    """Add `--options`."""
    parser.add_argument(
        "--options",
        metavar="FILE.toml",
        help="take estimators' options from the tables [estimator.NAME] of a file, as fit-noise prints them, and the "
        "odometry's data sheet from its [noise.COMPONENT]; --set goes before it",
    )
    parser.add_argument(
        "--fit",
        action=argparse.BooleanOptionalAction,
        help="first learn the sizes of all errors from the recording (default: for measured ones, without --options)",
    )


def add_estimators(parser: argparse.ArgumentParser) -> None:
    """Add `--estimator`."""
    parser.add_argument(
        "--estimator",
        metavar="NAME",
        action="append",
        default=[],
        dest="estimators",
        help="estimator by name or as module:Class, or all; may be repeated (default: fastslam, ekf-slam and "
        "dead-reckoning)",
    )


def add_scenario(parser: argparse.ArgumentParser) -> None:
    """Add SCENARIO and `--set`."""
    parser.add_argument("scenario", metavar="SCENARIO", help="name of a preset, or path of a .toml file")
    add_set(parser, "radio.detection_scale=0.8")


def add_seed(parser: argparse.ArgumentParser, default: int | None, meaning: str) -> None:
    """Add `--seed`."""
    parser.add_argument("--seed", metavar="S", type=whole, default=default, help=meaning)


def add_estimation(parser: argparse.ArgumentParser) -> None:
    """Add what `run` and `replay` share: `--estimator`, `--json`, `--no-figures`."""
    add_estimators(parser)
    parser.add_argument("--json", action="store_true", help="print the rows as one JSON array on stdout, nothing else")
    parser.add_argument("--no-figures", action="store_true", help="do not draw figures")
    add_limits(parser, "external estimators")


def add_work(parser: argparse.ArgumentParser) -> None:
    """Add what commands that sweep share: how much is done, and where."""
    for name, meaning in _FLAGS:
        parser.add_argument(name, action="store_true", help=meaning)
    names = ("serial", "processes", "dask")
    parser.add_argument("--executor", choices=names, default="processes", help="where to work (default: processes)")
    parser.add_argument("--jobs", metavar="N", type=whole, help="number of processes (default: one a core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running Dask scheduler, as tcp://host:8786")
    add_limits(parser, "every estimator")


def add_limits(parser: argparse.ArgumentParser, of: str) -> None:
    """Add the limits of what runs in a process of its own."""
    time_help = f"time of {of} for one trial, then its process is killed (default: 3600)"
    parser.add_argument("--time-limit", metavar="SECONDS", type=number, default=3600.0, help=time_help)
    parser.add_argument("--memory-limit", metavar="GIB", type=number, help="memory of a process (default: fair share)")


def limits(arguments: argparse.Namespace, jobs: int) -> Limits:
    """Return the limits that were asked for, of each of `jobs` processes. Raises InputError."""
    from cellslam.benchmarks.trials.child_process import Limits, shares

    for name, value in (("time", arguments.time_limit), ("memory", arguments.memory_limit)):
        if value is not None and not value > 0:
            raise InputError(f"--{name}-limit {value:g}: must be above 0")
    fair = shares(jobs, arguments.time_limit)
    return Limits(fair.seconds, int(arguments.memory_limit * 2**30)) if arguments.memory_limit else fair


def whole(text: str) -> int:
    """Return the whole number that a text says."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number") from None


def number(text: str) -> float:
    """Return the number that a text says."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None
