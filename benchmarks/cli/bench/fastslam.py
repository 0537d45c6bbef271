"""`cellslam bench fastslam`."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace
from typing import Any

from rich.console import Console
from rich.table import Table

from cellslam.benchmarks.cli.arguments import DONE
from cellslam.benchmarks.cli.progress_bars import bars
from cellslam.sim.errors import InputError

STUDIES = ("drive", "link", "cost", "roofline", "memory")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "--study", metavar="NAME", action="append", default=[], choices=STUDIES, dest="studies",
        help=f"one study: {', '.join(STUDIES)}; may be repeated (default: all)",
    )  # fmt: skip
    parser.add_argument("--scenario", metavar="NAME", default="lund-530", help="preset of the drive (lund-530)")
    parser.add_argument("--particles", metavar="N", type=int, default=1000, help="particles of the drive (1000)")
    parser.add_argument("--seed", metavar="S", type=int, default=0, help="root seed of the drive (default: 0)")
    parser.add_argument("--repeat", metavar="N", type=int, default=5, help="runs of each; the best counts (5)")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON on stdout, nothing else")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam bench fastslam`."""
    for name in ("particles", "repeat"):
        if getattr(arguments, name) < 1:
            raise InputError(f"--{name} {getattr(arguments, name)}: 1 or more")
    from cellslam.benchmarks.bench import fastslam_bench as bench

    wanted, rows = arguments.studies or STUDIES, {}
    with bars(arguments.quiet) as progress:
        if "drive" in wanted:
            rows["drive"] = [
                bench.drive(arguments.scenario, arguments.seed, arguments.particles, arguments.repeat, progress)
            ]
        points = [bench.DENSE] * ("link" in wanted) + bench.cost_points() * ("cost" in wanted)
        if points:
            with progress("one dense link", len(points)) as advance:
                rows["link"] = []
                for point in points:
                    rows["link"].append(bench.dense(*point, arguments.repeat))
                    advance(1)
        if "roofline" in wanted:
            rows["roofline"] = [_roofline()]
        if "memory" in wanted:
            rows["memory"] = [bench.drive(arguments.scenario, arguments.seed, bench.MANY_PARTICLES, 1, progress)]
    if arguments.json:
        sys.stdout.write(json.dumps(rows, indent=1) + "\n")
    else:
        _print(rows)
    return DONE


def _roofline() -> dict[str, Any]:
    """Return what an update needs, what this machine has, and the least time that follows."""
    from cellslam.benchmarks.bench.fastslam_bench import DENSE, bandwidth_bytes_per_s, dense
    from cellslam.benchmarks.bench.roofline import operations_per_s, work_of_update

    work, bandwidth, operations = work_of_update(), bandwidth_bytes_per_s(), operations_per_s()
    moved = work.bytes_read + work.bytes_written
    measured = dense(*DENSE)
    compute_ns, memory_ns = 1e9 * work.operations / operations, 1e9 * moved / bandwidth
    return {
        "operations": work.operations, "bytes": moved, "operations_per_s": operations,
        "bytes_per_s": bandwidth, "compute_ns": compute_ns, "memory_ns": memory_ns,
        "measured_ns": measured["ns_per_update"], "share": max(compute_ns, memory_ns) / measured["ns_per_update"],
    }  # fmt: skip


def _print(rows: dict[str, list[dict[str, Any]]]) -> None:
    console = Console(width=118)
    for name, title in (("drive", "Drive"), ("memory", "Many particles")):
        for r in rows.get(name, []):
            console.print(
                f"{title}: {r['scenario']}, {r['links']} links, {r['snapshots']} snapshots, {r['particles']} "
                f"particles, {r['threads']} threads: {r['realtime_factor']:.1f} x real time, "
                f"{r['ms_per_snapshot']:.2f} ms a snapshot with {r['measurements_per_snapshot']:.1f} measurements and "
                f"{r['updates_per_snapshot']:.1f} updates a particle; peak memory {r['peak_memory_mb']:.0f} MB",
                highlight=False,
            )  # fmt: skip
    if "link" in rows:
        table = Table(title="One link on one thread", title_justify="left")
        for column in ("landmarks", "measurements", "particles", "ms", "ns per product", "updates", "ns per update"):
            table.add_column(column, justify="right")
        for r in rows["link"]:
            table.add_row(
                str(r["landmarks"]), str(r["measurements"]), str(r["particles"]), f"{r['ms_per_snapshot']:.3f}",
                f"{r['ns_per_product']:.2f}", f"{r['updates_per_snapshot']:.1f}", f"{r['ns_per_update']:.0f}",
            )  # fmt: skip
        console.print(table)
        console.print("product: landmarks x measurements x particles", highlight=False)
    for r in rows.get("roofline", []):
        console.print(
            f"Roofline: an update takes {r['operations']} operations and moves {r['bytes']} bytes; one thread does "
            f"{r['operations_per_s'] / 1e9:.1f} G operations/s and copies {r['bytes_per_s'] / 1e9:.1f} GB/s: at least "
            f"{r['compute_ns']:.0f} ns of computing, {r['memory_ns']:.0f} ns of memory; measured "
            f"{r['measured_ns']:.0f} ns, all else included ({100 * r['share']:.0f} % of the roof)",
            highlight=False,
        )  # fmt: skip
