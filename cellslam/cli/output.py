"""What commands print and write: notes, tables, files at once."""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.trials.output_files import writing

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from cellslam.sim.recording import Recording


def note(arguments: Namespace, text: str) -> None:
    """Say something, if it is something, on stderr, unless --quiet."""
    if text and not arguments.quiet:
        sys.stderr.write(f"{text}\n")


def console(pipe_width: int) -> Console:
    """Return the console of stdout, `pipe_width` columns wide where stdout is no terminal."""
    from rich.console import Console

    found = Console()
    return found if found.is_terminal else Console(width=pipe_width)


def plain_table(*columns: str, expand: bool = False) -> Table:
    """Return an empty table with a line under its head, and the first columns, which are not wrapped."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, expand=expand)
    for name in columns:
        table.add_column(name, no_wrap=True)
    return table


def size_of(recording: Recording) -> str:
    """Return in words how much is in a recording."""
    links, measurements = len(recording.links), len(recording.measurements)
    return f"{len(recording.time_s)} snapshots, {links} links, {measurements} measurements"


def at_once(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file under another name first, so that nothing half-written is left behind."""
    place = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        with writing(path):
            write(place)
            place.replace(path)
    finally:
        place.unlink(missing_ok=True)
