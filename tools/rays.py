"""`python -m tools rays`."""

from __future__ import annotations

import dataclasses
import json
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from cellslam.cli.arguments import DONE, whole
from cellslam.cli.cities import find_city
from cellslam.progress_bars import bars
from cellslam.sim.city import City
from cellslam.sim.city.files.mitsuba import DISTRIBUTION, shipped_scene
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress
from cellslam.sim.rays import prepare, trace
from tools.peers import PEERS, unavailable
from tools.peers_compare import Comparison, compare
from tools.rays_bench import Timing, drive_in, receivers_along, sites_along, time_trace


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("--mesh", metavar="FILE", default="sionna-rt:munich", help="city (default: sionna-rt:munich)")
    parser.add_argument(
        "--receivers", metavar="N,N,...", default="100,1000,6850,100000", help="numbers of receivers to time"
    )
    parser.add_argument("--transmitters", metavar="N,N,...", default="1,12", help="numbers of transmitters to time")
    parser.add_argument("--max-order", metavar="N", type=whole, default=1, help="reflections: 0, 1 or 2 (default: 1)")
    parser.add_argument("--repeat", metavar="N", type=whole, default=5, help="runs of each size; the best counts")
    parser.add_argument("--no-peers", action="store_true", help="leave Sionna RT and DiffeRT out")
    parser.add_argument(
        "--peer-receivers", metavar="N", type=whole, default=6850, help="receivers that peers are asked for (6850)"
    )
    parser.add_argument("--json", action="store_true", help="print the rows as JSON on stdout, nothing else")


def command(arguments: Namespace) -> int:
    """Carry out `python -m tools rays`."""
    receivers, transmitters = (_counts(getattr(arguments, n), f"--{n}") for n in ("receivers", "transmitters"))
    if arguments.repeat < 1 or arguments.peer_receivers < 1:
        raise InputError("--repeat and --peer-receivers must be 1 or more")
    with bars(arguments.quiet) as progress:
        with progress("reading the city", 1):
            city = find_city(arguments.mesh)
        scene, way = prepare(city), drive_in(city)
        trace(scene, sites_along(city, way, 1), receivers_along(city, way, 10), arguments.max_order)
        timings = []
        with progress("timing", len(receivers) * len(transmitters)) as advance:
            for count in transmitters:
                for size in receivers:
                    places = receivers_along(city, way, size)
                    sites = sites_along(city, way, count)
                    timings.append(time_trace(scene, sites, places, arguments.max_order, arguments.repeat))
                    advance(1)
        peers = [] if arguments.no_peers else _ask_peers(arguments, city, progress)
    if arguments.json:
        rows = [dataclasses.asdict(t) | {"paths_per_s": t.paths_per_s} for t in timings]
        sys.stdout.write(json.dumps({"city": city.name, "sizes": rows, "peers": peers}, indent=1) + "\n")
    else:
        _print(arguments, city, timings, peers)
    return DONE


def _ask_peers(arguments: Namespace, city: City, progress: Progress) -> list[dict[str, Any]]:
    """Return a row per peer: why it was not asked, or its time, ours, and how the paths compare."""
    prefix, _, name = str(arguments.mesh).partition(":")
    path = shipped_scene(name) if prefix == DISTRIBUTION else Path(arguments.mesh)
    if path.suffix != ".xml":
        return [{"peer": peer, "why_not": "peers read Mitsuba scenes (.xml) only"} for peer in PEERS]
    way = drive_in(city)
    receivers, site = receivers_along(city, way, arguments.peer_receivers), sites_along(city, way, 1)
    # Peers know no roughness of this kind, and let the ground reflect.
    smooth = tuple(dataclasses.replace(m, roughness_m=0.0) for m in city.materials)
    scene = prepare(dataclasses.replace(city, materials=smooth))
    rows: list[dict[str, Any]] = []
    order = min(arguments.max_order, 1)
    for peer, ask in PEERS.items():
        why_not = unavailable(peer)
        if why_not:
            rows.append({"peer": peer, "why_not": why_not})
            continue
        with progress(f"asking {peer}", 1):
            theirs = ask(path, site[0], receivers, order)
        timing = time_trace(scene, site, receivers, order, arguments.repeat, ground_reflection=True)
        ours = trace(scene, site, receivers, order, ground_reflection=True)
        comparison = compare(scene, site[0], receivers, ours, theirs)
        rows.append(
            {"peer": peer, "receivers": len(receivers), "seconds": theirs.seconds, "our_seconds": timing.seconds,
             "ratio": theirs.seconds / timing.seconds, "paths": len(theirs), **dataclasses.asdict(comparison)}
        )  # fmt: skip
    return rows


def _print(arguments: Namespace, city: City, timings: list[Timing], peers: list[dict[str, Any]]) -> None:
    console = Console(width=110)
    title = f"{city.name}: {len(city.facets)} facets, order {arguments.max_order}, one core, best of {arguments.repeat}"
    table = Table(title=title, title_justify="left")
    for column in ("sites", "receivers", "paths", "seconds", "paths/s", "us per site and receiver", "peak memory MB"):
        table.add_column(column, justify="right")
    for t in timings:
        each = 1e6 * t.seconds / (t.receivers * t.transmitters)
        cells = (t.transmitters, t.receivers, t.paths, f"{t.seconds:.3f}", f"{t.paths_per_s:.0f}", f"{each:.1f}")
        table.add_row(*map(str, cells), f"{t.peak_bytes / 1e6:.0f}")
    console.print(table)
    for row in peers:
        console.print(_peer_line(row), highlight=False)


def _peer_line(row: dict[str, Any]) -> str:
    if "why_not" in row:
        return f"{row['peer']}: not asked: {row['why_not']}"
    names = {field.name for field in dataclasses.fields(Comparison)}
    c = Comparison(**{key: value for key, value in row.items() if key in names})
    gain = "" if c.gain_db is None else f", gain {c.gain_db:.4f} dB"
    return (
        f"{row['peer']}, all cores, {row['receivers']} receivers: {row['seconds']:.2f} s, "
        f"ours {row['our_seconds']:.3f} s: {row['ratio']:.0f} times as long\n"
        f"  of theirs {c.agreeing} agree (largest differences: length {1e3 * c.length_m:.3f} mm, "
        f"angle {c.angle_rad:.1e} rad{gain}), {c.theirs_copies} are copies, {c.theirs_bent} break the law of "
        f"reflection (up to {c.bent_rad:.1e} rad off), {c.theirs_grazing} graze an edge, "
        f"{c.theirs_unexplained} are not explained;\n"
        f"  of ours they miss {c.ours_only}"
    )


def _counts(text: str, option: str) -> list[int]:
    try:
        counts = [int(part) for part in text.split(",")]
    except ValueError:
        counts = []
    if not counts or min(counts) < 1 or max(counts) > 10_000_000:
        raise InputError(f"{option} '{text}': write whole numbers from 1 on with commas between, as in 100,1000")
    return [int(c) for c in np.array(counts)]
