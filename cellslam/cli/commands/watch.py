"""`cellslam watch`: what is done of a sweep that other processes carry out, on this machine or others."""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.sweeps.watch import PIPE_WIDTH, tally_of
from cellslam.cli.arguments import add
from cellslam.cli.output import console

EXAMPLES = ("watch load",)
EVERY_S = 10.0  # databases of shards are read over the network, and change once a minute


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder", help="folder of a sweep; on a terminal shown until all is done, else once")


def command(arguments: Namespace) -> None:
    folder = Path(arguments.folder)
    tally, out = tally_of(folder), console(PIPE_WIDTH)
    if sys.stdout.isatty():
        from rich.live import Live

        with Live(tally.table(), console=out) as live:
            while tally.done < tally.total:
                time.sleep(EVERY_S)
                tally = tally_of(folder)
                live.update(tally.table())
    else:
        out.print(tally.table())
