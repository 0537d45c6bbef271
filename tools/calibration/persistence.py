"""Which errors of the signal level are white and which persist: correlation over time, links, place, direction.

Source: own derivation, studies/front-end-calibration.md.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cellslam.sim.frames import unit_vector, wrap_angle
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.signal.signal_front_end import SignalLevel, true_geometry
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import PathColumns
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Floats
from tools.calibration.scenes import POSE, cells, config_of, draw_paths, geometry_of, in_scene, signal_bench

SHIFTS_M = (0.0, 0.03, 0.06, 0.1, 0.2, 0.4)
TURNS_DEG = (0.0, 4.0, 8.0, 15.0, 25.0, 45.0)
STRONG_DB = 5.0
STILL = np.zeros(3)


def persistence(radio: RadioConfig, scenes: int, rng: np.random.Generator, progress: Progress) -> dict[str, Any]:
    """Return the correlation of a strong lone path's errors with those later, on the other port, and from elsewhere
    (diffuse energy, 6 dB); and with those from other directions through the same array (no diffuse energy).
    """
    with progress("measuring persistence", 2 * scenes) as advance:
        place, port = [], []
        for _ in range(scenes):
            errors = _moved(radio, rng)
            place.append(errors[:, 0])
            port.append(errors[0, :])
            advance(1)
        turned = []
        for _ in range(scenes):
            turned.append(_turned(radio, rng))
            advance(1)
    along, ports, turns = np.array(place), np.array(port), np.array(turned)
    return {
        "shifts_m": list(SHIFTS_M),
        "diffuse_over_place": [_correlation(along[:, 0], along[:, 1 + i]) for i in range(len(SHIFTS_M))],
        "diffuse_over_ports": _correlation(ports[:, 0], ports[:, 1]),
        "turns_deg": list(TURNS_DEG),
        "calibration_over_turns": [_correlation(turns[:, 0, 1:], turns[:, 1 + i, 1:]) for i in range(len(TURNS_DEG))],
        "components": ["distance", "azimuth", "elevation"],
    }


def _moved(radio: RadioConfig, rng: np.random.Generator) -> Floats:
    """Return errors (1 + shifts, ports, 3): twice in one place (the first two), then from places along a line."""
    front_end, paths = _lone(config_of(6.0, radio), rng)
    line = unit_vector(rng.uniform(-np.pi, np.pi), 0.0)
    rows = []
    for shift in (0.0, *SHIFTS_M):
        pose = POSE.copy()
        pose[:3] += shift * line
        rows.append(_errors(front_end, paths, pose, rng))
    return np.array(rows)


def _turned(radio: RadioConfig, rng: np.random.Generator) -> Floats:
    """Return errors (1 + turns, 3) of one port: twice in one direction (the first two), then turned by yaw."""
    front_end, paths = _lone(config_of(40.0, radio), rng)
    rows = []
    for turn in (0.0, *TURNS_DEG):
        pose = POSE.copy()
        pose[3] += np.radians(turn)
        rows.append(_errors(front_end, paths, pose, rng)[0])
    return np.array(rows)


def _lone(config: RadioConfig, rng: np.random.Generator) -> tuple[SignalLevel, PathColumns]:
    bench = in_scene(signal_bench(config), rng)
    return replace(bench, cells=cells()), draw_paths(rng, np.array([STRONG_DB]), bench.config)


def _errors(front_end: SignalLevel, paths: PathColumns, pose: Floats, rng: np.random.Generator) -> Floats:
    """Return errors (ports, 3) of the lone path, NaN where it was missed."""
    table = front_end.measure(paths, pose, STILL, STILL, 0, rng)
    truth = true_geometry(paths, pose)[0]
    out = np.full((2, 3), np.nan)
    for row in table[table[:, k.PATH] >= 0.0]:
        error = row[[k.DISTANCE, k.AZIMUTH, k.ELEVATION]] - truth
        error[1] = wrap_angle(error[1])
        out[int(row[k.LINK])] = error
    return out


def _correlation(one: Floats, other: Floats) -> list[float]:
    """Return the correlation of each component over scenes (n, c); what was missed, and errors beyond four deviations,
    do not count.
    """
    out = []
    for a, b in zip(one.T, other.T, strict=True):
        spread = np.nanmedian(np.abs(np.concatenate([a, b]))) / 0.6745
        good = (np.abs(a) < 4.0 * spread) & (np.abs(b) < 4.0 * spread)
        out.append(float(np.mean(a[good] * b[good]) / np.sqrt(np.mean(a[good] ** 2) * np.mean(b[good] ** 2))))
    return out


__all__ = ["geometry_of", "persistence"]
