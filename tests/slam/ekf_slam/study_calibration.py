"""What a calibration is worth to the next drive of the same car: pairs of drives, and how near the second is to the
bound.

`python tests/slam/ekf_slam/study_calibration.py OUT.jsonl [--pairs N] [--estimator NAME ...] [--seed S]` appends a line
a second drive to OUT.jsonl (what is there is not run again), and prints efficiency ratios, root of the sum of squared
errors over that of the bound that knows the array's calibration, with 95 % bootstrap intervals. Pair n is
trials 2n and 2n + 1 of `lund-530` with `radio.array_seed` = S + n. Nothing was chosen on the root seed 71000.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.scores.statistics import efficiency_ratio
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording

WAYS = ("as the first", "calibrated")


def drive_pair(seed: int, pair: int, names: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Yield an estimator's second drive of a car without and with what it found of the array in the first (RMSE, m)."""
    first, second = (simulate("lund-530", seed, 2 * pair + n, {"radio.array_seed": seed + pair}) for n in (0, 1))
    limits = {"bound": bound(second).position_rmse_m, "known": bound(second, calibrated=True).position_rmse_m}
    for name in names:
        learnt, rmse = answered(first, name, {})
        with tempfile.NamedTemporaryFile(suffix=".h5") as file:
            learnt.save(file.name)
            found = [answered(second, name, {})[1], answered(second, name, {"calibration_file": file.name})[1]]
        yield {
            "seed": seed,
            "pair": pair,
            "estimator": name,
            "first": rmse,
            **dict(zip(WAYS, found, strict=True)),
            **limits,
        }


def answered(recording: Recording, name: str, options: dict[str, Any]) -> tuple[Any, float]:
    """Return the calibration that an estimator found, and its RMSE (m)."""
    (request,) = resolve({name: options}, (name,))
    warm_up(request)
    result = estimate(recording, request, np.random.default_rng(0))
    return result.calibration, score(recording, result, None)["position_rmse_m"]


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--pairs", type=int, default=12)
    parser.add_argument("--estimator", action="append", default=[])
    parser.add_argument("--seed", type=int, default=71000)
    asked = parser.parse_args()
    names = tuple(asked.estimator) or ("ekf-slam", "fastslam")
    rows = [json.loads(line) for line in asked.out.read_text().splitlines()] if asked.out.exists() else []
    for pair in range(asked.pairs):
        done = {row["estimator"] for row in rows if (row["seed"], row["pair"]) == (asked.seed, pair)}
        if missing := tuple(name for name in names if name not in done):
            for row in drive_pair(asked.seed, pair, missing):
                rows.append(row)
                with asked.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(json.dumps(row), flush=True)
    for name in names:
        of = [row for row in rows if row["estimator"] == name and row["seed"] == asked.seed]
        for limit in ("known", "bound"):
            below = np.array([row[limit] for row in of])
            for way in WAYS:
                ratio, low, high = efficiency_ratio(np.array([row[way] for row in of]), below, 0.95)
                print(f"{name}, {way}, over {limit}: {ratio:.2f} [{low:.2f}, {high:.2f}], {len(of)} drives")


if __name__ == "__main__":
    main()
