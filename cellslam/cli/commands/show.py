"""`cellslam show`: the keys of a scenario."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from pydantic import BaseModel
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from cellslam.cli.arguments import FLAG, add
from cellslam.cli.cities import note_own_city
from cellslam.cli.output import console, note, plain_table
from cellslam.scenarios.estimator_options import own_code, resolve
from cellslam.scenarios.keys import Key, describe
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.slam import registry

EXAMPLES = ("show tiny", "show lund-530 radio", "show lund-530 --all")
PIPE_WIDTH, WIDTH_OF_TABLE = 160, 130
MORE = "`cellslam show {0} WORD` shows those with a word in name or meaning, `cellslam show {0} --all` every key"
NOT_KEYS = ("name", "title", "description", "facts", "estimator")


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "scenario", "--set")
    only_help = "all keys with all of these in name or meaning, as in: radio noise"
    all_help = "every key, also those at their defaults"
    load_help = "import the code that the scenario names, too, to show the options of its estimators"
    parser.add_argument("--load", help=load_help, **FLAG)
    parser.add_argument("--all", dest="every", help=all_help, **FLAG)
    parser.add_argument("only", metavar="WORD", nargs="*", help=only_help)


def command(arguments: Namespace) -> None:
    scenario = load(arguments.scenario, parse_all(arguments.sets), code=arguments.load)
    code = {} if arguments.load else _code(scenario)
    known = [key for key in _keys(scenario, code) if all(w in f"{key.name} {key.meaning}" for w in arguments.only)]
    keys = known if arguments.every or arguments.only else [key for key in known if key.changed]
    out = console(PIPE_WIDTH)
    out.print(escape(f"{scenario.name}: {scenario.title}\n{scenario.description}".strip()), highlight=False)
    if not known:
        raise InputError(f"no key of {scenario.name} has {' and '.join(arguments.only)} in its name or meaning")
    if keys and out.width < WIDTH_OF_TABLE:
        _print_narrow(out, keys)
    elif keys:
        out.print(_wide_table(keys))
    if len(keys) < len(known):
        out.print(escape(f"\nat their defaults: {_sections(known)}\n{MORE.format(scenario.name)}"), highlight=False)
    note(arguments, f"not loaded, as it is code or a file: {', '.join(code)}; --load loads it" if code else "")
    try:
        note_own_city(arguments, scenario)
    except InputError as error:  # its keys are right
        note(arguments, f"note: {error}")


def _code(scenario: Scenario) -> dict[str, str]:
    """Return all code that a scenario names, by key. To look at a scenario runs none of it."""
    built_in, known = {entry.name for entry in registry.BUILT_IN}, registry.names()
    others = [name for name in scenario.estimator if name not in built_in and (":" in name or name in known)]
    return {
        **scenario.radio.unasked(),
        **own_code(scenario.estimator),
        **{f"estimator.{name}": name for name in others},
    }


def _keys(scenario: Scenario, code: Mapping[str, str]) -> Iterator[Key]:
    """Yield the keys of a scenario's world, then those of all estimators' options; what is `code` is not loaded."""
    yield from (key for key in describe(scenario) if key.name.partition(".")[0] not in NOT_KEYS)
    tables = {
        name: {key: value for key, value in table.items() if f"estimator.{name}.{key}" not in code}
        for name, table in scenario.estimator.items()
        if f"estimator.{name}" not in code
    }
    names = dict.fromkeys([*(entry.name for entry in registry.BUILT_IN), *tables])
    for request in resolve(tables, tuple(names)):
        if isinstance(request.options, BaseModel):
            for key in describe(request.options, f"estimator.{request.name}."):
                named = key.name in code
                yield replace(key, value=code[key.name], changed=True) if named else key


def _sections(keys: Iterable[Key]) -> str:
    """Return how many keys of each section are at their defaults. An estimator's options are a section of their own."""
    parts = (key.name.split(".") for key in keys if not key.changed)
    counts = Counter(".".join(part[: 2 if part[0] == "estimator" else 1]) for part in parts)
    return ", ".join(f"{section} ({count})" for section, count in counts.items())


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
