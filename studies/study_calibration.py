"""What a calibration is worth to the next drive of the same car: pairs of drives, and how near the second is to the
bound.

`python studies/study_calibration.py OUT.jsonl [--pairs N] [--estimator NAME ...] [--seed S]` appends a line
a second drive to OUT.jsonl (what is there is not run again), and prints efficiency ratios, root of the sum of squared
errors over that of the bound that knows the array's calibration, with 95 % bootstrap intervals. Pair n is
trials 2n and 2n + 1 of `lund-530` with `radio.array_seed` = S + n. Nothing was chosen on the root seed 71000.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.scores.array_calibration import drawn
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.scores.statistics import efficiency_ratio
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.slam.model.calibration import Calibration

WAYS = ("as the first", "calibrated", "measured")
SPACING_DEG, HIGHEST_DEG, NOISE = 6.0, 45.0, 0.1  # of an array measured in a chamber; noise in sizes of the field


def drive_pair(seed: int, pair: int, names: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """Yield an estimator's second drive of a car: RMSE and claimed deviation, in m, each way."""
    first, second = (simulate("lund-530", seed, 2 * pair + n, {"radio.array_seed": seed + pair}) for n in (0, 1))
    limits = {"bound": bound(second).position_rmse_m, "known": bound(second, calibrated=True).position_rmse_m}
    for name in names:
        row: dict[str, Any] = {"seed": seed, "pair": pair, "estimator": name, **limits}
        learnt = answered(first, name, None)[0]
        for way, known in zip(WAYS, (None, learnt, measured(first, learnt)), strict=True):
            _, row[way], row[f"claimed {way}"] = answered(second, name, known)
        yield row


def answered(recording: Recording, name: str, known: Calibration | None) -> tuple[Calibration, float, float]:
    """Return the calibration that an estimator found, its RMSE and its root mean square deviation (m)."""
    with tempfile.NamedTemporaryFile(suffix=".h5") as file:
        if known is not None:
            known.save(file.name)
        (request,) = resolve({name: {} if known is None else {"calibration_file": file.name}}, (name,))
        result = estimate(recording, request, np.random.default_rng(0))
    assert result.calibration is not None
    claimed = float(np.sqrt(np.mean(result.position_std_m**2)))
    return result.calibration, score(recording, result, None)["position_rmse_m"], claimed


def measured(recording: Recording, like: Calibration) -> Calibration:
    """Return what a chamber would tell of the drawn field, at directions all around up to a height."""
    azimuth, elevation = np.arange(-180.0, 180.0, SPACING_DEG), np.arange(-HIGHEST_DEG, HIGHEST_DEG, SPACING_DEG)
    directions = np.radians(np.stack([part.ravel() for part in np.meshgrid(azimuth, elevation)], axis=1))
    truth, cells = drawn(recording.provenance, directions), like.grid.cells
    assert truth is not None
    loads = like._loads(directions)
    spread = np.linalg.inv(np.eye(cells) + loads.T @ loads / NOISE**2)
    mean = spread @ loads.T @ truth / NOISE**2
    return replace(
        like, component=np.repeat(np.arange(3), cells), cell=np.tile(np.arange(cells), 3), mean=mean.T.ravel(),
        covariance=np.kron(np.diag(like.size**2), spread),
    )  # fmt: skip


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
        columns = {key: np.array([row[key] for row in of]) for key in (of[0] if of else ()) if key != "estimator"}
        pairs = [(way, limit) for limit in ("known", "bound", "as the first") for way in WAYS if way != limit]
        pairs += [(f"claimed {way}", "known") for way in WAYS]
        for way, limit in pairs if of else ():
            ratio, low, high = efficiency_ratio(columns[way], columns[limit], 0.95)
            print(f"{name}, {way} over {limit}: {ratio:.2f} [{low:.2f}, {high:.2f}], {len(of)} drives")


if __name__ == "__main__":
    main()
