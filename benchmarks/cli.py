"""The command line. What is heavy is imported by the command that needs it: `--help` is immediate."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any, NoReturn

from cellslam.benchmarks.cli_city_parsers import add_bench, add_city
from cellslam.benchmarks.cli_recordings_parsers import COMMANDS
from cellslam.sim.errors import InputError, nearest_name

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130
_DESCRIPTION = """\
Position a vehicle with cellular multipath: simulate a drive through a ray-traced city,
run estimators on it, and score them.
"""
_EXAMPLES = """\
examples:
  cellslam run tiny                                  a drive of seconds, for first contact
  cellslam run lund-530 --seed 7                     the drive of the paper, another trial
  cellslam run lund-530 --trials 10 --json           ten trials, their rows as JSON
  cellslam run munich-530 --set radio.clutter_scale=2 --estimator my_module:MyEstimator
  cellslam record tiny --out tiny.h5                 keep the measurements ...
  cellslam replay tiny.h5 --estimator fastslam       ... and estimate again from them
  cellslam import campaign --out drive.h5            measured data: tables and recording.toml to a recording
  cellslam inspect drive.h5                          ... what is in it, what is missing, what looks wrong
  cellslam sweep tiny --sweep radio.load=0,0.5 --trials 20 --out s     many variants, in parallel
  cellslam show tiny                                 every key that --set can change
  cellslam city trace sionna-rt:munich --bs=42,-50,30 --rx rx.csv --out paths.csv    paths for other work
"""


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, with the nearest name, and exits with status 2."""

    def error(self, message: str) -> NoReturn:
        """Print one line and exit."""
        choice = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message)
        if choice:
            names = [name.strip("' ") for name in choice[2].split(",")]
            near = nearest_name(choice[1], names)
            message = f"unknown {_kind(message)} '{choice[1]}'{near} (known: {', '.join(names)})"
        sys.stderr.write(f"cellslam: {message}; see '{self.prog} --help'\n")
        raise SystemExit(WRONG)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's own) and return the exit status.

    0 done, 1 a trial failed, 2 the request was wrong, 130 interrupted.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        arguments = build_parser().parse_args(words)
        arguments.words = words
        status: int = arguments.command(arguments)
        sys.stdout.flush()
        return status
    except InputError as error:
        sys.stderr.write(f"cellslam: {error}\n")
        return WRONG
    except KeyboardInterrupt:
        sys.stderr.write("cellslam: interrupted\n")
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands; each sets `command`, a function of the arguments."""
    common = Parser(add_help=False)
    common.add_argument(
        "--quiet", action="store_true", default=argparse.SUPPRESS, help="no progress and no notes on stderr"
    )
    parser = Parser(
        prog="cellslam",
        description=_DESCRIPTION,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, help="show the version and exit")
    parser.add_argument("--quiet", action="store_true", default=False, help="no progress, no notes on stderr")
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", dest="command_name", required=True, parser_class=Parser
    )
    add = partial(_add, commands, common)
    _add_run(add("run", "cli_run:run", "simulate a scenario, run estimators on it, score them"))
    _add_record(add("record", "cli_recording:record", "simulate a scenario and keep it as a recording"))
    _add_replay(add("replay", "cli_recording:replay", "run estimators on a recording and score them"))
    for name, target, summary, fill in COMMANDS:
        fill(add(name, f"cli_recordings:{target}", summary))
    _add_sweep(add("sweep", "cli_sweep:sweep", "many variants and trials of a scenario, in parallel, resumable"))
    _add_table(add("table", "cli_table:table", "the results of a sweep as a table"))
    _add_figures(add("figures", "cli_table:figures", "the figures of a sweep, as PNG and PDF"))
    _add_report(add("report", "cli_table:report", "one HTML page of a sweep: tables, plots, worst trials"))
    show = add("show", "cli_show:show", "every key of a scenario: value, unit, range, meaning")
    _add_scenario(show)
    listing = add("list", "cli_show:list_known", "the scenarios or estimators that are known by name")
    listing.add_argument("kind", choices=("scenarios", "estimators"), help="what to list")
    _add_check(add("check-estimator", "cli_check:check", "check an estimator against the contract; say what to fix"))
    for name, summary, fill in (
        ("city", "look at cities, generate them, trace paths in them", add_city),
        ("bench", "measure how fast parts of it are", add_bench),
    ):
        group = commands.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        nested = group.add_subparsers(
            title="commands", metavar="COMMAND", dest=f"{name}_command", required=True, parser_class=Parser
        )
        fill(partial(_add, nested, common))
    return parser


def _add(commands: Any, common: Parser, name: str, target: str, summary: str) -> argparse.ArgumentParser:
    """Add one command: its parser, and the function `module:function` that carries it out."""
    sub: argparse.ArgumentParser = commands.add_parser(
        name, parents=[common], help=summary, description=summary, allow_abbrev=False
    )
    sub.set_defaults(command=_late(target))
    return sub


def _add_scenario(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", help="name of a preset, or path of a .toml file")
    _add_set(parser, "radio.detection_scale=0.8")


def _add_set(parser: argparse.ArgumentParser, example: str) -> None:
    parser.add_argument(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="sets",
        help=f"change one key, as in {example}; may be repeated; 'cellslam show' lists the keys",
    )


def _add_seed(parser: argparse.ArgumentParser, default: int | None, meaning: str) -> None:
    parser.add_argument("--seed", metavar="S", type=_whole, default=default, help=meaning)


def _add_estimators(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--estimator",
        metavar="NAME",
        action="append",
        default=[],
        dest="estimators",
        help="estimator by name or as module:Class; may be repeated (default: fastslam and dead-reckoning)",
    )


def _add_estimation(parser: argparse.ArgumentParser) -> None:
    _add_estimators(parser)
    parser.add_argument("--json", action="store_true", help="print the rows as one JSON array on stdout, nothing else")
    parser.add_argument("--no-figures", action="store_true", help="do not draw figures")


def _add_run(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    _add_estimation(parser)
    parser.add_argument("--rays", action="store_true", help="draw the drive's rays, also as an interactive page")
    parser.add_argument("--trials", metavar="N", type=_whole, default=1, help="trials 0 to N-1 (default: 1)")
    _add_seed(parser, 0, "root seed of all random draws (default: 0)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/SCENARIO-SEED)")


def _add_record(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    parser.add_argument("--out", metavar="FILE.h5", required=True, help="the HDF5 file to write")
    _add_seed(parser, 0, "root seed of all random draws (default: 0)")
    parser.add_argument("--trial", metavar="N", type=_whole, default=0, help="which trial to record (default: 0)")


def _add_replay(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    _add_set(parser, "estimator.fastslam.particles=300")
    _add_estimation(parser)
    parser.add_argument(
        "--align", action="store_true", help="lay each estimate onto the truth before it is scored, and say so in its row"
    )
    _add_seed(parser, None, "seed of the estimators' random draws (default: the recording's own)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/replay-FILE)")


def _add_check(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("estimator", metavar="MODULE:CLASS", help="your class, or the name of a known estimator")
    _add_set(parser, "estimator.fastslam.particles=300")


def _add_sweep(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", help="a preset's name, a scenario file, or a sweep file")
    _add_set(parser, "radio.load=0.5")
    parser.add_argument(
        "--sweep",
        metavar="KEY=V1,V2,...",
        action="append",
        default=[],
        dest="sweeps",
        help="values of one key; may be repeated: all combinations",
    )
    _add_estimators(parser)
    parser.add_argument("--trials", metavar="N", type=_whole, help="trials 0 to N-1 of each point (default: 1)")
    _add_seed(parser, None, "root seed of all random draws (default: 0)")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder of the results; one that exists is resumed")
    _add_flags(
        parser,
        ("--dry-run", "say how many trials there are and how long they may take; do nothing"),
        ("--live", "show the table of results so far every few seconds"),
        ("--retry-failed", "do trials that are stored as failed again"),
        ("--no-trajectories", "keep the rows alone: saves disk space, and costs error curves and reports"),
    )
    names = ("serial", "processes", "dask")
    parser.add_argument("--executor", choices=names, default="processes", help="where to work (default: processes)")
    parser.add_argument("--jobs", metavar="N", type=_whole, help="number of processes (default: one a core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running Dask scheduler, as tcp://host:8786")
    time_help = "one estimator's time for one trial, then its process is killed (default: 3600)"
    parser.add_argument("--time-limit", metavar="SECONDS", type=_number, default=3600.0, help=time_help)
    parser.add_argument("--memory-limit", metavar="GIB", type=_number, help="memory of a process (default: fair share)")


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
    parser.add_argument("--interval", metavar="PERCENT", type=_number, nargs="?", const=95.0, help=interval_help)
    parser.add_argument("--compare", metavar="A,B", help="paired differences of two estimators on the same worlds")
    formats = ("text", "md", "csv", "latex", "json")
    parser.add_argument("--format", choices=formats, default="text", help="csv and json hold the plain numbers")


def _add_figures(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="folder of a sweep")
    parser.add_argument("--x", metavar="KEY", help="key along the sweep curve (default: the first number that varies)")
    parser.add_argument("--metric", metavar="NAME", default="position_rmse_m", help="default: position_rmse_m")
    parser.add_argument("--statistic", metavar="NAME", default="median", help="as for 'table' (default: median)")
    interval_help = "confidence of the intervals (default: 95)"
    parser.add_argument("--interval", metavar="PERCENT", type=_number, default=95.0, help=interval_help)
    parser.add_argument("--out", metavar="FOLDER", help="where to write (default: DIR/figures)")


def _add_report(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", metavar="DIR", help="folder of a sweep")
    parser.add_argument("--out", metavar="FILE.html", help="the page to write (default: DIR/report.html)")
    parser.add_argument("--worst", metavar="N", type=_whole, default=3, help="trials with a section each (default: 3)")
    metric_help = "by which trials are the worst (default: position_rmse_m)"
    parser.add_argument("--metric", metavar="NAME", default="position_rmse_m", help=metric_help)
    estimators_help = "whose worst trials; may be repeated (default: the estimator with the best median)"
    parser.add_argument(
        "--estimator", metavar="NAME", action="append", default=[], dest="estimators", help=estimators_help
    )


def _add_flags(parser: argparse.ArgumentParser, *flags: tuple[str, str]) -> None:
    for name, meaning in flags:
        parser.add_argument(name, action="store_true", help=meaning)


def _late(target: str) -> Callable[[argparse.Namespace], int]:
    """Return a command that imports its module when it is called."""
    module, _, name = target.partition(":")

    def command(arguments: argparse.Namespace) -> int:
        status: int = getattr(import_module(f"cellslam.benchmarks.{module}"), name)(arguments)
        return status

    return command


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number") from None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None


def _kind(message: str) -> str:
    return "command" if "COMMAND" in message else "value"


class _Version(argparse.Action):
    """Prints the version; the package metadata are read only when asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str, **kwargs: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, default=argparse.SUPPRESS, help=kwargs.get("help"))

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print and exit."""
        from importlib.metadata import version

        sys.stdout.write(f"cellslam {version('cellslam')}\n")
        parser.exit()
