"""`cellslam dataset check`: whether a set of drives is as it was made."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.cli.arguments import add
from cellslam.cli.output import note
from cellslam.progress_bars import bars
from cellslam.scenarios.sets.reading import index_of

EXAMPLES = ("dataset check learn-lund",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder", help="folder of a set")


def command(arguments: Namespace) -> None:
    from cellslam.recordings.sets.making import check

    folder, snapshots = Path(arguments.folder), 0
    with bars(arguments.quiet) as progress, progress("drives", len(index_of(folder))) as advance:
        for row in check(folder):
            snapshots += row.snapshots
            advance(1)
    note(arguments, f"{folder}: {len(index_of(folder))} files with {snapshots} snapshots are as they were made")
