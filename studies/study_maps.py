"""What remembered maps give: the error of each drive of a sequence, beside its bound.

`python studies/study_maps.py OUT.jsonl [SCENARIO...] [--drives N] [--sequences N] [--seed S] [--estimator
NAME] [--figure FILE.png]` runs the sequences that OUT does not have, and prints and draws all it has. Drives of a
sequence have city, route and sites in common; clocks, odometry, array and receiver are new in each.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.bound.shared_maps import shared_map_bounds
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.earlier_drives import APART
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.randomness import Stream, stream

SEED, SHOWN = 20000, (1, 2, 4, 8)


def sequence(name: str, number: int, given: argparse.Namespace) -> dict[str, Any]:
    """Return errors, NEES and bounds of the drives of a sequence, each with the map that those before it left."""
    (request,) = resolve(load(name).estimator, [given.estimator])
    known, recordings, row = None, [], {"case": name, "sequence": number, "rmse": [], "nees": [], "vts": [], "said": []}
    for drive in range(1, given.drives + 1):
        trial = number + APART * drive
        recordings.append(simulate(name, given.seed, trial, place=number))
        rng = stream(given.seed, trial, Stream.ESTIMATOR)
        result = estimate(recordings[-1], request, rng, known=known)
        known, scores = result.vt_map, score(recordings[-1], result, None)
        row["rmse"].append(scores["position_rmse_m"])
        row["nees"].append(scores["nees_mean"])
        row["vts"].append(0 if known is None else len(known))
        row["said"].append(list(result.remarks))
    row["bound"] = [bound.position_rmse_m for bound in shared_map_bounds(recordings)]
    return row


def main() -> None:
    """Run what is missing, print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenarios", nargs="*")
    parser.add_argument("--drives", type=int, default=8)
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--estimator", default="ekf-slam")
    parser.add_argument("--figure", type=Path)
    given = parser.parse_args()
    for name in given.scenarios:
        for number in range(given.sequences):
            if any((row["case"], row["sequence"]) == (name, number) for row in rows_of(given.out)):
                continue
            row = sequence(name, number, given)
            with given.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
    rows = rows_of(given.out)
    show(rows)
    if given.figure is not None:
        draw(rows, given.figure)


def rows_of(out: Path) -> list[dict[str, Any]]:
    """Return the rows so far."""
    return [json.loads(line) for line in out.read_text("utf-8").splitlines()] if out.exists() else []


def columns(rows: list[dict[str, Any]], case: str, key: str, drive: int) -> list[float]:
    """Return what all sequences of a case have for the n-th drive."""
    return [row[key][drive - 1] for row in rows if row["case"] == case and len(row[key]) >= drive]


def show(rows: list[dict[str, Any]]) -> None:
    """Print medians over sequences, with the least and greatest, for the n-th drive."""
    print("| | sequences | drive | error, m | bound, m | NEES |\n|---|---|---|---|---|---|")
    for case in dict.fromkeys(row["case"] for row in rows):
        for drive in SHOWN:
            error, bound, nees = (columns(rows, case, key, drive) for key in ("rmse", "bound", "nees"))
            if error:
                low, middle, high = min(error), np.median(error), max(error)
                print(f"| `{case}` | {len(error)} | {drive} | {middle:.2f} [{low:.2f}, {high:.2f}] |",
                      f"{np.median(bound):.2f} | {np.median(nees):.1f} |")  # fmt: skip


def draw(rows: list[dict[str, Any]], file: Path) -> None:
    """Draw the error against the number of the drive, with its bound."""
    from matplotlib.figure import Figure

    cases = list(dict.fromkeys(row["case"] for row in rows))
    figure = Figure(figsize=(3.6 * len(cases), 3.2), layout="constrained")
    for axes, case in zip(figure.subplots(1, len(cases), squeeze=False)[0], cases, strict=True):
        drives = range(1, 1 + max(len(row["rmse"]) for row in rows if row["case"] == case))
        error, bound = ([columns(rows, case, key, n) for n in drives] for key in ("rmse", "bound"))
        axes.fill_between(drives, [min(e) for e in error], [max(e) for e in error], alpha=0.25, lw=0)
        axes.plot(drives, [np.median(e) for e in error], "o-", label="error, median and range")
        axes.plot(drives, [np.median(b) for b in bound], "k--", label="bound, median")
        axes.set(xlabel="drive", ylabel="position RMSE (m)", title=case, xticks=list(drives), ylim=(0.0, None))
        axes.legend(frameon=False)
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
