"""What FastSLAM costs, by particles, states and groups, and how near to the bound that brings it.

    python -m tools fastslam lund-530 --set radio.clock_offset_std_m=0 --drives 2 --particles 30,100,300,1000

A row of the first table is an estimator: processor seconds a drive, times real time, efficiency ratio (root mean square
error over that of the bound), NEES. The second has milliseconds a snapshot by the number of states of the filter and of
groups of particles, of the snapshots that went on while it was so large. `--stone-soup N` adds what Stone Soup's
particle filter takes for a snapshot of as many measurements, with N particles and a map that is known.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pandas as pd

from cellslam.benchmarks.bound.cramer_rao import BoundResult, bound
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.cli.arguments import DONE
from cellslam.scenarios.estimator_options import Request, resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.slam.api import odometry_of, setup_of, snapshots_of
from cellslam.slam.fastslam.fastslam import FastSlam

STATES = [0, 100, 200, 300, 400, 600, 800, 1200, 100_000]  # edges of the second table


def drive(recording: Recording, request: Request, bounded: BoundResult, seed: int) -> dict[str, float]:
    """Return what one estimator costs on one drive, and how good it is."""
    warm_up(request)
    begin = time.process_time()
    result = estimate(recording, request, np.random.default_rng(seed))
    seconds = time.process_time() - begin
    scores = score(recording, result, bounded)
    duration = float(recording.time_s[-1] - recording.time_s[0])
    return {
        "cpu_s": seconds, "x_real_time": duration / seconds, "rmse_m": scores["position_rmse_m"],
        "bound_m": bounded.position_rmse_m, "nees": scores["nees_mean"],
    }  # fmt: skip


def snapshots(recording: Recording, request: Request) -> pd.DataFrame:
    """Return, for each snapshot of a drive, the milliseconds that it took, and how large the filter was."""
    fastslam: FastSlam = request.estimator(request.options)
    fastslam.start(setup_of(recording), np.random.default_rng(0))
    rows, dt = [], np.diff(recording.time_s, prepend=recording.time_s[0])
    for dt_s, odometry, snapshot in zip(dt, odometry_of(recording), snapshots_of(recording), strict=True):
        begin = time.process_time()
        fastslam.step(dt_s, odometry, snapshot)
        ms, mixture = 1e3 * (time.process_time() - begin), fastslam._joint
        if mixture is not None:
            rows.append((ms, int(mixture.arrays.size.max()), len(mixture), mixture.arrays.weight.shape[1]))
    return pd.DataFrame(rows, columns=["ms", "states", "groups", "particles of a group"])


def stone_soup(particles: int, measurements: int, steps: int = 20) -> float:
    """Return the milliseconds in which Stone Soup's particle filter predicts, and updates by so many measurements."""
    from stonesoup.models.measurement.nonlinear import CartesianToBearingRange
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.particle import ParticlePredictor
    from stonesoup.resampler.particle import SystematicResampler
    from stonesoup.types.array import StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import ParticleState
    from stonesoup.updater.particle import ParticleUpdater

    rng = np.random.default_rng(0)
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.1), ConstantVelocity(0.1)])
    places = rng.normal(0.0, 100.0, (measurements, 2))
    models = [
        CartesianToBearingRange(4, (0, 2), np.diag([1e-3, 1.0]), translation_offset=place[:, None]) for place in places
    ]
    predictor, updater = ParticlePredictor(motion), ParticleUpdater(models[0], SystematicResampler())
    now = pd.Timestamp(2026, 1, 1).to_pydatetime()
    states = StateVectors(rng.normal(0.0, 1.0, (4, particles)))
    belief = ParticleState(states, weight=np.full(particles, 1.0 / particles), timestamp=now)
    begin = time.process_time()
    for k in range(1, steps + 1):
        belief = predictor.predict(belief, timestamp=now + pd.Timedelta(seconds=0.1 * k).to_pytimedelta())
        for model in models:
            z = model.function(ParticleState(StateVectors(np.zeros((4, 1)))), noise=False)
            detection = Detection(z, timestamp=belief.timestamp, measurement_model=model)
            belief = updater.update(SingleHypothesis(belief, detection))
    return 1e3 * (time.process_time() - begin) / steps


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this tool."""
    parser.add_argument("scenario", nargs="?", default="lund-530")
    parser.add_argument("--set", action="append", default=[], dest="sets", metavar="KEY=VALUE")
    parser.add_argument("--particles", default="30,100,300,1000")
    parser.add_argument("--drives", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stone-soup", type=int, metavar="N", default=0)


def command(asked: argparse.Namespace) -> int:
    """Measure, and print the tables."""
    changes = parse_all(asked.sets)
    variants = {"ekf-slam": ("ekf-slam", {})}
    for count in map(int, asked.particles.split(",")):
        variants[f"fastslam, N = {count}"] = "fastslam", {"estimator.fastslam.particles": count}
    several = {"estimator.fastslam.association": "hypotheses"}
    variants["fastslam, several hypotheses"] = "fastslam", several
    requests = {
        label: resolve(load(asked.scenario, changes | own).estimator, (name,))[0]
        for label, (name, own) in variants.items()
    }
    rows, steps = [], []
    for trial in range(asked.drives):
        recording = simulate(load(asked.scenario, changes), asked.seed, trial)
        bounded = bound(recording)
        for label, request in requests.items():
            rows.append({"estimator": label} | drive(recording, request, bounded, trial))
            if label != "ekf-slam":
                steps.append(snapshots(recording, request))
    frame = pd.DataFrame(rows).groupby("estimator", sort=False)
    table = frame[["cpu_s", "x_real_time", "nees"]].mean()
    table.insert(2, "ratio", frame.apply(lambda g: np.sqrt((g.rmse_m**2).mean() / (g.bound_m**2).mean())))
    print(table.round(2).to_string())
    every = pd.concat(steps)
    every["states, from"] = pd.cut(every.states, STATES, labels=STATES[:-1])
    sizes = ["groups", "particles of a group"]
    print("\nmilliseconds a snapshot\n")
    print(every.pivot_table("ms", "states, from", sizes, observed=True).round(2).to_string())
    if asked.stone_soup:
        took = stone_soup(asked.stone_soup, 12)
        print(f"\nStone Soup, {asked.stone_soup} particles, 12 measurements at known places: {took:.1f} ms")
    return DONE
