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
from cellslam.benchmarks.cli_options import add_estimators, add_options_file, add_set, whole
from cellslam.benchmarks.cli_recordings_parsers import COMMANDS
from cellslam.benchmarks.cli_sweep_parsers import add_sweep_benches, add_sweeps
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
    for name, target, summary, arguments_of in COMMANDS:
        arguments_of(add(name, f"cli_recordings:{target}", summary))
    add_sweeps(add)
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
        if name == "bench":
            add_sweep_benches(partial(_add, nested, common))
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
    add_set(parser, "radio.detection_scale=0.8")


def _add_seed(parser: argparse.ArgumentParser, default: int | None, meaning: str) -> None:
    parser.add_argument("--seed", metavar="S", type=whole, default=default, help=meaning)


def _add_estimation(parser: argparse.ArgumentParser) -> None:
    add_estimators(parser)
    parser.add_argument("--json", action="store_true", help="print the rows as one JSON array on stdout, nothing else")
    parser.add_argument("--no-figures", action="store_true", help="do not draw figures")


def _add_run(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    _add_estimation(parser)
    parser.add_argument("--rays", action="store_true", help="draw the drive's rays, also as an interactive page")
    parser.add_argument("--trials", metavar="N", type=whole, default=1, help="trials 0 to N-1 (default: 1)")
    _add_seed(parser, 0, "root seed of all random draws (default: 0)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/SCENARIO-SEED)")


def _add_record(parser: argparse.ArgumentParser) -> None:
    _add_scenario(parser)
    parser.add_argument("--out", metavar="FILE.h5", required=True, help="the HDF5 file to write")
    _add_seed(parser, 0, "root seed of all random draws (default: 0)")
    parser.add_argument("--trial", metavar="N", type=whole, default=0, help="which trial to record (default: 0)")


def _add_replay(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    add_set(parser, "estimator.fastslam.particles=300")
    add_options_file(parser)
    _add_estimation(parser)
    parser.add_argument(
        "--align",
        action="store_true",
        help="lay each estimate onto the truth before it is scored, and say so in its row",
    )
    _add_seed(parser, None, "seed of the estimators' random draws (default: the recording's own)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/replay-FILE)")


def _add_check(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("estimator", metavar="MODULE:CLASS", help="your class, or the name of a known estimator")
    add_set(parser, "estimator.fastslam.particles=300")


def _late(target: str) -> Callable[[argparse.Namespace], int]:
    """Return a command that imports its module when it is called."""
    module, _, name = target.partition(":")

    def command(arguments: argparse.Namespace) -> int:
        status: int = getattr(import_module(f"cellslam.benchmarks.{module}"), name)(arguments)
        return status

    return command


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
