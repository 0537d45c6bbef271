"""`cellslam show`: every key of a scenario."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import BaseModel
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from cellslam.cli.arguments import add
from cellslam.cli.output import console, plain_table
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.keys import Key, describe
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.slam import registry

EXAMPLES = ("show tiny", "show lund-530 radio")
PIPE_WIDTH, WIDTH_OF_TABLE = 160, 130
NOT_KEYS = ("name", "title", "description", "facts", "estimator")


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "scenario", "--set")
    only_help = "only keys with all of these in name or meaning, as in: radio noise"
    parser.add_argument("only", metavar="WORD", nargs="*", help=only_help)


def command(arguments: Namespace) -> None:
    overrides = parse_all(arguments.sets)
    scenario = load(arguments.scenario, overrides)
    keys = [key for key in _keys(scenario, overrides) if all(w in f"{key.name} {key.meaning}" for w in arguments.only)]
    out = console(PIPE_WIDTH)
    out.print(escape(f"{scenario.name}: {scenario.title}\n{scenario.description}".strip()), highlight=False)
    if not keys:
        raise InputError(f"no key of {scenario.name} has {' and '.join(arguments.only)} in its name or meaning")
    if out.width < WIDTH_OF_TABLE:
        _print_narrow(out, keys)
    else:
        out.print(_wide_table(keys))


def _keys(scenario: Scenario, overrides: dict[str, Any]) -> Iterator[Key]:
    """Yield the keys of a scenario's world, then those of all estimators' options."""
    yield from (key for key in describe(scenario) if key.name.partition(".")[0] not in NOT_KEYS)
    names = dict.fromkeys([*(entry.name for entry in registry.BUILT_IN), *scenario.estimator])
    for request in resolve(scenario.estimator, tuple(names), overrides):
        if isinstance(request.options, BaseModel):
            yield from describe(request.options, f"estimator.{request.name}.")


def _wide_table(keys: Iterable[Key]) -> Table:
    table = plain_table("key", expand=True)
    table.add_column("value", overflow="fold", max_width=24)
    table.add_column("unit", no_wrap=True)
    table.add_column("range", max_width=24)
    table.add_column("meaning", ratio=1, min_width=20)
    for key in keys:
        table.add_row(*map(escape, (key.name, _value(key.value), key.unit, key.allowed, key.meaning)))
    return table


def _print_narrow(out: Console, keys: Iterable[Key]) -> None:
    for key in keys:
        unit, allowed = f" {key.unit}" if key.unit else "", f"  ({key.allowed})" if key.allowed else ""
        out.print(escape(f"{key.name} = {_value(key.value)}{unit}{allowed}"), highlight=False)
        if key.meaning:
            out.print(Padding(escape(key.meaning), (0, 0, 0, 4)), highlight=False, style="dim")


def _value(value: Any) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, default=str)
