"""`cellslam bench calibrate`: the study that gives the statistical front end its constants, and its check."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import version
from importlib.resources import files
from typing import Any

import numpy as np

from cellslam.benchmarks.calibration_fit import fit_detection, fit_floor, fit_overlap, structured
from cellslam.benchmarks.calibration_persistence import persistence
from cellslam.benchmarks.calibration_scenes import (
    PORTS,
    Sample,
    config_of,
    draw_paths,
    measured_by_signals,
    measured_by_statistics,
)
from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.signal_level import DEFAULT_HARDWARE
from cellslam.sim.lte.statistical import PathColumns
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Floats

RATIOS_DB = (0.0, 3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 40.0)
OVERLAP_RATIOS_DB = (6.0, 15.0, 40.0)
NOISE_SHARE = 0.5  # of the scenes of one ratio: as many without any path
LEAST_DB, MOST_DB = -38.0, 18.0


def calibrate(scenes: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Return the constants and their provenance, from `scenes` scenes of a lone path at each of eight ratios, half
    as many of several paths at three, and half as many without any.
    """
    rng, threshold = np.random.default_rng([seed, 1]), config_of(40.0).detection_threshold
    empty, many = int(NOISE_SHARE * scenes), scenes // 2
    lone: dict[float, Sample] = {}
    several: dict[float, Sample] = {}
    total = empty + len(RATIOS_DB) * scenes + len(OVERLAP_RATIOS_DB) * many
    with progress("measuring scenes", total) as advance:
        nothing = [draw_paths(rng, np.empty(0), config_of(40.0))] * empty
        noise = measured_by_signals(40.0, nothing, rng, advance)
        for ratio in RATIOS_DB:
            drawn = [draw_paths(rng, rng.uniform(LEAST_DB, MOST_DB, 1), config_of(ratio)) for _ in range(scenes)]
            lone[ratio] = measured_by_signals(ratio, drawn, rng, advance)
        for ratio in OVERLAP_RATIOS_DB:
            several[ratio] = measured_by_signals(ratio, scenes_of(rng, many, ratio), rng, advance)
    return {
        "provenance": provenance(scenes, seed),
        **constants(noise, lone, several, threshold),
        "persistence": persistence(max(scenes // 8, 8), np.random.default_rng([seed, 2]), progress),
    }


def constants(
    noise: Sample, lone: dict[float, Sample], several: dict[float, Sample], threshold: float
) -> dict[str, Any]:
    """Return the constants that the samples give."""
    window = config_of(40.0).window_max_m - config_of(40.0).window_min_m
    rate = len(noise.clutter) / noise.links
    detection = fit_detection(lone[max(lone)], threshold)
    return {
        "threshold": threshold,
        "detection": detection,
        "overlap": fit_overlap(several, detection, threshold),
        "noise_cells": rate / float(np.exp(-threshold) * (1.0 + threshold)),
        "floors": fit_floor(lone),
        "clutter": {f"{ratio:g}": structured(s, rate, window) for ratio, s in lone.items()},
    }


def scenes_of(rng: np.random.Generator, count: int, ratio_db: float) -> list[PathColumns]:
    """Draw scenes of two to eight paths, -32 to 12 dB."""
    config = config_of(ratio_db)
    return [draw_paths(rng, rng.uniform(-32.0, 12.0, rng.integers(2, 9)), config) for _ in range(count)]


def provenance(scenes: int, seed: int) -> dict[str, Any]:
    """Return what is needed to make the constants again."""
    return {
        "command": f"cellslam bench calibrate --scenes {scenes} --seed {seed}",
        "versions": {name: version(name) for name in ("cellslam", "numpy", "scipy", "numba")}
        | {"python": platform.python_version()},
        "hardware": {"phase_std_deg": DEFAULT_HARDWARE.phase_std_deg, "gain_std_db": DEFAULT_HARDWARE.gain_std_db},
        "ratios_db": list(RATIOS_DB),
        "code": code_digest(),
    }


def code_digest() -> str:
    """Return a digest of the signal-level front end's code: constants measured with other code are out of date."""
    names = ("channel", "diffuse", "estimator", "receiver", "refine", "refine_kernel", "search_kernel", "signal_level",
             "spectrum", "climb_kernel", "symbol_kernel")  # fmt: skip
    texts = [(files("cellslam.sim.lte") / f"{name}.py").read_bytes() for name in names]
    return hashlib.sha256(b"".join(texts)).hexdigest()[:16]


def agreement(count: int, seed: int, ratio_db: float, progress: Progress) -> dict[str, Any]:
    """Return how the two front ends compare over `count` scenes that no calibration has seen: a stream of their own."""
    rng = np.random.default_rng([seed, 3, round(10.0 * ratio_db)])
    scenes = scenes_of(rng, count, ratio_db)
    with progress("measuring scenes", count) as advance:
        signal = measured_by_signals(ratio_db, scenes, rng, advance)
    # The statistical front end is cheap: many draws of the same scenes leave only the signal level's scatter.
    drawn = [measured_by_statistics(config_of(ratio_db), scenes, rng) for _ in range(4)]
    return compared(signal, drawn) | {"ratio_db": ratio_db, "scenes": count}


def compared(signal: Sample, drawn: list[Sample]) -> dict[str, Any]:
    """Return reported paths per link, detection probability over SNR, error deviations, clutter count and spread of
    both.
    """
    both = [summary([signal]), summary(drawn)]
    return {"signal": both[0], "statistical": both[1]}


def summary(samples: list[Sample]) -> dict[str, Any]:
    """Return the figures of one front end; robust deviations, in m and deg."""
    links = sum(s.links for s in samples)
    gamma = np.concatenate([s.gamma_db for s in samples])
    found = np.concatenate([s.detected for s in samples])
    error = np.concatenate([s.error[s.detected] for s in samples])
    late, beside = (np.concatenate(parts) for parts in zip(*(offsets(s) for s in samples), strict=True))
    bins = np.array([8.0, 14.0, 20.0, 30.0, 40.0, 60.0])
    which = np.digitize(gamma, bins)
    spread = np.median(np.abs(error), axis=0) / 0.6745 * [1.0, 180.0 / np.pi, 180.0 / np.pi]
    inside = np.abs(error * [1.0, 180.0 / np.pi, 180.0 / np.pi]) < 4.0 * spread
    trimmed = [float(np.std(error[inside[:, c], c])) * (1.0 if c == 0 else 180.0 / np.pi) for c in range(3)]
    return {
        "reported_per_link": float(found.sum() + sum(len(s.clutter) for s in samples)) / links,
        "detected_per_link": float(found.sum()) / links,
        "detection": [float(found[which == b].mean()) if (which == b).any() else None for b in range(len(bins) + 1)],
        "detection_paths": [int((which == b).sum()) // len(samples) for b in range(len(bins) + 1)],
        "error_std": trimmed,
        "clutter_points": sum(len(s.clutter) for s in samples) // len(samples),
        "clutter_per_link": sum(len(s.clutter) for s in samples) / links,
        "clutter_later_quartiles_m": np.quantile(late, [0.25, 0.5, 0.75]).tolist() if len(late) else None,
        "clutter_beside_quartiles_deg": np.degrees(np.quantile(beside, [0.25, 0.5, 0.75])).tolist()
        if len(beside)
        else None,
    }


def offsets(sample: Sample) -> tuple[Floats, Floats]:
    """Return of each clutter point how much later than the nearest path before it, and how far beside in azimuth."""
    late, beside = [], []
    for link, distance, azimuth, *_ in sample.clutter:
        rows = np.flatnonzero(sample.link == int(link))
        behind = distance - sample.geometry[rows, 0]
        turn = np.abs(np.asarray(wrap_angle(azimuth - sample.geometry[rows, 1])))
        cost = np.abs(behind) / 40.0 + turn / 0.3 + np.where(behind < -15.0, 1e3, 0.0)
        nearest = int(np.argmin(cost))
        late.append(behind[nearest])
        beside.append(turn[nearest])
    return np.array(late), np.array(beside)


__all__ = ["PORTS", "agreement", "calibrate", "constants"]
