"""The simulation of PHD-SLAM 3.0: 160 landmarks, four kilometres, a sensor of 150 m and 180 degrees with clutter.

Source: O. Kaltiokallio, R. Hostettler, Y. Ge, H. Kim, J. Talvitie, H. Wymeersch and M. Valkama, "A multihypotheses
importance density for SLAM in cluttered scenarios", IEEE Trans. Robotics 40, 2024, and the authors' repository
okaltiok/PHD-SLAM-3.0, commit 35a64de: landmarks, trajectory, parameters and results.
"""

from __future__ import annotations

import math
import tomllib
from functools import cache
from pathlib import Path

import numpy as np

from cellslam.scenarios.known_worlds.known_world import (
    LEVEL_DEG,
    LEVEL_DENSITY,
    WHITE,
    Entry,
    Figure,
    KnownWorld,
    one_link_a_site,
    plane_truth,
    shuffled,
)
from cellslam.sim.frames import mean_velocity, wrap_angle
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Floats, Ints, Measurements, OdometryModel, Recording, Sites
from cellslam.slam.model.measurement_model import predict

STEPS, BLOCK = 4000, 100
REACH_M, SPAN_RAD = 150.0, 0.5 * math.pi
DETECTION, CLUTTER = 0.95, 5.0  # clutter is thinned by the probability of detection, too
STD = np.array([0.8, math.radians(0.3)])
ODOMETRY_STD = np.array([0.8, 0.0, 0.0, math.radians(0.5), 0.0, 0.0])
CONTROL_STD, SPEED_MPS = np.array([0.05, math.radians(0.03)]), 1.0
# Turn rates (rad/s) of the segments, and their lengths in steps.
SEGMENTS = (
    (300, 0.0), (500, math.pi / 250.0), (400, 0.0), (400, math.pi / 400.0), (500, 0.0), (400, -math.pi / 400.0),
    (500, 0.0), (300, 0.01096), (400, 0.0), (200, -math.pi / 200.0), (100, 0.0),
)  # fmt: skip
_PUBLISHED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
WAYPOINTS, LANDMARKS_M = np.array(_PUBLISHED["waypoints"]), np.array(_PUBLISHED["landmarks_m"])


@cache
def trajectory() -> Floats:
    """Return the poses (T, 6), in m and rad: controls as published, drawn once, and in each block of 100 steps so
    corrected, by
    constant changes of speed and turn rate and one that grows, that they meet the published trajectory."""
    rng = np.random.default_rng(2024)
    turn = np.concatenate([np.full(count, rate) for count, rate in SEGMENTS])
    controls = np.column_stack([np.full(STEPS, SPEED_MPS), turn]) + CONTROL_STD * rng.standard_normal((STEPS, 2))
    poses = [WAYPOINTS[0]]
    for block, target in enumerate(WAYPOINTS[1:]):
        poses += _meeting(poses[-1], controls[block * BLOCK : (block + 1) * BLOCK], target)
    poses += _driven(poses[-1], controls[len(poses) - 1 : STEPS - 1])
    out = np.zeros((STEPS, 6))
    out[:, [0, 1, 3]] = poses
    out[:, 3] = wrap_angle(out[:, 3])
    return out


def _meeting(start: Floats, controls: Floats, target: Floats) -> list[Floats]:
    """Return the poses (x, y, heading) after each of the controls, corrected to end at a target (Newton's method)."""
    ramp, change = np.linspace(-1.0, 1.0, len(controls)), np.zeros(3)

    def end(c: Floats) -> list[Floats]:
        return _driven(start, controls + np.column_stack([np.full(len(ramp), c[0]), c[1] + c[2] * ramp]))

    for _ in range(8):
        miss = end(change)[-1] - target
        slopes = [(end(change + 1e-6 * axis)[-1] - target - miss) / 1e-6 for axis in np.eye(3)]
        change = change - np.linalg.solve(np.column_stack(slopes), miss)
    return end(change)


def _driven(start: Floats, controls: Floats) -> list[Floats]:
    """Return the poses (x, y, heading) after each second at a speed (m/s) and a turn rate (rad/s): exact arcs."""
    out, (x, y, h) = [], start
    for v, w in controls:
        x, y = x + v / w * (math.sin(h + w) - math.sin(h)), y + v / w * (math.cos(h) - math.cos(h + w))
        h += w
        out.append(np.array([x, y, h]))
    return out


def simulate(seed: int, trial: int) -> Recording:
    """Return the recording of a run: the same truth, new odometry and scans."""
    poses = trajectory()
    odometry = np.zeros((STEPS, 6))
    odometry[1:] = mean_velocity(poses[:-1], poses[1:], np.ones(STEPS - 1))
    odometry[1:] += ODOMETRY_STD * stream(seed, trial, Stream.ODOMETRY).standard_normal((STEPS - 1, 6))
    table, vt = _scans(poses, seed, trial)
    none, site = np.zeros(6), np.zeros(len(LANDMARKS_M), np.int64)
    return Recording(
        time_s=np.arange(STEPS, dtype=np.float64), odometry=odometry,
        odometry_model=OdometryModel(ODOMETRY_STD, none, none, none), links=one_link_a_site(1),
        sites=Sites(("landmarks",), np.zeros(1), np.zeros(1)), measurements=table, start_pose=poses[0],
        start_std=none, provenance={"known_world": WORLD.name, "seed": seed, "trial": trial},
        truth=plane_truth(poses, LANDMARKS_M, site, vt, STD), plane=True,
    )  # fmt: skip


def _scans(poses: Floats, seed: int, trial: int) -> tuple[Measurements, Ints]:
    whole = np.column_stack([LANDMARKS_M, np.zeros(len(LANDMARKS_M))])
    seen = predict(poses[:, None, :], whole[None])[..., :2]
    visible = (seen[..., 0] <= REACH_M) & (np.abs(seen[..., 1]) <= SPAN_RAD)
    rng = stream(seed, trial, Stream.DETECTION)
    step, vt = np.nonzero(visible & (rng.random(visible.shape) < DETECTION))
    clutter = stream(seed, trial, Stream.CLUTTER)
    false = np.repeat(np.arange(STEPS), clutter.binomial(clutter.poisson(CLUTTER, STEPS), DETECTION))
    where = clutter.random((len(false), 2)) * [REACH_M, 2.0 * SPAN_RAD] - [0.0, SPAN_RAD]
    values = np.concatenate([seen[step, vt], where])
    values += STD * stream(seed, trial, Stream.NOISE).standard_normal(values.shape)
    values[:, 0] = np.abs(values[:, 0])
    values[:, 1] = wrap_angle(values[:, 1])
    snapshot = np.concatenate([step, false])
    link, all_vt = np.zeros(len(snapshot), np.int64), np.append(vt, np.full(len(false), -1))
    return shuffled(snapshot, link, all_vt, values, stream(seed, trial, Stream.RECEIVER))


_OPTIONS = {
    **WHITE, "noise_floor_m": float(STD[0]), "noise_floor_azimuth_deg": 0.3, "noise_floor_elevation_deg": LEVEL_DEG,
    "detection_probability": DETECTION, "visible_s": 1e4, "hidden_s": 1e5, "effective_share": 0.2, "confirm_hits": 3,
    "clutter_density": DETECTION * CLUTTER / (2.0 * REACH_M * SPAN_RAD) * LEVEL_DENSITY,
}  # fmt: skip
_RESULTS = {1: (3.45, 0.42, 46.84), 10: (2.66, 0.34, 38.27), 100: (2.18, 0.29, 32.12)}
_FIGURES = (
    Figure("position RMSE", "position_rmse_m", "rmse", "m"),
    Figure("heading RMSE", "heading_rmse_rad", "rmse", "deg", math.degrees(1.0)),
    Figure("GOSPA of the final map", "map_gospa_m", "mean", "m"),
)
WORLD = KnownWorld(
    name="phd-slam-3",
    title="the simulation of PHD-SLAM 3.0: 160 landmarks, 4000 s, range and bearing with clutter",
    source="Kaltiokallio et al., IEEE Trans. Robotics 40, 2024; okaltiok/PHD-SLAM-3.0, README",
    simulate=simulate,
    figures=_FIGURES,
    entries=tuple(
        Entry(
            f"{n} particle{'' if n == 1 else 's'}", "phd-slam", {**_OPTIONS, "particles": n},
            dict(zip((f.name for f in _FIGURES), published, strict=True)),
        )
        for n, published in _RESULTS.items()
    ),
    trials=100,
    differences=(
        "The 4000 controls are drawn as published and corrected so that the drive meets the published trajectory "
        "every 100 steps; in between it differs by about a metre.",
        "Noise, detections and clutter are of other random numbers; measurements of a scan are shuffled.",
        "The published filter takes clutter as uniform over the area; here it is taken as it is drawn, uniform in "
        "range and bearing.",
        "The field of view is not given to the filter: it learns it from its measurements.",
        "The published estimate is the heaviest particle, here the mean over all; with one particle the mean of the "
        "importance density is taken in place of a draw.",
        "The published map has all 160 landmarks for truth, here those detected at least 20 times.",
    ),
)  # fmt: skip
