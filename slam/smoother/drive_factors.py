"""From a drive with EKF-SLAM's associations to the factor graph's problem, and from its keyframes to every pose.

Odometry between keyframes is one factor, a leg: relative motion, its covariance, and how biases and scales change it.

Sources: Dellaert and Kaess, "Factor graphs for robot perception", Foundations and Trends in Robotics 6, 2017; Lupton
and Sukkarieh, "Visual-inertial-aided navigation for high-dynamic motion in built environments without initial
conditions", IEEE Trans. Robotics 28(1), 2012 (preintegration, with derivatives by the errors); between keyframes the
compass (Bowditch) rule of traverse adjustment: a misclosure is spread evenly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cellslam.sim.frames import integrate_pose, rotation, rotation_angles
from cellslam.sim.recording import Floats, Ints, OdometryModel
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.measurements.fusion import Fusion
from cellslam.slam.measurements.readings import ports_of, readings
from cellslam.slam.smoother.factor_graph import Leg, Priors, Problem, Sighting
from cellslam.slam.smoother.smoother_options import SmootherOptions

LARGEST_SHIFT_S = 1e-9
LEAST_STD = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3])  # rad, m: keeps the graph regular where a model has no noise
SMALL = 1e-5


def errors_of(model: OdometryModel) -> tuple[Ints, Ints]:
    """Return the components of the odometry that have a bias (b,), and those that have a scale error (s,)."""
    return np.flatnonzero((model.bias > 0) | (model.bias_walk_density > 0)), np.flatnonzero(model.scale > 0)


def leg(velocity: Floats, dt_s: Floats, model: OdometryModel) -> Leg:
    """Return the motion at mean body velocities (n, 6), in m/s and rad/s, over intervals (n,) in s."""
    biased, scaled = errors_of(model)
    inner = _inner(velocity, dt_s)
    columns = []
    for component in biased:
        changed = velocity.copy()
        changed[:, component] -= SMALL
        columns.append(local(inner[-1], _inner(changed, dt_s)[-1]) / SMALL)
    for component in scaled:
        changed = velocity.copy()
        changed[:, component] /= 1.0 + SMALL
        columns.append(local(inner[-1], _inner(changed, dt_s)[-1]) / SMALL)
    # White noise: each interval's error, seen from the end; its lever makes a turn a sideways step.
    variance, ends = np.zeros(6), rotation(*inner[-1, 3:])
    for pose, dt in zip(inner, dt_s, strict=True):
        arm = ends.T @ (inner[-1, :3] - pose[:3])
        turn = (model.noise_density[[5, 4, 3]] ** 2) * dt
        variance[:3] += turn
        variance[3:] += model.noise_density[:3] ** 2 * dt
        variance[3:] += np.array([turn[2] * arm[1] ** 2, turn[2] * arm[0] ** 2, turn[1] * arm[0] ** 2])
    by_error = np.array(columns).T if columns else np.zeros((6, 0))
    return Leg(inner, np.sqrt(variance + LEAST_STD**2), by_error)


def local(a: Floats, b: Floats) -> Floats:
    """Return pose b in the frame of pose a, nearby: rotation vector (small angles, rad) and translation (m), (6,).

    a, b (6,): poses in m and rad.
    """
    ra, rb = rotation(*a[3:]), rotation(*b[3:])
    turned = ra.T @ rb
    vector = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    return np.concatenate([vector, ra.T @ (b[:3] - a[:3])])


def _inner(velocity: Floats, dt_s: Floats) -> Floats:
    pose, out = np.zeros(6), np.empty((len(velocity), 6))
    for n, (u, dt) in enumerate(zip(velocity, dt_s, strict=True)):
        pose = integrate_pose(pose, u, float(dt))
        out[n] = pose
    return out


@dataclass(frozen=True)
class Drive:
    """What was seen: intervals (T,), odometry (T, 6), snapshots, VT of each measurement, filtered poses (T, 6), last
    known VTs by identity, last clock offsets (S,)."""

    setup: Setup
    dt_s: Floats
    odometry: Floats
    snapshots: Sequence[Snapshot]
    association: Sequence[Ints]
    poses: Floats
    vts: dict[int, Floats]
    offset_m: Floats


def problem_of(drive: Drive, options: SmootherOptions) -> tuple[Problem, Ints]:
    """Return the problem, and the snapshots (K,) that are keyframes."""
    setup, model = drive.setup, drive.setup.odometry_model
    frames = keyframes(drive.dt_s, options.keyframe_s)
    legs = tuple(
        leg(drive.odometry[a + 1 : b + 1], drive.dt_s[a + 1 : b + 1], model) for a, b in pairwise(frames.tolist())
    )
    biased, scaled = errors_of(model)
    time_s = np.cumsum(drive.dt_s)
    segment = (time_s[frames[:-1]] / options.bias_s).astype(np.int64)
    walk = np.concatenate([model.bias_walk_density[biased] * np.sqrt(options.bias_s), np.zeros(len(scaled))])
    fusion = Fusion(setup, options.ekf_slam)
    kept, sightings = _sightings(drive, fusion, legs, frames, options)
    link, surveyed_m, survey_std_m = fusion.setup.surveyed  # EKF-SLAM's VTs of surveyed links are called as these are
    seen = np.isin(link, [kept[sighting.vt] for sighting in sightings])
    priors = Priors(
        start=setup.start_pose, start_std=setup.start_std,
        error_std=np.maximum(np.concatenate([model.bias[biased], model.scale[scaled]]), 1e-9),
        walk_std=np.maximum(walk, 1e-9),
        offset_mean_m=setup.sites.clock_offset_mean_m, offset_std_m=setup.sites.clock_offset_std_m,
        surveyed=np.searchsorted(kept, link[seen]), surveyed_m=surveyed_m[seen], survey_std_m=survey_std_m[seen],
    )  # fmt: skip
    problem = Problem(
        priors=priors, keyframes=drive.poses[frames], offset_m=drive.offset_m,
        vts=np.array([drive.vts[v] for v in kept]).reshape(-1, 3), legs=legs, segment=segment, sightings=sightings,
    )  # fmt: skip
    return problem, frames


def keyframes(dt_s: Floats, spacing_s: float) -> Ints:
    """Return the snapshots (K,) that are keyframes: the first, the last, and one every `spacing_s`.

    dt_s (T,): since the snapshot before.
    """
    number = np.floor(np.cumsum(dt_s) / spacing_s + LARGEST_SHIFT_S)
    first = np.flatnonzero(np.diff(number, prepend=-1.0) > 0)
    return np.union1d(first, [len(dt_s) - 1]).astype(np.int64)


def between(frames6: Floats, legs: Sequence[Leg], frames: Ints) -> Floats:
    """Return every pose (T, 6) in m and rad: odometry from keyframe to keyframe, its misclosure spread evenly over the
    leg.

    frames6 (K, 6): poses of the keyframes; frames (K,): their snapshots.
    """
    out = np.empty((int(frames[-1]) + 1, 6))
    out[frames] = frames6
    for k, one in enumerate(legs):
        miss = local(_after(frames6[k], one.relative), frames6[k + 1])
        count = len(one.inner)
        for n in range(count - 1):
            share = miss * (n + 1) / count
            step = np.concatenate([share[3:], rotation_angles(rotation(*share[2::-1]))])
            out[frames[k] + 1 + n] = _after(_after(frames6[k], one.inner[n]), step)
    return out


def _after(pose: Floats, step: Floats) -> Floats:
    """Return the pose (6,) that is at `step` (6,) in the frame of `pose`."""
    r = rotation(*pose[3:])
    return np.concatenate([pose[:3] + r @ step[:3], rotation_angles(r @ rotation(*step[3:]))])


def _sightings(
    drive: Drive, fusion: Fusion[EkfSlamOptions], legs: Sequence[Leg], frames: Ints, options: SmootherOptions
) -> tuple[list[int], tuple[Sighting, ...]]:
    """Return the identities of the VTs in the graph, and all that was seen of them about each keyframe."""
    setup = fusion.setup
    ids, counts = np.unique(np.concatenate(drive.association), return_counts=True)
    often = ids[(counts >= options.vt_detections) & (ids >= 0)]
    kept = [int(v) for v in often if int(v) in drive.vts]
    place = {v: i for i, v in enumerate(kept)}
    ports = ports_of(setup.links.site, setup.links.port)
    groups: dict[tuple[int, int, int], list[tuple[Floats, Floats, Floats, Floats]]] = {}
    frame_of = np.searchsorted(frames, np.arange(len(drive.dt_s)), side="right") - 1
    for t, snapshot in enumerate(drive.snapshots):
        k = int(frame_of[t])
        inside = t - int(frames[k])
        pose = legs[k].inner[inside - 1] if inside else np.zeros(6)
        relative = np.concatenate([rotation(*pose[3:]).ravel(), pose[:3]])
        u, dt = drive.odometry[t], drive.dt_s[t]
        measurements = fusion.fuse(snapshot)
        found = readings(measurements, ports, fusion.options, u[3] * dt, u[0] * dt)
        answer = np.full(len(measurements), -1, np.int64)
        answer[measurements.of] = drive.association[t]
        for m, vt in enumerate(answer.tolist()):
            if vt in place and np.isfinite(found.z[m]).all():
                site = int(setup.links.site[measurements.link[m]])
                entry = relative, found.z[m], found.single[m], found.many[m]
                groups.setdefault((k, place[vt], site), []).append(entry)
    return kept, tuple(_sighting(*key, entries) for key, entries in groups.items())


def _sighting(keyframe: int, vt: int, site: int, entries: Sequence[tuple[Floats, Floats, Floats, Floats]]) -> Sighting:
    relative, z, single, many = (np.ascontiguousarray(column) for column in map(np.array, zip(*entries, strict=True)))
    # The mean of n counts as n updates with the variances `many`; no better than its errors allow for one draw.
    std = np.sqrt(1.0 / (1.0 / many).sum(axis=0))
    return Sighting(keyframe, vt, site, relative, z, std, np.sqrt(single.mean(axis=0)))
