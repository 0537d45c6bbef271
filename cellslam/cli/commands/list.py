"""`cellslam list`: the scenarios, suites and estimators that are known by name."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from rich.markup import escape
from rich.table import Table

from cellslam.cli.output import console, plain_table
from cellslam.scenarios.loading import load, preset_names
from cellslam.scenarios.suites import SUITES, scenario_of, superseded_by
from cellslam.slam import registry

EXAMPLES = ("list scenarios",)
PIPE_WIDTH = 100
HOME = "cellslam.slam."
# Facts of a scenario's first drive, and how their columns are headed.
FACTS = {
    "duration_s": "length\n(s)", "distance_m": "length\n(m)", "paths_per_site": "paths\na site",
    "distinct_vts": "VTs", "measurements_per_snapshot": "paths\nmeasured",
}  # fmt: skip


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("kind", nargs="?", choices=TABLES, help="what to list (default: all)")


def command(arguments: Namespace) -> None:
    out = console(PIPE_WIDTH)
    for kind, table in TABLES.items():
        if arguments.kind in (None, kind):
            out.print(table())


def _estimators() -> Table:
    table = plain_table("name")
    table.add_column("what it is")
    table.add_column(f"class (of {HOME[:-1]})", no_wrap=True)
    for entry in registry.listing():
        table.add_row(*map(escape, (entry.name, entry.summary, entry.target.removeprefix(HOME))))
    return table


def _scenarios() -> Table:
    table = plain_table("scenario")
    table.add_column("what it is")
    for title in FACTS.values():
        table.add_column(title, justify="right")
    for scenario in (load(name) for name in preset_names()):
        facts = (f"{scenario.facts[key]:g}" if key in scenario.facts else "" for key in FACTS)
        table.add_row(scenario.name, escape(scenario.title), *facts)
    return table


def _suites() -> Table:
    latest = next(suite for suite in SUITES.values() if superseded_by(suite) is None)
    table = plain_table(f"scenario of {latest.name}")
    table.add_column("what it is")
    table.add_column("trials", justify="right")
    for name in latest.scenarios:
        table.add_row(name, escape(scenario_of(latest, name).title), str(latest.trials_of(name)))
    return table


TABLES = {"scenarios": _scenarios, "suites": _suites, "estimators": _estimators}
