"""What `fit_noise` found, as the lines of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cellslam.benchmarks.recordings.fitting.fit_noise import PLANE_ELEVATION_DEG, Fitted
from cellslam.benchmarks.recordings.fitting.fit_persisting import NAMES
from cellslam.sim.recording import Recording


def least_floor(recording: Recording) -> dict[str, float]:
    """Return the least deviations (m, deg) with which a filter of particles can tell its particles apart.

    A step of the vehicle is drawn with the odometry's white noise. A likelihood of n paths that is much narrower leaves
    one particle, whatever the truth: so no path counts for less than sqrt(n) times that noise.
    """
    rows, steps = np.diff(recording.rows), np.diff(recording.time_s)
    paths = float(np.median(rows[rows > 0])) if (rows > 0).any() else 1.0
    step = float(np.sqrt(paths * np.median(steps))) if len(steps) else 0.0
    density = recording.odometry_model.noise_density
    return {"m": step * float(density[0]), "azimuth_deg": step * float(np.degrees(density[3]))}


def options(recording: Recording, fitted: Fitted, least: Mapping[str, float]) -> dict[str, float | int]:
    """Return the front-end options that the estimators share, as fitted, floors of `least` at least; names that they
    do not have are left out."""
    from cellslam.slam.front_end.front_end_options import FrontEndOptions

    out: dict[str, float | int] = {
        "detection_probability": fitted.detection_probability,
        "clutter_density": fitted.clutter_density,
        "visible_s": fitted.visible_s,
    }
    for key in NAMES.values():
        floor = PLANE_ELEVATION_DEG if recording.plane and key == "elevation_deg" else fitted.floor.get(key)
        if floor is not None:
            out[f"noise_floor_{key}"] = max(floor, least.get(key, 0.0))
            out[f"noise_unit_snr_{key}"] = fitted.unit.get(key, 0.0)
            out[f"diffuse_{key}"] = fitted.persisting.place.get(key, 0.0)
            out[f"calibration_{key}"] = fitted.persisting.direction.get(key, 0.0)
    if fitted.persisting.scale_m:
        out["diffuse_scale_m"] = fitted.persisting.scale_m
    if fitted.range_m is not None:
        out["typical_range_m"] = fitted.range_m
    return {name: float(f"{value:.3g}") for name, value in out.items() if name in FrontEndOptions.model_fields}


def lines(path: Path, recording: Recording, fitted: Fitted) -> str:
    """Return the scenario lines to paste, or for `replay --options`; comments say what they are from."""
    out = [f"# {path}: {fitted.tracks} tracks in {fitted.rows} measurements"]
    for key, ratio in fitted.claimed.items():
        name = "distance" if key == "m" else key.removesuffix("_deg")
        out.append(f"# white errors are {ratio:.2f} times the deviations that the front end claims ({name})")
    out += ["# cellslam replay takes this file as --options FILE.toml"]
    for name, least in (("fastslam", least_floor(recording)), ("ekf-slam", {})):
        table = options(recording, fitted, least)
        out += ["", f"[estimator.{name}]"]
        if table != options(recording, fitted, {}):
            out.append("# noise_floor: raised to sqrt(paths) times the odometry's noise of a step, for few particles")
        out += [f"{key} = {value:g}" for key, value in table.items()]
    if fitted.odometry:
        out += ["", "# for recording.toml: the odometry's data sheet"]
        for name, (density, bias) in fitted.odometry.items():
            out += [f"# [noise.{name}]", f"# noise_density = {density:.3g}", f"# bias = {bias:.3g}"]
    return "\n".join(out) + "\n"
