"""What commands print: notes and tables."""

from __future__ import annotations

import sys
from argparse import Namespace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from cellslam.sim.city import CityConfig
    from cellslam.sim.recording import Recording
    from cellslam.sim.vehicle import VehicleConfig

# Measured on lund-530 at 13 and 50 snapshots a second and on generated cities: processor time of one core, memory.
SNAPSHOT_S, SNAPSHOT_BYTES = 4e-4, 19_000
BLOCK_S = 0.012
LONG_S, LARGE_BYTES = 60.0, 2e9  # what is less needs no word


def note(arguments: Namespace, text: str) -> None:
    """Say something, if it is something, on stderr, unless --quiet."""
    if text and not arguments.quiet:
        sys.stderr.write(f"{text}\n")


def note_long(arguments: Namespace, city: CityConfig, vehicle: VehicleConfig | None = None) -> None:
    """Say on stderr, unless --quiet, what a world will take at the least, where that is long or large."""
    blocks = 0.0 if city.kind != "procedural" else (city.extent_m / city.block_size_m) ** 2
    snapshots = 0.0 if vehicle is None else vehicle.duration_s / vehicle.snapshot_interval_s
    seconds, size = BLOCK_S * blocks + SNAPSHOT_S * snapshots, SNAPSHOT_BYTES * snapshots
    if seconds < LONG_S and size < LARGE_BYTES:
        return
    parts = [f"{count:.0f} {what}" for count, what in ((blocks, "blocks"), (snapshots, "snapshots")) if count > 0.0]
    memory = f" and {size / 1e9:.1f} GB of memory" if size >= LARGE_BYTES else ""
    note(arguments, f"a world of {' and '.join(parts)} takes {seconds / 60.0:.0f} minutes{memory} at the least")


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
