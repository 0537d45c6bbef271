"""The command line. What is heavy is imported by the command that needs it: `--help` is immediate."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple, NoReturn

from cellslam.benchmarks.cli.arguments import DONE, INTERRUPTED, WRONG
from cellslam.sim.errors import InputError, nearest_name


class Command(NamedTuple):
    """A command: its module in this room, which has `add_arguments` and `command`, and one line about it."""

    module: str
    summary: str


COMMANDS = {
    "run": Command("run", "simulate a scenario, run estimators on it, score them"),
    "record": Command("recordings.record", "simulate a scenario and keep it as a recording"),
    "simulate-from": Command("recordings.simulate_from", "a recording of paths that another ray tracer found"),
    "replay": Command("recordings.replay", "run estimators on a recording and score them"),
    "import": Command(
        "recordings.import_campaign", "a recording of measured data: tables with recording.toml, or an adapter"
    ),
    "inspect": Command("recordings.inspect", "what is in a recording, what is missing, what looks wrong"),
    "export": Command("recordings.export", "a recording or an estimate as CSV, .mat, TUM, GeoJSON, PLY or HTML"),
    "fit-noise": Command("recordings.fit_noise", "noise, detection and clutter as the recording itself shows them"),
    "sweep": Command("sweep", "many variants and trials of a scenario, in parallel, resumable"),
    "reproduce": Command("reproduce", "the published figures of a known world of others, beside one's own"),
    "table": Command("results.table", "the results of a sweep as a table"),
    "consistency": Command("results.consistency", "whether estimators know how wrong they are: errors and claims"),
    "figures": Command("results.figures", "the figures of a sweep, as PNG and PDF"),
    "report": Command("results.report", "one HTML page of a sweep: tables, plots, worst trials"),
    "show": Command("show", "every key of a scenario: value, unit, range, meaning"),
    "list": Command("list_known", "the scenarios or estimators that are known by name"),
    "check-estimator": Command("check_estimator", "check an estimator against the contract; say what to fix"),
}
GROUPS = {
    "city": (
        "look at cities, generate them, trace paths in them",
        {
            "inspect": Command("city.inspect", "what a city consists of, and pictures of it"),
            "generate": Command("city.generate", "draw a city, and write it with a scenario that drives in it"),
            "trace": Command("city.trace", "all paths from transmitters to receivers, as a table"),
        },
    ),
    "bench": (
        "measure how fast parts of it are",
        {
            "front-end": Command("bench.front_end", "what the path estimator finds, how well, and how fast"),
            "calibrate": Command("bench.calibrate", "constants of the statistical front end, or their check"),
            "snapshot": Command("bench.snapshot", "picture of one snapshot at signal level: spectrum and paths"),
            "fastslam": Command("bench.fastslam", "what a drive, an update and a particle of FastSLAM cost"),
            "rays": Command("bench.rays", "time the ray tracer, beside Sionna RT and DiffeRT where installed"),
            "accuracy": Command("bench.accuracy", "a fixed suite of scenarios, seeds and trials, for comparison"),
            "leaderboard": Command("bench.leaderboard", "one page of all entries to a suite, the best first"),
            "monte-carlo": Command("bench.monte_carlo", "time sweeps: rates, overhead, tables"),
        },
    ),
}
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
        arguments = build_parser(words).parse_args(words)
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


def build_parser(words: Sequence[str] | None = None) -> argparse.ArgumentParser:
    """Return the parser of all commands; each sets `command`, a function of the arguments.

    `words`: the command line; only the command that it names is imported and gets its arguments (None: all do).
    """
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
    for name, command in COMMANDS.items():
        _add(commands, common, name, command, words)
    for group, (summary, members) in GROUPS.items():
        inner = commands.add_parser(group, help=summary, description=summary, allow_abbrev=False)
        nested = inner.add_subparsers(
            title="commands", metavar="COMMAND", dest=f"{group}_command", required=True, parser_class=Parser
        )
        for name, command in members.items():
            _add(nested, common, name, command, words)
    return parser


def _add(commands: Any, common: Parser, name: str, command: Command, words: Sequence[str] | None) -> None:
    """Add one command; its module is imported where `words` may name it."""
    sub = commands.add_parser(
        name, parents=[common], help=command.summary, description=command.summary, allow_abbrev=False
    )
    if words is None or name in words:
        module = import_module(f"cellslam.benchmarks.cli.{command.module}")
        module.add_arguments(sub)
        sub.set_defaults(command=module.command)


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
