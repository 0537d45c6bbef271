"""The command line. What is heavy is imported by the command that needs it: `--help` is immediate."""

from __future__ import annotations

import argparse
import os
import re
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from cellslam.cli.arguments import DONE, INTERRUPTED, WRONG
from cellslam.cli.commands import GROUPS, SECTIONS, Command
from cellslam.sim.errors import InputError, nearest_name

_DESCRIPTION = """\
Position a vehicle with cellular multipath: simulate a drive through a ray-traced city,
run estimators on it, and score them.
"""
_CLOSING = """\
'cellslam COMMAND --help' has examples. A first drive, of seconds: cellslam run tiny
"""
EVERYWHERE = {
    "--quiet": "no progress and no notes on stderr",
    "--verbose": "with the traceback of a wrong request",
}


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
        from cellslam.cli.look_up.completion import complete

        complete(build_parser(os.environ["COMP_LINE"].split()))
    try:
        parser = build_parser(words)
        arguments, unknown = parser.parse_known_args(words)
        arguments.words = words
        if unknown:
            arguments.parser.refuse(unknown[0])
        if arguments.command is None:
            parser.print_help()
            return DONE
        status: int = arguments.command(arguments)
        sys.stdout.flush()
        return status
    except InputError as error:
        if "--verbose" in words:
            traceback.print_exc()
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
    parser = Parser(
        prog="cellslam",
        description=_DESCRIPTION,
        epilog=_overview() + _CLOSING,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", "-V", action=_Version, help="show the version and exit")
    for some in (parser, common):  # before the command, and after it
        for name, text in EVERYWHERE.items():
            some.add_argument(name, action="store_true", default=argparse.SUPPRESS, help=text)
    parser.set_defaults(command=None, parser=parser, quiet=False)
    commands = parser.add_subparsers(metavar="COMMAND", dest="command_name", help="as below", parser_class=Parser)
    for section in SECTIONS.values():
        for name, command in section.items():
            _add(commands, common, name, command, words)
    for group, (summary, members) in GROUPS.items():
        first = tuple(command.examples[0] for command in members.values())
        inner = commands.add_parser(group, description=summary, epilog=_examples(first), **_look(common))
        nested = inner.add_subparsers(
            title="commands", metavar="COMMAND", dest=f"{group}_command", required=True, parser_class=Parser
        )
        for name, command in members.items():
            _add(nested, common, name, command, words, help=command.summary)
    return parser


def _overview() -> str:
    """Return all commands by what they are for, a line each."""
    grouped = {
        summary: {f"{group} {name}": command for name, command in members.items()}
        for group, (summary, members) in GROUPS.items()
    }
    lines = []
    for title, commands in (SECTIONS | grouped).items():
        lines += [f"{title}:", *(f"  {name:18}{command.summary}" for name, command in commands.items()), ""]
    return "\n".join(lines) + "\n"


def _add(
    commands: Any, common: Parser, name: str, command: Command, words: Sequence[str] | None, **listed: str
) -> None:
    """Add one command; its module is imported where `words` may name it. `listed`: its help in the list of commands."""
    look = _look(common) | listed
    sub = commands.add_parser(name, description=command.summary, epilog=_examples(command.examples), **look)
    sub.set_defaults(parser=sub)
    if words is None or name in words:
        module = import_module(f"cellslam.cli.{command.module}")
        module.add_arguments(sub)
        sub.set_defaults(command=module.command)


def _examples(lines: Sequence[str]) -> str:
    return "\n".join(["examples:", *(f"  cellslam {line}" for line in lines), ""])


def _look(common: Parser) -> dict[str, Any]:
    """Return what the parsers of all commands and groups have in common."""
    return {
        "parents": [common],
        "formatter_class": argparse.RawDescriptionHelpFormatter,
        "allow_abbrev": False,
    }


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
