"""`cellslam dataset list`: the sets of drives that are known by name."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from rich.markup import escape

from cellslam.cli.output import console, plain_table
from cellslam.scenarios.sets import SETS, SPLITS

EXAMPLES = ("dataset list",)
PIPE_WIDTH = 100


def add_arguments(parser: ArgumentParser) -> None:
    del parser


def command(arguments: Namespace) -> None:
    del arguments
    table = plain_table("set")
    table.add_column("what it is")
    for split in SPLITS:
        table.add_column(split, justify="right")
    for one in SETS.values():
        table.add_row(one.name, escape(one.title), *(str(one.drives[split]) for split in SPLITS))
    console(PIPE_WIDTH).print(table)
