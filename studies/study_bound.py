"""Is the bound right: the linear filter about the truth on simulated drives, and what merged paths cost.

`python studies/study_bound.py OUT.jsonl [SCENARIO...] [--known] [--drives N] [--seed S]` runs the drives
that OUT does not have and prints a table of all it has. `--known`: clock offsets are known. Merged measurements are
taken as if they were not, left out, and, where many are merged, with what merging does as an error that persists; the
second is done on the first 12 drives only where few are merged.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.bound.cramer_rao import BoundResult, bound
from cellslam.benchmarks.bound.merged_paths import LEAST_SHARE, merged, merged_share, merging
from cellslam.benchmarks.scores.belief import squared_error
from cellslam.benchmarks.scores.statistics import efficiency_ratio
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording

ALWAYS = 12
WAYS = {"lower": "counted as unmerged", "without": "left out", "upper": "an error that persists"}


def without_merged(recording: Recording) -> Recording:
    """Return a recording whose truth takes merged measurements for clutter, as the bound then does."""
    flags, truth = merged(recording), recording.truth
    if flags is None or truth is None:
        return recording
    return replace(recording, truth=replace(truth, measurement_vt=np.where(flags, -1, truth.measurement_vt)))


def found(result: BoundResult) -> tuple[float, float, float]:
    """Return the bound, the filter's root mean square error, both in m, and its mean NEES."""
    error = result.pose_error
    squared = squared_error(error[:, :2], result.pose_covariance[:, :2, :2])
    return (
        result.position_rmse_m,
        float(np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2))),
        float(np.nanmean(squared)),
    )


def runs(name: str, known: bool, drives: int, seed: int, out: Path) -> None:
    """Append the drives 0 to `drives` - 1 of a root seed that are missing."""
    case = f"{name}, offsets known" if known else name
    done = {row["trial"] for row in rows_of(out) if (row["case"], row["seed"]) == (case, seed)}
    scenario = load(name, {"radio.clock_offset_std_m": 0.0} if known else {})
    for trial in range(drives):
        if trial in done:
            continue
        recording = simulate(scenario, seed, trial)
        share = merged_share(recording)
        row: dict[str, Any] = {
            "case": case,
            "seed": seed,
            "trial": trial,
            "share": share,
            "lower": found(bound(recording)),
        }
        if trial < ALWAYS or share > LEAST_SHARE:
            row["without"] = found(bound(without_merged(recording)))
        if share > LEAST_SHARE:
            row["upper"] = found(bound(recording, merging=merging(recording)))
        with out.open("a") as file:
            file.write(json.dumps(row) + "\n")


def rows_of(out: Path) -> list[dict[str, Any]]:
    """Return the drives that a file has."""
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def table(out: Path) -> None:
    """Print, by scenario, root mean square bounds, the filter's efficiency ratio (95 %), and its mean NEES."""
    print("| scenario | drives | merged | bound, m | merged ones | filter / bound [95 %] | NEES | worst drive |")
    print("|---|---|---|---|---|---|---|---|")
    rows = rows_of(out)
    for case in dict.fromkeys(row["case"] for row in rows):
        for variant, said in WAYS.items():
            own = [row for row in rows if row["case"] == case and variant in row]
            if not own:
                continue
            least, error, squared = np.array([row[variant] for row in own]).T
            ratio = "{:.2f} [{:.2f}, {:.2f}]".format(*efficiency_ratio(error, least, 0.95))
            share = np.mean([row["share"] for row in own])
            rms = np.sqrt(np.mean(least**2))
            print(
                f"| {case} | {len(own)} | {100 * share:.1f} % | {rms:.3f} | {said} | {ratio} | {squared.mean():.2f} "
                f"| {np.max(error / least):.2f} |"
            )


def main() -> None:
    """Run what is asked for, and print the table of all there is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenarios", nargs="*")
    parser.add_argument("--known", action="store_true")
    parser.add_argument("--drives", type=int, default=12)
    parser.add_argument("--seed", type=int, default=73000)
    asked = parser.parse_args()
    for name in asked.scenarios:
        runs(name, asked.known, asked.drives, asked.seed, asked.out)
    table(asked.out)


if __name__ == "__main__":
    main()
