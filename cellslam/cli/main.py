"""The command line. What is heavy is imported by the command that needs it: `--help` is immediate."""

from __future__ import annotations

import argparse
import errno
import os
import re
import sys
import traceback
from collections.abc import Iterator, Sequence
from importlib import import_module
from types import ModuleType
from typing import Any, NoReturn

from cellslam.cli.arguments import DONE, INTERRUPTED, WRONG
from cellslam.sim.errors import InputError, nearest_name, one_line

# All commands by what they are for, each with one line about it. The first of two words is the name of a group, which
# the title of its section describes.
SECTIONS = {
    "simulate and estimate": {
        "run": "simulate a scenario, run estimators on it, score them",
        "init": "write a scenario file for a city, with a route and sites",
        "sweep": "run many variants and trials of a scenario, in parallel; can be resumed",
        "reproduce": "compute the published figures of another group's world, beside theirs",
        "check-estimator": "check an estimator against the contract, and name what to fix",
    },
    "results of a sweep": {
        "watch": "show how far a sweep is, here or elsewhere: time left, failures",
        "merge": "join the shards of a sweep, and list what is missing",
        "table": "print the results of a sweep as a table",
        "figures": "draw the figures of a sweep, as PNG and PDF",
        "report": "write one HTML page of a sweep: tables, plots, worst trials",
        "consistency": "compare the errors of estimators with the covariances that they claim",
        "integrity": "print protection levels: which alert limits estimators serve, how often they mislead",
        "fit-overbound": "fit, to training drives, how much claims must be widened for 'integrity'",
    },
    "recordings and measured data": {
        "record": "simulate a scenario and keep it as a recording",
        "replay": "run estimators on a recording and score them",
        "import": "make a recording of tables with a recording.toml, or by an adapter",
        "inspect": "print what a recording has, what is missing, what looks wrong",
        "export": "write a recording or an estimate as CSV, .mat, TUM, GeoJSON, PLY or HTML",
        "fit-noise": "estimate noise, detection and clutter from a recording",
        "simulate-from": "make a recording of paths that another ray tracer found",
    },
    "sets of drives to learn from": {
        "dataset list": "list the sets that are known by name",
        "dataset make": "simulate the drives of a set, in shards if need be",
        "dataset check": "check whether the drives of a set are as they were made",
    },
    "reference": {
        "list": "list the scenarios, suites and estimators that are known by name",
        "show": "print the keys of a scenario: value, unit, range, meaning",
        "doctor": "print versions, cores, caches and extras, to send with a question",
    },
    "maps that drives leave": {"map join": "join the maps that several vehicles left"},
    "cities, and the paths in them": {
        "city inspect": "print what a city consists of, and draw it",
        "city generate": "generate a city, with a scenario that drives in it",
        "city trace": "write all paths from transmitters to receivers as a table",
    },
    "accuracy on fixed suites, and one snapshot at signal level": {
        "bench accuracy": "score estimators on a fixed suite of scenarios, seeds and trials",
        "bench leaderboard": "write one page of all entries to a suite, the best first",
        "bench snapshot": "draw one snapshot at signal level: spectrum and paths",
    },
}
DESCRIPTION = """\
Position a vehicle with cellular multipath: simulate a drive through a ray-traced city,
run estimators on it, and score them.
"""
CLOSING = """\
'cellslam COMMAND --help' has examples. A first drive, of seconds: cellslam run tiny
"""
EVERYWHERE = {"--quiet": "print no progress and no notes on stderr", "--verbose": "print a traceback with each error"}
FORMAT: dict[str, Any] = {"formatter_class": argparse.RawDescriptionHelpFormatter, "allow_abbrev": False}


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, with the nearest name, and exits with status 2."""

    def error(self, message: str) -> NoReturn:
        """Print one line and exit."""
        choice = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message)
        if choice:
            kind = "command" if "COMMAND" in message else "value"
            names = [name.strip("' ") for name in choice[2].split(",")]
            message = f"unknown {kind} '{choice[1]}'{nearest_name(choice[1], names)} (known: {', '.join(names)})"
        sys.stderr.write(f"cellslam: {message}; see '{self.prog} --help'\n")
        raise SystemExit(WRONG)

    def refuse(self, word: str) -> NoReturn:
        """Say that there is no such argument, and what is like it."""
        known = [option for action in self._actions for option in action.option_strings]
        self.error(f"unknown argument '{word}'{nearest_name(word, known)}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's own) and return the exit status.

    0 done, 1 a trial failed, 2 the request was wrong, 130 interrupted.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if "_ARGCOMPLETE" in os.environ:  # a shell asks to complete its line
        complete(build_parser(os.environ["COMP_LINE"].split()))
    try:
        parser = build_parser(words)
        arguments, unknown = parser.parse_known_args(words)
        arguments.words = words
        if unknown:
            arguments.parser.refuse(unknown[0])
        if arguments.version:
            from importlib.metadata import version

            print(f"cellslam {version('cellslam')}")
            return DONE
        if arguments.command is None:
            parser.print_help()
            return DONE
        status: int = arguments.command(arguments) or DONE
        sys.stdout.flush()
        return status
    except InputError as error:
        if "--verbose" in words:
            traceback.print_exc()
        sys.stderr.write(f"cellslam: {one_line(error)}\n")  # what a file says cannot steer the terminal
        return WRONG
    except KeyboardInterrupt:
        sys.stderr.write("cellslam: interrupted\n")
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        sys.stderr.write(f"cellslam: '{one_line(error.filename, 60)}': a name that is too long for a file\n")
        return WRONG


def build_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of all commands; each sets `command`, a function of the arguments.

    `words`: the command line; only the command that it names is imported and gets its arguments.
    """
    common = Parser(add_help=False)
    parser = Parser(prog="cellslam", description=DESCRIPTION, epilog=_overview() + CLOSING, **FORMAT)
    parser.add_argument("--version", "-V", action="store_true", help="show the version and exit")
    for some in (parser, common):  # before the command, and after it
        for name, text in EVERYWHERE.items():
            some.add_argument(name, action="store_true", default=argparse.SUPPRESS, help=text)
    parser.set_defaults(command=None, parser=parser, quiet=False)
    groups: dict[str, Any] = {
        "": parser.add_subparsers(metavar="COMMAND", dest="command_name", help="as below", parser_class=Parser)
    }
    for title, commands in SECTIONS.items():
        for name, summary in commands.items():
            group, _, last = name.rpartition(" ")
            if group not in groups:
                groups[group] = _add_group(groups[""], common, group, title, words)
            listed = {"help": summary} if group else {}  # commands without a group are listed in the overview
            one = groups[group].add_parser(last, parents=[common], description=summary, **FORMAT, **listed)
            one.set_defaults(parser=one)
            if set(name.split()) <= set(words):
                module = module_of(name)
                one.epilog = _examples(module.EXAMPLES)
                module.add_arguments(one)
                one.set_defaults(command=module.command)
    return parser


def module_of(name: str) -> ModuleType:
    """Return the module of a command, as of "city trace"."""
    file = re.sub(r"\W", "_", name)
    return import_module(f"cellslam.cli.commands.{'import_' if file == 'import' else file}")


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell that asks to complete its line, and exit; needs the extra `completion`.

    Source: https://kislyuk.github.io/argcomplete.
    """
    import argcomplete
    from argcomplete.completers import FilesCompleter

    from cellslam.scenarios.loading import preset_names
    from cellslam.slam import registry

    files = FilesCompleter(("toml",))
    for action in _actions(parser):
        if action.dest == "scenario":
            action.completer = lambda prefix, **_: [*preset_names(), *files(prefix)]  # type: ignore[attr-defined]
        elif action.dest == "estimators":
            action.completer = lambda **_: registry.names()  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _add_group(commands: Any, common: Parser, group: str, title: str, words: Sequence[str]) -> Any:
    """Add a group of commands; return what takes its members."""
    parser = commands.add_parser(group, parents=[common], description=title, **FORMAT)
    if [word for word in words if not word.startswith("-")] == [group]:  # its own help is asked for
        parser.epilog = _examples([module_of(name).EXAMPLES[0] for name in SECTIONS[title]])
    return parser.add_subparsers(
        title="commands", metavar="COMMAND", dest=f"{group}_command", required=True, parser_class=Parser
    )


def _overview() -> str:
    """Return all commands by what they are for, a line each."""
    lines = []
    for title, commands in SECTIONS.items():
        lines += [f"{title}:", *(f"  {name:18}{summary}" for name, summary in commands.items()), ""]
    return "\n".join(lines) + "\n"


def _examples(lines: Sequence[str]) -> str:
    return "\n".join(["examples:", *(f"  cellslam {line}" for line in lines), ""])


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in dict.fromkeys(action.choices.values()):
                yield from _actions(inner)
        else:
            yield action
