"""`cellslam show` and `cellslam list`."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import BaseModel
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from cellslam.benchmarks.cli import DONE
from cellslam.scenarios.keys import Key, describe, unit_of
from cellslam.scenarios.loading import load, preset_names
from cellslam.scenarios.model import Scenario
from cellslam.scenarios.options import resolve
from cellslam.scenarios.overrides import parse_all
from cellslam.slam import registry

_PIPE_WIDTH = 160
_WIDTH_OF_TABLE = 130
_NOT_KEYS = ("name", "title", "description", "facts", "estimator")


def show(arguments: Namespace) -> int:
    """Carry out `cellslam show`."""
    overrides = parse_all(arguments.sets)
    scenario = load(arguments.scenario, overrides)
    names = dict.fromkeys([*(entry.name for entry in registry.BUILT_IN), *scenario.estimator])
    requests = resolve(scenario.estimator, tuple(names), overrides)
    console = _console()
    console.print(escape(f"{scenario.name}: {scenario.title}\n{scenario.description}".strip()), highlight=False)
    keys = [*_world_keys(scenario), *_option_keys((r.name, r.options) for r in requests)]
    if console.width < _WIDTH_OF_TABLE:
        _print_narrow(console, keys)
    else:
        console.print(_wide_table(keys))
    return DONE


def list_known(arguments: Namespace) -> int:
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


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _value(value: Any) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=_PIPE_WIDTH)
