"""What a drive, an update and a particle of FastSLAM cost: the studies of `cellslam bench fastslam`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np

from cellslam.benchmarks.trials.memory import peak_bytes
from cellslam.scenarios import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Floats, Links, OdometryModel, Recording, Sites
from cellslam.slam.api import Setup, Snapshot, odometry_of, setup_of, snapshots_of
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.path_particles import PathParticles
from cellslam.slam.fastslam.state.tracks_kernel import ONCE
from cellslam.slam.model.measurement_model import predict

Row = dict[str, Any]
# The work of one link of a public C++ FastSLAM with known figures: landmarks, measurements, particles.
DENSE = (38, 20, 200)
DENSE_SNAPSHOTS, WARM_SNAPSHOTS = 200, 60
INTERVAL_S, SPEED_MPS = 0.075, 1.0
COUNTED_EVERY = 50
MANY_PARTICLES = 10_000


def drive(scenario: str, seed: int, particles: int, repeat: int, progress: Progress) -> Row:
    """Return the best real-time factor of `repeat` runs over a whole drive, and its updates a snapshot.

    An update is one measurement used in one particle for one VT.
    """
    recording = simulate(load(scenario, {}), seed, 0, progress=progress)
    seconds, updates = np.inf, 0.0
    with progress(f"FastSLAM, {particles} particles", repeat * len(recording.time_s)) as advance:
        for _ in range(repeat):
            spent, updates = _time_drive(recording, particles, advance)
            seconds = min(seconds, spent)
    lasted = float(recording.time_s[-1] - recording.time_s[0])
    snapshots = len(recording.time_s)
    return {
        "scenario": scenario, "particles": particles, "links": len(recording.links), "snapshots": snapshots,
        "measurements_per_snapshot": len(recording.measurements) / snapshots, "updates_per_snapshot": updates,
        "ms_per_snapshot": 1e3 * seconds / snapshots, "realtime_factor": lasted / seconds,
        "threads": numba.get_num_threads(), "peak_memory_mb": peak_bytes() / 1e6,
    }  # fmt: skip


def _time_drive(recording: Recording, particles: int, advance: Any) -> tuple[float, float]:
    """Return the seconds of one run, and the updates a snapshot."""
    estimator = PathParticles(FastSlamOptions(particles=particles, errors="counted"))
    estimator.warm_up()
    snapshots, odometry = snapshots_of(recording), odometry_of(recording)
    dt_s = np.diff(recording.time_s, prepend=recording.time_s[0]).tolist()
    estimator.start(setup_of(recording), np.random.default_rng(0))
    seconds, updates, counted = 0.0, 0.0, 0
    for t, snapshot in enumerate(snapshots):
        begin = time.perf_counter()
        estimator.step(dt_s[t], odometry[t], snapshot)
        seconds += time.perf_counter() - begin
        if t % COUNTED_EVERY == 0:
            updates, counted = updates + _updates(estimator), counted + 1
            advance(min(COUNTED_EVERY, len(snapshots) - t))
    return seconds, updates / counted


def _updates(estimator: PathParticles) -> float:
    """Return how many VTs the last snapshot updated, on average over particles.

    Resampling since then copies particles: the number is that of the survivors.
    """
    p = estimator._particles
    mine = np.arange(p.order.shape[2]) < p.counts[:, :, None]
    status = np.take_along_axis(p.status, p.order[..., None].astype(np.int64), axis=2)
    touched = (status >= 0) & (status >> 2 == estimator._now - 1) & (status & 3 != ONCE) & mine[..., None]
    return float(np.count_nonzero(touched)) / len(p)


def dense(landmarks: int, measurements: int, particles: int, repeat: int = 5) -> Row:
    """Return the best time of a snapshot with one dense link on one thread.

    The vehicle passes `landmarks` VTs at one metre a second, `measurements` of which are seen in each snapshot, in
    turn; the filter is told how rarely, and of hardly any clutter. No particle is resampled: the work is always the
    same.
    """
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        best, updates = np.inf, 0.0
        for _ in range(repeat):
            seconds, updates = _time_link(landmarks, measurements, particles)
            best = min(best, seconds)
    finally:
        numba.set_num_threads(before)
    return {
        "landmarks": landmarks, "measurements": measurements, "particles": particles, "ms_per_snapshot": 1e3 * best,
        "ns_per_product": 1e9 * best / (landmarks * measurements * particles),
        "updates_per_snapshot": updates, "ns_per_update": 1e9 * best / (particles * max(updates, 1e-9)),
    }  # fmt: skip


def _time_link(landmarks: int, measurements: int, particles: int) -> tuple[float, float]:
    """Return the median seconds of a snapshot, and the updates a particle."""
    options = FastSlamOptions(
        errors="counted", particles=particles, effective_share=0.0, pitch_deg=0.0, vts_per_link=4 * landmarks,
        clutter_density=1e-4, detection_probability=min(0.95, measurements / landmarks),
    )  # fmt: skip
    estimator = PathParticles(options)
    estimator.warm_up()
    estimator.start(_dense_setup(), np.random.default_rng(0))
    velocity, spent, updates = np.array([SPEED_MPS, 0, 0, 0, 0, 0]), [], []
    for t, snapshot in enumerate(_dense_snapshots(landmarks, measurements)):
        begin = time.perf_counter()
        estimator.step(INTERVAL_S if t else 0.0, velocity, snapshot)
        if t >= WARM_SNAPSHOTS:
            spent.append(time.perf_counter() - begin)
            updates.append(_updates(estimator))
    return float(np.median(spent)), float(np.mean(updates))


def _dense_setup() -> Setup:
    zero, one = np.zeros(6), np.zeros(1, np.int64)
    sheet = OdometryModel(np.array([0.02, 0, 0, 1e-3, 0, 0]), zero, zero, zero)
    return Setup(Links(one, one, one), Sites(("A",), np.zeros(1), np.ones(1)), sheet, zero, zero)


def _dense_snapshots(landmarks: int, measurements: int) -> Iterator[Snapshot]:
    rng = np.random.default_rng(1)
    azimuth = 2.0 * np.pi * (np.arange(landmarks) + 0.5) / landmarks
    distance = rng.uniform(60.0, 250.0, landmarks)
    vts = np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), rng.uniform(5.0, 30.0, landmarks)], 1)
    count = min(measurements, landmarks)
    for t in range(WARM_SNAPSHOTS + DENSE_SNAPSHOTS):
        pose = np.array([SPEED_MPS * INTERVAL_S * t, 0, 0, 0, 0, 0])
        seen = (t * count + np.arange(count)) % landmarks
        z = predict(pose, vts[seen]) + rng.standard_normal((count, 3)) * [0.3, 0.005, 0.005]
        rows = np.arange(count)
        columns = (z[:, 0].copy(), z[:, 1].copy(), z[:, 2].copy(), np.full(count, 20.0))
        link = np.zeros(count, np.int64)
        for column in (link, *columns):
            column.setflags(write=False)
        yield Snapshot(t, rows, link, *columns)


def cost_points() -> list[tuple[int, int, int]]:
    """Return landmarks, measurements and particles: each varied with the others as in `DENSE`."""
    landmarks, measurements, particles = DENSE
    return [
        *((n, measurements, particles) for n in (20, 80, 160)),
        *((landmarks, n, particles) for n in (2, 5, 10, 38)),
        *((landmarks, measurements, n) for n in (32, 1000, 4000)),
    ]


def bandwidth_bytes_per_s(repeat: int = 5) -> float:
    """Return what one thread copies from memory to memory, bytes read and written."""
    source: Floats = np.ones(16_000_000)
    target, best = np.empty_like(source), np.inf
    for _ in range(repeat):
        begin = time.perf_counter()
        np.copyto(target, source)
        best = min(best, time.perf_counter() - begin)
    return 2.0 * source.nbytes / best
