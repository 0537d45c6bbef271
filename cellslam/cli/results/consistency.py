"""`cellslam consistency`: whether estimators know how wrong they are."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.tables.formats import consistency_grid, render
from cellslam.benchmarks.tables.summaries import Layout, row_keys
from cellslam.cli.arguments import DONE, FORMAT_HELP, FORMATS, whole
from cellslam.slam.registry import oracles


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("folder", metavar="DIR", help="folder of a run or a sweep")
    parser.add_argument("--times", metavar="N", type=whole, default=10, help="moments of the drive (default: 10)")
    rows_help = "a line for each value of this key; may be repeated (default: estimator and all that varies)"
    parser.add_argument("--rows", metavar="KEY", help=rows_help, action="append", default=[])
    parser.add_argument("--format", choices=FORMATS, default="text", help=FORMAT_HELP)


def command(arguments: Namespace) -> int:
    """Carry out `cellslam consistency`."""
    from cellslam.benchmarks.tables.consistency import consistency as measured

    folder = Path(arguments.folder)
    keys = row_keys(folder, Layout(rows=tuple(arguments.rows) or None))
    tidy = measured(folder, arguments.times, keys)
    named = tidy["estimator"].unique() if "estimator" in tidy else ()
    sys.stdout.write(render(tidy, consistency_grid(tidy, keys, oracles(named)), arguments.format))
    return DONE
