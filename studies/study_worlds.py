"""What map builders make of recordings that nobody modelled, as `replay` runs them: a table, against odometry alone.

`python studies/study_worlds.py WORLD [DRIVES] [FACTOR]`; FACTOR: the odometry's data sheet is wrong
by so much. Drives have the seeds from 1000 on.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.recordings import Campaign, OdometryTable, build
from cellslam.recordings.fitting.fit_sizes import learn
from cellslam.scenarios.estimator_options import resolve
from cellslam.sim.frames import mean_velocity
from cellslam.sim.recording import Recording
from cellslam.slam import registry

sys.path.append(str(Path(__file__).parents[1] / "tests" / "recordings"))  # the worlds of the tests
from mistaken_worlds import STEP_S, WORLDS, campaign, paths, way_through

NOISE = (0.05, 0.05, 0.0, np.radians(2.0), 0.0, 0.0)  # of the odometry of docs/reference/data/tampere-60ghz.md


def surveyed(seed: int) -> Campaign:
    """45 places of a hall of 60 x 40 m, a second apart: eight to ten VTs, 0.3 m and 3 degrees, simulated odometry."""
    rng = np.random.default_rng(seed)
    corners = np.column_stack([rng.uniform(5, 55, 9), rng.uniform(5, 35, 9)])
    vehicle = way_through(corners, 1.5, 0.7, 44.0)
    count = rng.integers(8, 11)
    sources = np.column_stack([rng.uniform(-30, 90, count), rng.uniform(-30, 70, count)])
    rows = np.arange(0, len(vehicle), 20)
    seen = paths(vehicle, rows, sources, (0.3, np.radians(3.0)), 150.0, 0.8, 0.5, rng)
    x, y, yaw = vehicle[rows].T
    zero, lasts = np.zeros(len(rows)), np.full(len(rows) - 1, 20 * STEP_S)
    poses = np.column_stack([x, y, zero, yaw, zero, zero])
    u = mean_velocity(poses[:-1], poses[1:], lasts)
    u += np.asarray(NOISE) / np.sqrt(lasts)[:, None] * rng.standard_normal(u.shape)
    u = np.vstack([np.zeros(6), u])
    wheels = OdometryTable(STEP_S * rows, {"u_x": u[:, 0], "u_y": u[:, 1], "u_psi": u[:, 3]}, "before")
    return campaign(vehicle, seen, wheels, (0.0, 0.0), (20, 0.02, True), rng, noise={"noise_density": NOISE})


def errors(recording: Recording, names: tuple[str, ...], seed: int) -> dict[str, float]:
    """Return the RMSE (m) of estimators, with 100 particles where they have some, and of odometry alone."""
    learnt, out = learn(recording, None), {}
    for name in ("dead-reckoning", *names):
        model = registry.options_model(registry.resolve(name))
        table = learnt.table(model)
        few = {"particles": 100} if model is not None and "particles" in model.model_fields else {}
        (request,) = resolve({name: table | few}, (name,))
        told = replace(recording, odometry_model=learnt.odometry_model)
        result = estimate(told, request, np.random.default_rng(seed))
        out[name] = score(recording, result, None)["position_rmse_m"]
    return out


def main(world: str, drives: int, factor: float) -> None:
    """Print a line a drive, and medians, how often each is worse than odometry, and its share of odometry's error."""
    make, names = {**WORLDS, "surveyed": surveyed}[world], ("ekf-slam", "fastslam", "bp-slam")
    rows = []
    for seed in range(1000, 1000 + drives):
        recording = build(make(seed))
        sheet = recording.odometry_model
        wrong = replace(
            sheet, noise_density=factor * sheet.noise_density, bias=factor * sheet.bias, scale=factor * sheet.scale
        )
        rows.append(errors(replace(recording, odometry_model=wrong), names, seed))
        print(seed, ", ".join(f"{name} {value:.2f}" for name, value in rows[-1].items()), flush=True)
    alone = np.array([row["dead-reckoning"] for row in rows])
    for name in rows[0]:
        own = np.array([row[name] for row in rows])
        share, worse = np.sqrt(np.mean(own**2) / np.mean(alone**2)), int(np.sum(own > alone))
        print(f"{name:15} median {np.median(own):6.2f} m, worst {own.max():6.2f} m, rms {share:.2f} of odometry's, "
              f"worse in {worse} of {len(own)}")  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 20, float(sys.argv[3]) if len(sys.argv) > 3 else 1.0)
