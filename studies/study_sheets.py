"""What wrong data sheets cost: map builders told sizes of errors that are five times too large or too small.

`python studies/study_sheets.py OUT.jsonl [WORLD ...] [--trials N] [--estimator NAME ...]` appends a
line a run to OUT.jsonl (what is there is not run again), and prints a table: the RMSE as told (before) and after what
`replay --fit` learns, over that with the right sizes, medians over worlds and trials. WORLD: presets, "trees", an hour
in a park, whose recording says nothing of its front end. Trials have the root seed 61000. How outliers count and how
far fields grow was chosen on trial 0 of canyon, after a look at the first pass of canyon 1 and lund-530 0: judge by
other trials.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings.adapters.adapter_loading import import_adapter
from cellslam.recordings.fitting.assumptions import assumed
from cellslam.scenarios.recording_origin import Origin
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.slam import registry

sys.path.append(str(Path(__file__).parents[1] / "tests" / "recordings"))  # the worlds of the tests
import vehicle_world

SEED, FACTOR, HOUR_S = 61000, 5.0, 3600.0
PRESETS = ("lund-530", "munich-530", "canyon", "open", "anywhere", "tiny", "noiseless")
WHITE, PERSISTING = ("noise_",), ("calibration_", "roof_", "diffuse_", "sway_")
CAUSES = {"odometry": (), "white noise": WHITE, "what persists": PERSISTING, "all": WHITE + PERSISTING}
SIZES = ("_m", "_azimuth_deg", "_elevation_deg")


def world(name: str, trial: int) -> Recording:
    """Return a drive: of a preset, or of an hour among 500 trees."""
    if name != "trees":
        return simulate(name, SEED, trial)
    with tempfile.TemporaryDirectory() as folder:
        vehicle_world.write(Path(folder), vehicle_world.drive(HOUR_S, 500, SEED + trial), SEED + trial)
        return import_adapter(Path(folder), "victoria-park")


def mistold(recording: Recording, cause: str, factor: float, names: tuple[str, ...]) -> Recording:
    """Return a recording whose sizes of errors are said to be `factor` times what they are."""
    sheet, about = recording.odometry_model, dict(recording.provenance)
    if cause in ("odometry", "all"):
        sheet = replace(
            sheet, noise_density=factor * sheet.noise_density, bias=factor * sheet.bias, scale=factor * sheet.scale
        )
    if isinstance(about.get("scenario"), dict):
        tables = dict(about["scenario"].get("estimator", {}))
        for name in names:
            model = registry.options_model(registry.resolve(name))
            assert model is not None
            told_now = model(**tables.get(name, {})).model_dump()
            sizes = [key for key in told_now if key.startswith(CAUSES[cause]) and key.endswith(SIZES)]
            tables[name] = tables.get(name, {}) | {key: factor * told_now[key] for key in sizes}
        about["scenario"] = about["scenario"] | {"estimator": tables}
    return replace(recording, odometry_model=sheet, provenance=about)


def errors(recording: Recording, names: tuple[str, ...], fit: bool) -> dict[str, float]:
    """Return the RMSE (m) of estimators, with what the recording says or with what is learnt from it."""
    given = assumed(recording, Origin.of(recording), names, {}, fit)
    drive, out = replace(recording, odometry_model=given.odometry_model), {}
    for request in given.requests:
        out[request.name] = float(
            score(drive, estimate(drive, request, np.random.default_rng(0)), None)["position_rmse_m"]
        )
    return out


def runs(name: str, trials: int, names: tuple[str, ...], out: Path) -> None:
    """Append what is not yet there."""
    have = {(row["world"], row["trial"], row["cause"], row["factor"], row["fit"]) for row in rows_of(out)}
    causes = ("odometry",) if name == "trees" else tuple(CAUSES)
    for trial in range(trials):
        right = world(name, trial)
        for cause, factor in [("none", 1.0), *((cause, f) for cause in causes for f in (FACTOR, 1.0 / FACTOR))]:
            recording = right if cause == "none" else mistold(right, cause, factor, names)
            for fit in (False, True):
                key = {"world": name, "trial": trial, "cause": cause, "factor": factor, "fit": fit}
                if tuple(key.values()) not in have:
                    row = key | {"rmse_m": errors(recording, names, fit)}
                    with out.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                    print(row, flush=True)


def rows_of(out: Path) -> list[dict[str, Any]]:
    """Return the runs so far."""
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def table(out: Path) -> None:
    """Print, for each estimator and mistake, the median and worst ratio to the right sizes, before and after."""
    rows = rows_of(out)
    right = {
        (row["world"], row["trial"]): row["rmse_m"]
        for row in rows
        if row["cause"] == "none" and row["fit"] == (row["world"] == "trees")
    }
    mistakes = dict.fromkeys((row["cause"], row["factor"]) for row in rows)
    for name in next(iter(right.values())):
        print(f"\n| {name}: told | runs | before: median, worst | after: median, worst | after above 1.5 |")
        print("|---|---|---|---|---|")
        for cause, factor in mistakes:
            cells, count = [], 0
            for fit in (False, True):
                of = [row for row in rows if (row["cause"], row["factor"], row["fit"]) == (cause, factor, fit)]
                ratio = np.array([row["rmse_m"][name] / right[row["world"], row["trial"]][name] for row in of])
                cells.append(f"{np.median(ratio):.2f}, {ratio.max():.2f}")
                count = int((ratio > 1.5).sum())
            print(f"| {cause} x {factor:g} | {len(ratio)} | {cells[0]} | {cells[1]} | {count} |")


def main() -> None:
    """Run what is asked for, and print the table of all there is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("worlds", nargs="*")
    parser.add_argument("--trials", type=int, default=1)
    parser.add_argument("--estimator", action="append", default=[])
    asked = parser.parse_args()
    for name in asked.worlds:
        runs(name, asked.trials, tuple(asked.estimator) or ("ekf-slam", "fastslam"), asked.out)
    table(asked.out)


if __name__ == "__main__":
    main()
