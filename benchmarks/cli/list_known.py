"""`cellslam list`: the scenarios and estimators that are known by name."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from cellslam.benchmarks.cli.arguments import DONE
from cellslam.scenarios.keys import unit_of
from cellslam.scenarios.loading import load, preset_names
from cellslam.slam import registry

_PIPE_WIDTH = 160
_WIDTH_OF_TABLE = 130
_NOT_KEYS = ("name", "title", "description", "facts", "estimator")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("kind", choices=("scenarios", "estimators"), help="what to list")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam list`."""
    console = _console()
    if arguments.kind == "estimators":
        console.print(_estimators())
    else:
        _print_scenarios(console)
    return DONE


def _estimators() -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("name", no_wrap=True)
    table.add_column("what it is")
    table.add_column("class", overflow="fold")
    for entry in registry.listing():
        table.add_row(*map(escape, (entry.name, entry.summary, entry.target)))
    return table


def _print_scenarios(console: Console) -> None:
    for scenario in (load(name) for name in preset_names()):
        console.print(escape(f"{scenario.name}: {scenario.title}"), highlight=False)
        facts = ((*_fact(fact), _number(value)) for fact, value in scenario.facts.items())
        line = ", ".join(f"{name} {value}{f' {unit}' if unit else ''}" for name, unit, value in facts)
        console.print(Padding(escape(line), (0, 0, 0, 4)), highlight=False, style="dim")


def _fact(key: str) -> tuple[str, str]:
    """Return the words of a fact's key and its unit."""
    unit = unit_of(key)
    return (key.rpartition("_")[0] if unit else key).replace("_", " "), unit


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=_PIPE_WIDTH)
