"""`cellslam dataset make`: a named set of drives to learn from."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.cli.arguments import add
from cellslam.cli.output import note
from cellslam.progress_bars import bars
from cellslam.scenarios.sets import CARD, set_definition

EXAMPLES = ("dataset make learn-lund --out learn-lund", "dataset make learn-lund --out learn-lund --shard 1/2")


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", help="a set that 'cellslam dataset list' has")
    add(parser, "--out", required=True, help="folder of the set; drives that are there already stay")
    shard_help = "make the I-th of N shares of the drives; the last shard writes index and card"
    add(parser, "--shard", help=shard_help)


def command(arguments: Namespace) -> None:
    from cellslam.recordings.sets.making import finish, make

    one, folder = set_definition(arguments.name), Path(arguments.out)
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    number, count = arguments.shard or (1, 1)
    made = 0
    with bars(arguments.quiet) as progress, progress("drives", len(one.places[number - 1 :: count])) as advance:
        for files in make(one, folder, number, count):
            made += files
            advance(1)
    whole = finish(one, folder)
    says = f"{folder / CARD} describes the set" if whole else "drives of other shards are missing"
    note(arguments, f"{folder}: {made} files made; {says}")
