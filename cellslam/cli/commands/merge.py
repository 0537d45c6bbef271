"""`cellslam merge`: the shards of a sweep as one database, and what is missing of them."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.sweeps.shards import merge, missing
from cellslam.benchmarks.sweeps.store import DATABASE, lost_in_words
from cellslam.cli.arguments import DONE, FAILED, add
from cellslam.cli.output import note

EXAMPLES = ("merge load",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder", help="folder of a sweep's shards")


def command(arguments: Namespace) -> int:
    folder = Path(arguments.folder)
    print(f"{merge(folder)} rows are in {folder / DATABASE}")
    note(arguments, lost_in_words(folder))
    lacking = missing(folder)
    for line, (rows, of) in lacking.items():
        print(f"missing: {rows} of {of} rows of: {line}")
    return FAILED if lacking else DONE
