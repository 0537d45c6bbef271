"""The posterior Cramer-Rao bound of a drive: what a filter that makes no mistake of association could reach.

The covariance recursion of the joint filter over pose, odometry biases and scales, clock offsets and the VTs
of every link, with all Jacobians at the truth, the true associations, the odometry's noise model and each
measurement's true covariance. It is conditional on the realised trajectory and detections (Tichavsky,
Muravchik, Nehorai, "Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE Trans. Signal
Processing 46(5), 1998, in covariance form, as the odometry noise is singular). Estimators that use the
priors, and single trials, can fall below it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.frames import mean_velocity, rotation
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, OdometryModel, Recording, Truth
from cellslam.slam.model import jacobians, predict

Flags = NDArray[np.bool_]

# A component that a VT's first measurement lacks: known this well (m, rad, rad).
BROAD_STD = np.array([1e4, 10.0, 10.0])
# Least standard deviation in noiseless recordings: relative for distances, radians for angles.
SMALLEST_STD = 1e-6


@dataclass(frozen=True)
class BoundResult:
    """Least covariances of an unbiased filter after each snapshot.

    `pose_covariance` (T, 6, 6) in metres and radians; `clock_offset_std_m` (T, S).
    """

    pose_covariance: Floats
    clock_offset_std_m: Floats

    @property
    def horizontal_std_m(self) -> Floats:
        """Bound of the horizontal position error (T,): root of the trace of the x-y covariance."""
        return np.sqrt(self.pose_covariance[:, 0, 0] + self.pose_covariance[:, 1, 1])

    @property
    def position_rmse_m(self) -> float:
        """Bound of the root mean squared horizontal error over the drive."""
        return float(np.sqrt(np.mean(self.horizontal_std_m**2)))


@dataclass(frozen=True)
class Core:
    """Where the states that all links share stand: pose (0-5), odometry biases and scales, clock offsets.

    `bias` and `scale` (6,): state index of each odometry component, -1 where this error does not exist.
    """

    bias: Ints
    scale: Ints
    offsets: Ints
    size: int


@dataclass(frozen=True)
class Tracked:
    """The measurements that carry information: of a true VT that is seen at least twice on its link.

    `rows` (T + 1,); `key` (m,): VT on a link; `first`, `last` (m,); `h` (m, 3, 9) = [dh/dpose, dh/dVT];
    `variance` (m, 3), infinite where not measured; `site` (m,).
    """

    rows: Ints
    key: Ints
    first: Flags
    last: Flags
    h: Floats
    variance: Floats
    site: Ints


def bound(recording: Recording, progress: Progress = silent) -> BoundResult:
    """Return the posterior Cramer-Rao bound of a recording with truth.

    VTs enter with a flat prior at their first detection, separately for each link. Pitch, roll and height are
    known where neither the start nor the odometry's data sheet is uncertain of them. Raises InputError
    without truth.
    """
    if recording.truth is None:
        raise InputError(
            "the recording has no truth: the bound needs the true trajectory, VTs and measurement noise"
        )
    from cellslam.benchmarks.bound_kernel import covariance_recursion

    truth, snapshots, sites = recording.truth, len(recording.time_s), len(recording.sites)
    core = core_of(recording.odometry_model, sites)
    motion, noise, walk = linear_motion(recording, truth, core)
    tracked = tracked_measurements(recording, truth)
    keys = int(tracked.key.max()) + 1 if len(tracked.key) else 0
    alive = np.cumsum(tracked.first) - np.cumsum(tracked.last) + tracked.last
    slots = int(alive.max()) if len(alive) else 0
    size = core.size + 3 * slots
    pose, offset = np.zeros((snapshots, 6, 6)), np.zeros((snapshots, sites))
    with progress("Cramer-Rao bound", snapshots) as advance:
        covariance_recursion(
            np.zeros((size, size)), start_variance(recording, core), core.size, motion, noise, walk,
            tracked.rows, tracked.key, tracked.first, tracked.last, tracked.h, tracked.variance,
            core.offsets[tracked.site], np.zeros(keys, np.int64), np.zeros(slots, np.int64), pose, offset,
        )  # fmt: skip
        advance(snapshots)
    return BoundResult(pose, np.sqrt(np.maximum(offset, 0.0)))


def core_of(model: OdometryModel, sites: int) -> Core:
    """Return the layout of the shared states: only odometry errors that the data sheet has become states."""
    bias, scale = np.full(6, -1, np.int64), np.full(6, -1, np.int64)
    biased = np.flatnonzero((model.bias > 0) | (model.bias_walk_density > 0))
    bias[biased] = 6 + np.arange(len(biased))
    scaled = np.flatnonzero(model.scale > 0)
    scale[scaled] = 6 + len(biased) + np.arange(len(scaled))
    first = 6 + len(biased) + len(scaled)
    return Core(bias, scale, first + np.arange(sites), first + sites)


def start_variance(recording: Recording, core: Core) -> Floats:
    """Return the prior variances (core,) at the first snapshot."""
    model = recording.odometry_model
    variance = np.zeros(core.size)
    variance[:6] = recording.start_std**2
    variance[core.bias[core.bias >= 0]] = model.bias[core.bias >= 0] ** 2
    variance[core.scale[core.scale >= 0]] = model.scale[core.scale >= 0] ** 2
    variance[core.offsets] = recording.sites.clock_offset_std_m**2
    return variance


def linear_motion(recording: Recording, truth: Truth, core: Core) -> tuple[Floats, Floats, Floats]:
    """Return the pose's transition (T, 6, core), its noise (T, 6, 6) and the core's walk variances (T, core).

    Row t leads from snapshot t - 1 to t; row 0 is not used. Linearised `frames.integrate_pose` at the truth,
    with true velocity = (measured - bias - white) / (1 + scale).
    """
    count, model = len(recording.time_s), recording.odometry_model
    motion, noise = np.zeros((count, 6, core.size)), np.zeros((count, 6, 6))
    walk = np.zeros((count, core.size))
    if count < 2:
        return motion, noise, walk
    dt = np.diff(recording.time_s)
    velocity = mean_velocity(truth.poses[:-1], truth.poses[1:], dt)
    by_pose, by_velocity = pose_jacobians(truth.poses[:-1], velocity, dt)
    by_velocity = by_velocity / (1.0 + truth.odometry_scale)
    motion[1:, :, :6] = by_pose
    for component in range(6):
        if core.bias[component] >= 0:
            motion[1:, :, core.bias[component]] = -by_velocity[:, :, component]
            walk[1:, core.bias[component]] = model.bias_walk_density[component] ** 2 * dt
        if core.scale[component] >= 0:
            motion[1:, :, core.scale[component]] = (
                -by_velocity[:, :, component] * velocity[:, component, None]
            )
    white = model.noise_density**2 / dt[:, None]
    noise[1:] = np.einsum("tac,tc,tbc->tab", by_velocity, white, by_velocity)
    return motion, noise, walk


def pose_jacobians(pose: Floats, velocity: Floats, dt_s: Floats) -> tuple[Floats, Floats]:
    """Return d(pose')/d(pose) and d(pose')/d(velocity), each (n, 6, 6), of `frames.integrate_pose`.

    At poses and velocities (n, 6) and intervals (n,).
    """
    middle = pose[:, 3:] + 0.5 * velocity[:, 3:] * dt_s[:, None]
    r = rotation(middle[:, 0], middle[:, 1], middle[:, 2])
    moved = np.einsum("nij,nj->ni", r, velocity[:, :3]) * dt_s[:, None]
    zero = np.zeros(len(pose))
    # An angle turns the vector about its axis: yaw about z, pitch about the yawed y, roll about the body's x.
    axes = np.stack(
        [np.stack([zero, zero, zero + 1.0], -1), rotation(middle[:, 0], zero, zero)[:, :, 1], r[:, :, 0]], 1
    )
    turned = np.swapaxes(np.cross(axes, moved[:, None, :]), 1, 2)
    by_pose, by_velocity = np.tile(np.eye(6), (len(pose), 1, 1)), np.zeros((len(pose), 6, 6))
    by_pose[:, :3, 3:] = turned
    by_velocity[:, :3, :3] = r * dt_s[:, None, None]
    by_velocity[:, :3, 3:] = turned * 0.5 * dt_s[:, None, None]
    by_velocity[:, 3:, 3:] = np.eye(3) * dt_s[:, None, None]
    return by_pose, by_velocity


def tracked_measurements(recording: Recording, truth: Truth) -> Tracked:
    """Return the measurements that carry information, with their Jacobians and variances at the truth."""
    m = recording.measurements
    real = np.flatnonzero(truth.measurement_vt >= 0)
    pose, vt = truth.poses[m.snapshot[real]], truth.vts.position_m[truth.measurement_vt[real]]
    with np.errstate(divide="ignore", invalid="ignore"):
        by_vt, by_pose = jacobians(pose, vt)
    h = np.concatenate([by_pose, by_vt], axis=-1)
    pair = m.link[real] * max(len(truth.vts), 1) + truth.measurement_vt[real]
    regular = np.isfinite(h).all(axis=(1, 2))
    _, inverse, count = np.unique(np.where(regular, pair, -1), return_inverse=True, return_counts=True)
    keep = regular & (count[inverse] > 1)
    real, h, pose, vt = real[keep], h[keep], pose[keep], vt[keep]
    _, first_row, key = np.unique(pair[keep], return_index=True, return_inverse=True)
    _, last_row = np.unique(pair[keep][::-1], return_index=True)
    first, last = np.zeros(len(real), np.bool_), np.zeros(len(real), np.bool_)
    first[first_row], last[len(real) - 1 - last_row] = True, True
    return Tracked(
        rows=np.searchsorted(m.snapshot[real], np.arange(len(recording.time_s) + 1)).astype(np.int64),
        key=key.astype(np.int64),
        first=first,
        last=last,
        h=h,
        variance=_variance(recording, truth, real, predict(pose, vt)[:, 0], first),
        site=recording.links.site[m.link[real]],
    )


def _variance(recording: Recording, truth: Truth, rows: Ints, distance_m: Floats, first: Flags) -> Floats:
    """Return the variances (n, 3) of measurements `rows` (n,); infinite: not measured."""
    m = recording.measurements
    measured = np.stack([m.distance_m[rows], m.azimuth_rad[rows], m.elevation_rad[rows]], axis=1)
    std = truth.measurement_std[rows]
    smallest = SMALLEST_STD * np.stack([distance_m, np.ones(len(rows)), np.ones(len(rows))], axis=1)
    there = np.isfinite(measured) & np.isfinite(std)
    missing = np.where(first[:, None], BROAD_STD, np.inf)
    return np.where(there, np.maximum(std, smallest), missing) ** 2
