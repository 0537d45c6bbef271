"""Constants of the statistical front end from samples of the signal-level one: method of moments and likelihoods.

Source: own derivation, studies/front-end-calibration.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import ncx2

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.error_bounds import bound_scales, single_path_std
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.statistical.detector_layout import GAMMA_START_DB, GAMMA_STEP_DB, PathColumns
from cellslam.sim.lte.statistical.statistics import Statistics
from cellslam.sim.recording import Floats
from cellslam.sim.waveform import Waveform
from tools.calibration.front_end_check import AHEAD_M, BEHIND_M, BESIDE_RAD, offsets
from tools.calibration.overlap import Law, chances, relations
from tools.calibration.scenes import Sample, measured_by_statistics

NODES = 13  # of LTE
# Laws to begin the search from, as the likelihood has several peaks: sidelobes near the path, and all over the window.
STARTS = (Law(8.0, 3.0, -0.2, -2.0, -1.0, 15.0), Law(8.0, 3.0, -1.0, -2.5, -2.0, 150.0))
DRAWS = 8  # of the statistical front end, which is cheap
LEAST_CLUTTER = 50.0
POINTS = 48  # of clutter kept per node
STRONG_DB = 38.0  # integrated SNR from which the bound is far below what diffuse energy does


def fit_detection(sample: Sample, threshold: float) -> dict[str, float]:
    """Return degrees of freedom and gain of P(T > x) = ncx2.sf(2 x, dof, gain Gamma), by maximum likelihood."""
    near = (sample.gamma_db > 5.0) & (sample.gamma_db < 22.0)
    gamma, found = 10.0 ** (sample.gamma_db[near] / 10.0), sample.detected[near]

    def loss(p: Floats) -> float:
        chance = np.clip(ncx2.sf(2.0 * threshold, p[0], p[1] * gamma), 1e-6, 1.0 - 1e-6)
        return float(-np.sum(np.where(found, np.log(chance), np.log(1.0 - chance))))

    best = minimize(loss, np.array([6.0, 1.9]), method="Nelder-Mead", bounds=[(2.0, 14.0), (1.2, 2.4)])
    return {"dof": float(best.x[0]), "gain": float(best.x[1])}


def fit_floor(samples: dict[float, Sample], waveform: Waveform) -> dict[str, Any]:
    """Return the floors that do not depend on the ratio (calibration) and those of diffuse energy at 0 dB.

    Variances over strong lone paths, the bound's taken off, are a + b 10^(-K / 10); robust against what is no error of
    the path but another path in its place: errors beyond four deviations do not count.
    """
    ratio, variance, weight = [], [], []
    samples_db = 10.0 * np.log10(bound_scales(waveform).samples)
    for k_db, s in samples.items():
        strong = s.detected & (s.gamma_db > STRONG_DB)
        bound = single_path_std(s.gamma_db[strong] - samples_db, s.geometry[strong, 2], waveform)
        error = s.error[strong]
        spread = np.median(np.abs(error), axis=0) / 0.6745
        inside = np.abs(error) < 4.0 * spread
        var = np.array([np.mean(error[inside[:, c], c] ** 2 - bound[inside[:, c], c] ** 2) for c in range(3)])
        ratio.append(10.0 ** (-k_db / 10.0))
        variance.append(np.maximum(var, 1e-12))
        weight.append(np.sqrt(strong.sum()))
    design = np.column_stack([np.ones(len(ratio)), ratio])
    out = {}
    for c, name in enumerate(("distance_m", "azimuth_rad", "elevation_rad")):
        v = np.array([x[c] for x in variance])
        scale = np.array(weight) / v  # relative errors count alike
        a, b = np.linalg.lstsq(design * scale[:, None], v * scale, rcond=None)[0]
        out[name] = {"calibration": float(np.sqrt(max(a, 0.0))), "diffuse_at_0_db": float(np.sqrt(max(b, 0.0)))}
    return out


def structured(sample: Sample, noise_rate: float, window_m: float, nodes: int = NODES) -> dict[str, Any]:
    """Return the clutter around a lone path over `nodes` of its integrated SNR: mean number, and some of the points:
    how much later (m), azimuth and elevation beside it (rad), SNR (dB). The noise's own share is taken off the mean.
    """
    order = {int(link): row for row, link in enumerate(sample.link)}
    own = np.array([order[int(link)] for link in sample.clutter[:, 0]], np.int64)
    late = sample.clutter[:, 1] - sample.geometry[own, 0]
    beside = np.asarray(wrap_angle(sample.clutter[:, 2] - sample.geometry[own, 1]))
    above = sample.clutter[:, 3] - sample.geometry[own, 2]
    points = np.column_stack([late, beside, above, sample.clutter[:, 4]])
    around = (late > -AHEAD_M) & (late < BEHIND_M) & (np.abs(beside) < BESIDE_RAD)
    at = np.clip(np.rint((sample.gamma_db - GAMMA_START_DB) / GAMMA_STEP_DB), -1, nodes - 1)
    noise = noise_rate * (BEHIND_M + AHEAD_M) / window_m * BESIDE_RAD / np.pi
    table: dict[str, Any] = {"mean": [], "points": []}
    for node in range(nodes):
        links = int(np.sum(at == node))
        rows = around & (at[own] == node)
        # Few points: those of the neighbouring nodes help with the shape.
        shape = rows if rows.sum() >= 40 else around & (np.abs(at[own] - node) <= 2)
        shape = shape if shape.sum() >= 10 else around
        table["mean"].append(max(float(rows.sum()) / max(links, 1) - noise, 0.0))
        table["points"].append(evenly(points[shape]).tolist())
    return table


def evenly(points: Floats) -> Floats:
    """Return POINTS of the points (n, 4), m, rad, rad, dB, evenly spread over how much later they are."""
    ordered = points[np.argsort(points[:, 0], kind="stable")]
    return ordered[((np.arange(POINTS) + 0.5) * len(ordered) / POINTS).astype(np.int64)]


def fit_company(
    config: RadioConfig, scenes: list[PathColumns], signal: Sample, constants: Statistics, rng: np.random.Generator
) -> float:
    """Return how many times as much clutter the signal level reports in scenes of several paths as `constants`, from
    lone paths, give: of what belongs to a path. Where there is little there is nothing to say, and it is 1.
    """
    drawn = [measured_by_statistics(config, scenes, rng, constants) for _ in range(DRAWS)]
    own = sum(int(offsets(sample)[2].sum()) for sample in drawn) / DRAWS
    return int(offsets(signal)[2].sum()) / own if own > LEAST_CLUTTER else 1.0


def fit_overlap(
    samples: dict[float, Sample], detection: dict[str, float], threshold: float, waveform: Waveform
) -> dict[str, float]:
    """Return how paths among others are detected: logistic centre and width (dB) of crowded ones, and how much stronger
    paths disturb weaker ones, by maximum likelihood.
    """
    law = detection["dof"], detection["gain"]
    parts = {k_db: relations(s, waveform) for k_db, s in samples.items()}

    def loss(p: Floats) -> float:
        total = 0.0
        for k_db, s in samples.items():
            chance = np.clip(chances(s, parts[k_db], k_db, law, threshold, Law(*p)), 1e-3, 1.0 - 1e-3)
            total -= float(np.sum(np.where(s.detected, np.log(chance), np.log(1.0 - chance))))
        return total

    options = {"xatol": 0.01, "fatol": 0.1, "maxiter": 2000}
    found = [minimize(loss, np.array(start), method="Nelder-Mead", options=options) for start in STARTS]  # type: ignore[call-overload]
    best = Law(*min(found, key=lambda one: one.fun).x)
    return {
        "centre_db": float(best.centre_db), "width_db": float(abs(best.width_db)), "trail": float(10.0**best.log_trail),
        "around": float(10.0**best.log_around), "sidelobes": float(10.0**best.log_sidelobes),
        "sidelobe_m": float(abs(best.sidelobe_m)),
    }  # fmt: skip
