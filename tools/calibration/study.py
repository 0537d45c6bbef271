"""`python -m tools calibrate`: the study that gives the statistical front end its constants."""

from __future__ import annotations

import platform
from importlib.metadata import version
from typing import Any

import numpy as np

from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.signal.signal_front_end import GAIN_STD_DB, PHASE_STD_DEG
from cellslam.sim.lte.statistical.detector_layout import GAMMA_STEP_DB, NOTHING_STANDS, PathColumns
from cellslam.sim.lte.statistical.statistics import parse
from cellslam.sim.progress import Progress
from tools.calibration.fit_constants import NODES, fit_company, fit_detection, fit_floor, fit_overlap, structured
from tools.calibration.persistence import persistence
from tools.calibration.recurrence import standing
from tools.calibration.scenes import Sample, config_of, draw_paths, finer_db, measured_by_signals, scenes_of

RATIOS_DB = (0.0, 3.0, 6.0, 9.0, 12.0, 16.0, 20.0, 40.0)
OVERLAP_RATIOS_DB = (3.0, 6.0, 15.0, 40.0)
NOISE_SHARE = 0.5  # of the scenes of one ratio: as many without any path
LEAST_DB, MOST_DB = -38.0, 18.0


def calibrate(radio: RadioConfig, scenes: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Return the constants of a band and their provenance, from `scenes` scenes of a lone path at each of eight ratios,
    as many of several paths at four, and half as many without any.
    """
    rng, weakest = np.random.default_rng([seed, 1]), LEAST_DB - finer_db(radio)
    empty = int(NOISE_SHARE * scenes)
    lone: dict[float, Sample] = {}
    several: dict[float, tuple[list[PathColumns], Sample]] = {}
    total = empty + len(RATIOS_DB) * scenes + len(OVERLAP_RATIOS_DB) * scenes
    with progress("measuring scenes", total) as advance:
        nothing = [draw_paths(rng, np.empty(0), radio)] * empty
        noise = measured_by_signals(config_of(40.0, radio), nothing, rng, advance)
        for ratio in RATIOS_DB:
            config = config_of(ratio, radio)
            drawn = [draw_paths(rng, rng.uniform(weakest, MOST_DB, 1), config) for _ in range(scenes)]
            lone[ratio] = measured_by_signals(config, drawn, rng, advance)
        for ratio in OVERLAP_RATIOS_DB:
            config = config_of(ratio, radio)
            crowds = scenes_of(rng, scenes, config)
            several[ratio] = crowds, measured_by_signals(config, crowds, rng, advance)
    result = constants(radio, noise, lone, several)
    moved = np.random.default_rng([seed, 4])
    result["standing"], result["recurrence"] = standing(radio, max(scenes // 6, 8), moved, parse(result), progress)
    result["persistence"] = persistence(radio, max(scenes // 8, 8), np.random.default_rng([seed, 2]), progress)
    return {"provenance": provenance(radio, scenes, seed), **rounded(result)}


def rounded(value: Any) -> Any:
    """Return nested lists and tables with every number to five digits: more are not known."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def constants(
    radio: RadioConfig,
    noise: Sample,
    lone: dict[float, Sample],
    several: dict[float, tuple[list[PathColumns], Sample]],
) -> dict[str, Any]:
    """Return the constants of a band that the samples give."""
    window, threshold, waveform = radio.window_max_m - radio.window_min_m, radio.detection_threshold, radio.waveform()
    nodes = NODES + round(finer_db(radio) / GAMMA_STEP_DB)
    rate = len(noise.clutter) / noise.links
    detection = fit_detection(lone[max(lone)], threshold)
    first = {
        "threshold": threshold,
        "bandwidth_hz": waveform.bandwidth_hz,
        "detection": detection,
        "overlap": fit_overlap(
            {ratio: sample for ratio, (_, sample) in several.items()}, detection, threshold, waveform
        ),
        "noise_cells": rate / float(np.exp(-threshold) * (1.0 + threshold)),
        "floors": fit_floor(lone, waveform),
        "clutter": {f"{ratio:g}": structured(s, rate, window, nodes) for ratio, s in lone.items()},
        "company": dict.fromkeys(("0", "40"), 1.0),
        "standing": NOTHING_STANDS._asdict(),
    }
    rng = np.random.default_rng(len(several))
    company = {
        f"{ratio:g}": fit_company(config_of(ratio, radio), *crowds, parse(first), rng)
        for ratio, crowds in several.items()
    }
    return first | {"company": company}


def provenance(radio: RadioConfig, scenes: int, seed: int) -> dict[str, Any]:
    """Return what is needed to make the constants again."""
    return {
        "command": f"python -m tools calibrate --technology {radio.technology} "
        f"--resource-blocks {radio.resource_blocks} --scenes {scenes} --seed {seed}",
        "versions": {name: version(name) for name in ("cellslam", "numpy", "scipy", "numba")}
        | {"python": platform.python_version()},
        "hardware": {"phase_std_deg": PHASE_STD_DEG, "gain_std_db": GAIN_STD_DB},
        "ratios_db": list(RATIOS_DB),
    }
