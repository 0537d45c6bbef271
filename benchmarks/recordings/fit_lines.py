"""What `fit_noise` found, as the lines of a scenario."""

from __future__ import annotations

from pathlib import Path

from cellslam.benchmarks.recordings.fit_noise import NAMES, PLANE_ELEVATION_DEG, Fitted
from cellslam.sim.recording import Recording


def options(recording: Recording, fitted: Fitted) -> dict[str, float | int]:
    """Return the front-end options that the estimators share, as fitted; names that they do not have are left out."""
    from cellslam.slam.front_end import FrontEndOptions

    out: dict[str, float | int] = {
        "detection_probability": fitted.detection_probability,
        "clutter_density": fitted.clutter_density,
        "visible_s": fitted.visible_s,
    }
    for key in NAMES.values():
        floor = PLANE_ELEVATION_DEG if recording.plane and key == "elevation_deg" else fitted.floor.get(key)
        if floor is not None:
            out[f"noise_floor_{key}"], out[f"noise_unit_snr_{key}"] = floor, fitted.unit.get(key, 0.0)
            out[f"place_{key}"] = 0.0
            out[f"direction_{key}"] = fitted.slow.get(key, 0.0)
    return {name: float(f"{value:.3g}") for name, value in out.items() if name in FrontEndOptions.model_fields}


def lines(path: Path, recording: Recording, fitted: Fitted) -> str:
    """Return the scenario lines to paste, and the same as --set options; comments say what they are from."""
    found = options(recording, fitted)
    out = [f"# {path}: {fitted.tracks} tracks in {fitted.rows} measurements"]
    for key, ratio in fitted.claimed.items():
        out.append(
            f"# white errors are {ratio:.2f} times the deviations that the front end claims ({key.replace('_deg', '')})"
        )
    for name in ("fastslam", "ekf-slam"):
        out += ["", f"[estimator.{name}]", *(f"{key} = {value:g}" for key, value in found.items())]
    if fitted.odometry:
        out += ["", "# recording.toml: the odometry's data sheet"]
        for name, (density, bias) in fitted.odometry.items():
            out += [f"[noise.{name}]", f"noise_density = {density:.3g}", f"bias = {bias:.3g}"]
    out += ["", "# for cellslam replay:"]
    out += [
        f"#   {' '.join(f'--set estimator.{name}.{k}={v:g}' for k, v in found.items())}"
        for name in ("fastslam", "ekf-slam")
    ]
    return "\n".join(out) + "\n"
