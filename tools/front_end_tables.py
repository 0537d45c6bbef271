"""The studies of `python -m tools front-end`, and the time that the front end takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.lte.array import array_at, switching_times_s
from cellslam.sim.lte.signal.receiver import receiver_of
from cellslam.sim.progress import Progress
from tools.front_end_bench import (
    RECEIVERS,
    STILL,
    Bench,
    Row,
    collision,
    default_bench,
    ghosts,
    many_paths,
    motion,
    resolution,
    single_path,
)

# SNR per sample with the tones of LTE.
RHO_DB = (-32.5, -30.0, -28.0, -20.0, -10.0, 0.0, 10.0, 20.0)
# Steps of the resolution table: distance in m, azimuth and elevation in deg, for three integrated SNRs.
STEPS: dict[float, tuple[Sequence[float], Sequence[float], Sequence[float]]] = {
    24.0: ((4, 5, 6, 7, 8, 10), (6, 8, 10, 11, 12, 14), (6, 8, 10, 11, 12, 14)),
    44.0: ((2, 3, 4, 5, 6), (2, 4, 6, 7, 8), (2, 4, 5, 6.5, 8)),
    64.0: ((0.5, 1, 1.5, 2, 3), (0.5, 1, 1.5, 2.4, 3), (0.5, 1, 2, 3, 4)),
}
ACQUIRE_MS, TRACK_MS, INTERVAL_MS = 120.0, 51.0, 75.0


Point = Callable[[np.random.Generator], Row]
Points = Callable[[str, int], list[Point]]


def studies(
    wanted: Sequence[str], runs: int, seed: int, progress: Progress, technology: str = "lte"
) -> dict[str, list[Row]]:
    """Return the rows of the studies by name; none wanted: of all. Raises InputError for one that the technology has
    not.
    """
    if technology != "lte" and "collision" in wanted:
        raise InputError(f"study collision: ports of {technology} share no reference elements; lte has it")
    wanted = wanted or [name for name in STUDIES if technology == "lte" or name != "collision"]
    points, out = {name: STUDIES[name](technology, runs) for name in wanted}, {}
    with progress("measuring", sum(map(len, points.values()))) as advance:
        for name in wanted:
            rows: list[Row] = []
            for number, point in enumerate(points[name]):
                rows.append(point(np.random.default_rng([seed, number])))
                advance(1)
            out[name] = rows
    return out


def _each(study: Callable[[Bench, Any, int, np.random.Generator], Row], values: Sequence[float]) -> Points:
    """Return the points of a study that varies one value."""

    def points(technology: str, runs: int) -> list[Point]:
        def point(rng: np.random.Generator, value: float) -> Row:
            return study(default_bench(technology), value, runs, rng)

        return [partial(point, value=value) for value in values]

    return points


def _resolutions(technology: str, runs: int) -> list[Point]:
    def point(rng: np.random.Generator, gamma_db: float, component: int) -> Row:
        bench = default_bench(technology)
        coarser = bench.receiver.demands.coarser if component == 0 else 1.0
        steps = _si(STEPS[gamma_db][component], component) * coarser
        return resolution(bench, gamma_db, component, steps, max(runs // 4, 2), rng)

    return [partial(point, gamma_db=gamma_db, component=c) for gamma_db in STEPS for c in range(3)]


def _motions(technology: str, runs: int) -> list[Point]:
    orders: tuple[Literal["column", "ring"], ...] = ("column", "ring")

    def point(rng: np.random.Generator, order: Literal["column", "ring"], speed_mps: float) -> Row:
        return motion(technology, order, speed_mps, runs, int(rng.integers(2**31)))

    return [partial(point, order=order, speed_mps=v) for order in orders for v in (1.0, 3.0)]


def _speeds(technology: str, runs: int) -> list[Point]:
    def point(rng: np.random.Generator, sizes: tuple[int, int, int]) -> Row:
        return speed(technology, sizes, rng)

    return [partial(point, sizes=sizes) for sizes in speed_points()]


def _singles(technology: str, runs: int) -> list[Point]:
    """Return the points of a single path: the same integrated SNR in all technologies."""

    def point(rng: np.random.Generator, rho_db: float) -> Row:
        bench = default_bench(technology)
        more_db = 10.0 * np.log10(len(bench.tones_hz) / len(default_bench("lte").tones_hz))
        return single_path(bench, rho_db - more_db, runs, rng)

    return [partial(point, rho_db=rho_db) for rho_db in RHO_DB]


STUDIES: dict[str, Points] = {
    "single": _singles, "many": _each(many_paths, (3, 10, 20)), "resolution": _resolutions,
    "collision": _each(collision, (0.0, 20.0, 40.0)), "ghosts": _each(ghosts, (10.0, 20.0, 25.0)),
    "motion": _motions, "speed": _speeds,
}  # fmt: skip


def speed_points() -> list[tuple[int, int, int]]:
    """Return paths, links and columns of the array: each varied with the others at 10, 12 and 16."""
    return [(3, 12, 16), (10, 12, 16), (20, 12, 16), (10, 4, 16), (10, 24, 16), (10, 12, 8), (10, 12, 24)]


def speed(technology: str, sizes: tuple[int, int, int], rng: np.random.Generator, repeat: int = 5) -> Row:
    """Time acquisition and tracking of one snapshot of all links: best wall time on two threads, and processor time.

    `sizes`: paths, links, columns of the array.
    """
    (paths, links, columns), (carrier_hz, waveform, threshold) = sizes, RECEIVERS[technology]
    usual = array_at(carrier_hz)
    array = replace(usual, columns=columns, radius_m=usual.radius_m * columns / 16)
    times_s = switching_times_s(array)
    bench = Bench(receiver_of(waveform, carrier_hz, array=array, times_s=times_s, threshold=threshold))
    clean = [bench.channel(bench.draw(rng, rng.uniform(-30.0, 0.0, paths), 600.0)) for _ in range(links)]
    first = [c + bench.noise(rng) for c in clean]
    second = [c + bench.noise(rng) for c in clean]
    starts = [e.geometry for e in _snapshot(bench, first, [None] * links, STILL)[0]]
    acquired = min(_snapshot(bench, first, [None] * links, STILL)[1:] for _ in range(repeat))
    tracked = min(_snapshot(bench, second, starts, STILL)[1:] for _ in range(repeat))
    return {
        "paths": paths, "links": links, "ports": array.ports, "acquire_ms": 1e3 * acquired[0],
        "acquire_cpu_ms": 1e3 * acquired[1], "track_ms": 1e3 * tracked[0], "track_cpu_ms": 1e3 * tracked[1],
    }  # fmt: skip


def _snapshot(bench: Bench, samples: list[Any], starts: list[Any], velocity: Any) -> tuple[list[Any], float, float]:
    """Return the estimates of all links of one snapshot, and the wall and processor time in seconds."""
    from cellslam.sim.lte.signal.path_estimator.path_estimator import estimate_paths

    wall, cpu = time.perf_counter(), time.process_time()
    motion_now = bench.receiver.moving(velocity)
    _ = motion_now.beams
    with ThreadPoolExecutor(2) as pool:
        found = list(
            pool.map(lambda pair: estimate_paths(pair[0], motion_now, pair[1]), zip(samples, starts, strict=True))
        )
    return found, time.perf_counter() - wall, time.process_time() - cpu


def _si(steps: Sequence[float], component: int) -> np.ndarray:
    return np.array(steps, np.float64) if component == 0 else np.radians(steps)
