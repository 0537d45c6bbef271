"""`cellslam consistency`: whether estimators know how wrong they are."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.sweeps.rows import oracles
from cellslam.benchmarks.sweeps.store import lost_in_words
from cellslam.benchmarks.tables.formats import consistency_grid, render
from cellslam.benchmarks.tables.summaries import Layout, row_keys
from cellslam.cli.arguments import add, whole
from cellslam.cli.output import note

EXAMPLES = ("consistency load",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder", "--rows", "--format")
    parser.add_argument("--times", metavar="N", type=whole, default=10, help="moments of the drive (default: 10)")


def command(arguments: Namespace) -> None:
    from cellslam.benchmarks.tables.consistency import consistency as measured

    folder = Path(arguments.folder)
    keys = row_keys(folder, Layout(rows=tuple(arguments.rows) or None))
    tidy = measured(folder, arguments.times, keys)
    note(arguments, lost_in_words(folder))
    sys.stdout.write(render(tidy, consistency_grid(tidy, keys, oracles(folder)), arguments.format))
