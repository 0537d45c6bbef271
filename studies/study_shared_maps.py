"""What a map that is remembered can be worth at most: bounds of drives through one city.

`python studies/study_shared_maps.py OUT.jsonl [SCENARIO...] [--drives N] [--sequences N] [--half]` runs
the sequences that OUT does not have and prints a table of all it has. All drives take the same route; `--half`: windows
of two thirds of it, in turn from its start and to its end, so that neighbours have half of their way in common.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.bound.shared_maps import shared_map_bounds
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Floats, Recording
from cellslam.sim.world import prepare

SEED, DRIVES, SEQUENCES, SHOWN = 81000, 8, 3, (1, 2, 4, 8)
CASES = {"VTs": {}, "VTs, array known": {"calibrated": True}}


def recordings(name: str, sequence: int, drives: int, half: bool) -> list[Recording]:
    """Return the drives of a sequence: one city, route and sites; all else is drawn anew for each."""
    fixed: dict[str, Any] = {}
    if name == "anywhere":
        fixed = {"city.seed": SEED + sequence, "vehicle.route": SEED + sequence}
    first = load(name, fixed)
    world = prepare(first.world, SEED, DRIVES * sequence)
    fixed |= {f"sites.{s.name}.position_m": p.tolist() for s, p in zip(first.world.sites, world.sites_m, strict=True)}
    out = []
    for drive in range(drives):
        window = windowed(world.drive.poses[:, :2], first.world.vehicle, drive % 2) if half else {}
        out.append(simulate(load(name, fixed | window), SEED, DRIVES * sequence + drive))
    return out


def windowed(driven_m: Floats, vehicle: Any, late: int) -> dict[str, Any]:
    """Return the keys of a drive over two thirds of a way, from its start or to its end."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(driven_m, axis=0), axis=1))])
    begin = arc[-1] / 3.0 if late else 0.0
    at = np.append(np.arange(begin, arc[-1], 8.0), arc[-1])
    points = np.stack([np.interp(at, arc, driven_m[:, i]) for i in range(2)], axis=1)
    length = float(np.floor(0.98 * 2.0 * arc[-1] / 3.0))
    return {
        "vehicle.waypoints_m": np.round(points, 2).tolist(),
        "vehicle.distance_m": length,
        "vehicle.duration_s": vehicle.duration_s * length / vehicle.distance_m,
    }


def rows_of(out: Path) -> list[dict[str, Any]]:
    """Return the rows so far."""
    return [json.loads(line) for line in out.read_text("utf-8").splitlines()] if out.exists() else []


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenarios", nargs="*")
    parser.add_argument("--drives", type=int, default=DRIVES)
    parser.add_argument("--sequences", type=int, default=SEQUENCES)
    parser.add_argument("--half", action="store_true")
    given = parser.parse_args()
    for name in given.scenarios:
        case = f"{name}, half of the way" if given.half else name
        for sequence in range(given.sequences):
            if any((row["case"], row["sequence"]) == (case, sequence) for row in rows_of(given.out)):
                continue
            drives = recordings(name, sequence, given.drives, given.half)
            row: dict[str, Any] = {"case": case, "sequence": sequence}
            for title, options in CASES.items():
                row[title] = [result.position_rmse_m for result in shared_map_bounds(drives, **options)]
            with given.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
    show(rows_of(given.out))


def show(rows: list[dict[str, Any]]) -> None:
    """Print the root mean square of the bounds over sequences, for each case and the n-th drive."""
    print("| | map |", " | ".join(f"drive {n}, m" for n in SHOWN), "|")
    print("|---|---|" + "---|" * len(SHOWN))
    for case in dict.fromkeys(row["case"] for row in rows):
        mine = [row for row in rows if row["case"] == case]
        for title in CASES:
            bounds = np.sqrt(np.mean(np.square([row[title] for row in mine]), axis=0))
            cells = [f"{bounds[n - 1]:.2f}" if n <= len(bounds) else "" for n in SHOWN]
            print(f"| `{case}` ({len(mine)}) | {title} |", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
