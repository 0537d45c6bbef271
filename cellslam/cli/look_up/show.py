"""`cellslam show`: every key of a scenario."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import BaseModel
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from cellslam.cli.arguments import DONE, add_scenario
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.keys import Key, describe
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.slam import registry

_PIPE_WIDTH = 160
_WIDTH_OF_TABLE = 130
_NOT_KEYS = ("name", "title", "description", "facts", "estimator")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scenario(parser)
    parser.add_argument(
        "only", metavar="WORD", nargs="*", help="only keys with all of these in name or meaning, as in: radio noise"
    )


def command(arguments: Namespace) -> int:
    """Carry out `cellslam show`."""
    overrides = parse_all(arguments.sets)
    scenario = load(arguments.scenario, overrides)
    names = dict.fromkeys([*(entry.name for entry in registry.BUILT_IN), *scenario.estimator])
    requests = resolve(scenario.estimator, tuple(names), overrides)
    console = _console()
    console.print(escape(f"{scenario.name}: {scenario.title}\n{scenario.description}".strip()), highlight=False)
    keys = [*_world_keys(scenario), *_option_keys((r.name, r.options) for r in requests)]
    keys = [key for key in keys if all(word in f"{key.name} {key.meaning}" for word in arguments.only)]
    if not keys:
        raise InputError(f"no key of {scenario.name} has {' and '.join(arguments.only)} in its name or meaning")
    if console.width < _WIDTH_OF_TABLE:
        _print_narrow(console, keys)
    else:
        console.print(_wide_table(keys))
    return DONE


def _wide_table(keys: Iterable[Key]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, expand=True)
    table.add_column("key", no_wrap=True)
    table.add_column("value", overflow="fold", max_width=24)
    table.add_column("unit", no_wrap=True)
    table.add_column("range", max_width=24)
    table.add_column("meaning", ratio=1, min_width=20)
    for key in keys:
        table.add_row(*map(escape, (key.name, _value(key.value), key.unit, key.allowed, key.meaning)))
    return table


def _print_narrow(console: Console, keys: Iterable[Key]) -> None:
    for key in keys:
        unit, allowed = f" {key.unit}" if key.unit else "", f"  ({key.allowed})" if key.allowed else ""
        console.print(escape(f"{key.name} = {_value(key.value)}{unit}{allowed}"), highlight=False)
        if key.meaning:
            console.print(Padding(escape(key.meaning), (0, 0, 0, 4)), highlight=False, style="dim")


def _world_keys(scenario: Scenario) -> Iterator[Key]:
    return (key for key in describe(scenario) if key.name.partition(".")[0] not in _NOT_KEYS)


def _option_keys(options: Any) -> Iterator[Key]:
    for name, model in options:
        if isinstance(model, BaseModel):
            yield from describe(model, f"estimator.{name}.")


def _value(value: Any) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=_PIPE_WIDTH)
