"""What wrong maps do: the error of a drive that begins with one, over that of the same drive without a map.

`python studies/study_wrong_maps.py OUT.jsonl [SCENARIO] [--trials N] [--seed S] [--estimator NAME]` runs
the trials that OUT does not have, and prints medians over all it has. The map is of another drive through the same
place; right, and wrong in five ways: of another city, shifted by 5 m, turned by 3 degrees, without a third of its VTs,
and of a car whose array errs four times as much as its estimator was told.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.earlier_drives import APART
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.randomness import Stream, stream
from cellslam.slam.model.vt_map import VtMap

SHIFT_M, TURN_RAD, WORSE = np.array([3.0, -4.0, 0.0]), np.radians(3.0), 4.0
OTHER = {"lund-530": "munich-530"}  # its city; of any other scenario, Lund
ERRORS = ("radio.calibration_distance_m", "radio.calibration_azimuth_deg", "radio.calibration_elevation_deg")


def moved(known: VtMap, turn_rad: float, shift_m: Any) -> VtMap:
    """Return a map turned about the middle of where it was made from, and shifted (3,) in m."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    turn, about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), known.anchor_m.mean(axis=0)
    position, anchor = (about + (at - about) @ turn.T + shift_m for at in (known.position_m, known.anchor_m))
    return replace(
        known, position_m=position, anchor_m=anchor, own_m2=turn @ known.own_m2 @ turn.T,
        common_m=turn @ known.common_m, seen_m=known.seen_m + shift_m[:2],
    )  # fmt: skip


def maps(scenario: str, seed: int, trial: int, request: Any) -> dict[str, VtMap]:
    """Return the maps of an earlier drive, right and wrong, by what they are."""

    def left(name: str, changes: dict[str, Any] | None = None) -> VtMap:
        drive = simulate(load(name, changes), seed, trial + APART, place=trial)
        known = estimate(drive, request, stream(seed, trial + APART, Stream.ESTIMATOR)).vt_map
        assert known is not None
        return known

    right, radio = left(scenario), load(scenario).radio
    worse = {key: WORSE * getattr(radio, key.removeprefix("radio.")) for key in ERRORS}
    return {
        "right": right,
        "of another city": left(OTHER.get(scenario, "lund-530")),
        "shifted by 5 m": moved(right, 0.0, SHIFT_M),
        "turned by 3 degrees": moved(right, TURN_RAD, np.zeros(3)),
        "a third gone": right.part(np.arange(len(right)) % 3 != 0),
        "badly calibrated": left(scenario, worse),
    }


def run(scenario: str, seed: int, trial: int, estimator: str) -> dict[str, Any]:
    """Return errors without a map and with each of them, and what the estimator said."""
    (request,) = resolve(load(scenario).estimator, [estimator])
    drive = simulate(scenario, seed, trial, place=trial)
    row: dict[str, Any] = {"case": scenario, "seed": seed, "trial": trial, "rmse": {}, "said": {}}
    for name, known in {"without": None, **maps(scenario, seed, trial, request)}.items():
        result = estimate(drive, request, stream(seed, trial, Stream.ESTIMATOR), known=known)
        row["rmse"][name] = score(drive, result, None)["position_rmse_m"]
        row["said"][name] = any("map" in remark for remark in result.remarks)
    return row


def main() -> None:
    """Run what is missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenario", nargs="?", default="lund-530")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--estimator", default="ekf-slam")
    given = parser.parse_args()
    rows = [json.loads(line) for line in given.out.read_text("utf-8").splitlines()] if given.out.exists() else []
    for trial in range(given.trials):
        if all(row["trial"] != trial for row in rows):
            rows.append(run(given.scenario, given.seed, trial, given.estimator))
            with given.out.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("| map | drives | error over that without, median [least, greatest] | said so |\n|---|---|---|---|")
    for name in (name for name in rows[0]["rmse"] if name != "without"):
        ratio = [row["rmse"][name] / row["rmse"]["without"] for row in rows]
        said = sum(row["said"][name] for row in rows)
        print(f"| {name} | {len(rows)} | {np.median(ratio):.2f} [{min(ratio):.2f}, {max(ratio):.2f}] | {said} |")


if __name__ == "__main__":
    main()
