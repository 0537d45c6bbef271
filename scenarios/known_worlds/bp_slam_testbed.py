"""The test bed of BP-SLAM: two anchors and nine virtual anchors in a room, distances alone, no odometry.

Source: E. Leitinger, F. Meyer, F. Hlawatsch, K. Witrisal, F. Tufvesson and M. Win, "A belief propagation algorithm for
multipath-based SLAM", IEEE Trans. Wireless Communications 18(12), 2019, and the published MATLAB test bed with its
scenario scenarioCleanM2_new.mat (as in the repositories q123-a/bp_slam_matlab, commit bf5698b, and q123-a/bp_slam,
commit ad9b9f4): positions, trajectory, parameters; agent error as its figure of one run shows it.
"""

from __future__ import annotations

import math
from functools import cache

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
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Floats, Ints, Measurements, OdometryModel, Recording, Sites

STEPS, STEP_M = 900, 0.01
DETECTION, CLUTTER, REACH_M = 0.95, 1.0, 30.0
STD_M, ASSUMED_STD_M = 0.1, 0.15
START_RADIUS_M, START_SPEED_MPS, ACCELERATION_MPS2 = 0.5, 0.05, 0.01
# Anchors and virtual anchors (m) of the two sites, the anchor first.
ANCHORS_M = np.array([(0.5, 7.0), (5.2, 2.3)])
FEATURES_M = np.array([
    (0.5, 7.0), (8.14, 7.0), (0.5, -6.996), (11.05, 7.0), (0.5, 10.094), (-1.116, 7.0),
    (5.2, 2.3), (5.2, -2.3), (5.2, 14.794), (-5.81, 2.3), (13.84, 2.3),
])  # fmt: skip
SITE = np.repeat([0, 1], [6, 5])
# Runs of steps of a centimetre along a direction; one shorter step lies at the last corner.
START_M = (3.02, 7.82)
RUNS = ((80, -1, 0), (230, 0, -1), (120, -1, 0), (130, 0, -1), (50, -1, 0), (104, 0, -1))
CORNER_M = (0.000579830217, -0.004009801920)
LAST_RUN = (0.857492925713, -0.514495755428)


@cache
def trajectory() -> Floats:
    """Return the poses (T, 6), in m and rad; the heading stays as it is."""
    steps = [np.tile(STEP_M * np.array(ahead, float), (count, 1)) for count, *ahead in RUNS]
    rest = STEPS - 1 - sum(len(part) for part in steps) - 1
    steps += [np.array([CORNER_M]), np.tile(STEP_M * np.array(LAST_RUN), (rest, 1))]
    out = np.zeros((STEPS, 6))
    out[:, :2] = START_M
    out[1:, :2] += np.cumsum(np.concatenate(steps), axis=0)
    return out


def simulate(seed: int, trial: int) -> Recording:
    """Return the recording of a run. The motion is one of constant velocity with white acceleration: velocities that
    are not measured, with a bias that walks; the heading is known."""
    poses, nothing = trajectory(), np.zeros(6)
    odometry = np.full((STEPS, 6), np.nan)
    odometry[0] = 0.0
    plane = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    model = OdometryModel(nothing, START_SPEED_MPS / math.sqrt(3.0) * plane, ACCELERATION_MPS2 * plane, nothing)
    table, vt = _ranges(poses, seed, trial)
    return Recording(
        time_s=np.arange(STEPS, dtype=np.float64), odometry=odometry, odometry_model=model, links=one_link_a_site(2),
        sites=Sites(("1", "2"), np.zeros(2), np.zeros(2), position_m=np.column_stack([ANCHORS_M, np.zeros(2)])),
        measurements=table, start_pose=poses[0], start_std=0.5 * START_RADIUS_M * plane,
        provenance={"known_world": WORLD.name, "seed": seed, "trial": trial},
        truth=plane_truth(poses, FEATURES_M, SITE, vt, np.array([STD_M, np.nan])), plane=True,
    )  # fmt: skip


def _ranges(poses: Floats, seed: int, trial: int) -> tuple[Measurements, Ints]:
    distance = np.linalg.norm(poses[1:, None, :2] - FEATURES_M, axis=-1)
    found = stream(seed, trial, Stream.DETECTION).random(distance.shape) < DETECTION
    step, vt = np.nonzero(found)
    measured = distance[step, vt] + STD_M * stream(seed, trial, Stream.NOISE).standard_normal(len(vt))
    clutter = stream(seed, trial, Stream.CLUTTER)
    number = clutter.poisson(CLUTTER, (STEPS - 1, 2))
    at, link = (np.repeat(index.ravel(), number.ravel()) for index in np.indices(number.shape))
    values = np.concatenate([np.abs(measured), REACH_M * clutter.random(len(at))])
    both = np.column_stack([values, np.full(len(values), np.nan)])
    all_vt, rng = np.append(vt, np.full(len(at), -1)), stream(seed, trial, Stream.RECEIVER)
    return shuffled(1 + np.append(step, at), np.append(SITE[vt], link), all_vt, both, rng)


_AZIMUTH_WIDTH = 0.3  # the factor of an azimuth that is missing: what `readings.CLUTTER_WIDTH` takes off
_OPTIONS = {
    **WHITE, "noise_floor_m": ASSUMED_STD_M, "noise_floor_elevation_deg": LEVEL_DEG,
    "detection_probability": DETECTION, "visible_s": 1e3, "hidden_s": 1e5,
    "clutter_density": CLUTTER / REACH_M / _AZIMUTH_WIDTH * LEVEL_DENSITY,
}  # fmt: skip
WORLD = KnownWorld(
    name="bp-slam-testbed",
    title="the test bed of BP-SLAM: two anchors, nine virtual anchors, distances alone",
    source="Leitinger et al., IEEE Trans. Wireless Communications 18(12), 2019; published MATLAB test bed, one run",
    simulate=simulate,
    figures=(
        Figure("agent RMSE", "position_rmse_m", "median", "m"),
        Figure("largest agent error", "position_max_m", "median", "m"),
        Figure("runs above 0.5 m", "position_rmse_m", "share>0.5", "share"),
    ),
    entries=(Entry("bp-slam", "bp-slam", _OPTIONS, {"agent RMSE": 0.080, "largest agent error": 0.21}),),
    trials=30,
    differences=(
        "Published is one run of 100 000 particles, read off a figure to 0.003 m; own are medians of runs.",
        "Positions at the start are drawn from a normal density with the deviation of the published disc of 0.5 m, "
        "velocities likewise.",
        "All measurements have one assumed deviation, 0.15 m; the published data tell false from true by theirs.",
        "Features have no process noise.",
    ),
)
