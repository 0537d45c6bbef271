"""The posterior Cramer-Rao bound of a drive: what a filter that makes no mistake of association could reach.

The covariance recursion of the joint filter over pose, odometry biases and scales, clock offsets, the VTs of every site
and the measurement errors that persist, with all Jacobians at the truth, the true associations, the odometry's noise
model and each measurement's true covariance. It is conditional on the realised trajectory and detections. Estimators
that use the priors, and single trials, can fall below it.

State x = [pose r, odometry biases and scales, clock rates and offsets b, VTs v, errors that persist e], covariance P:

    prediction   P <- F (P + W) F^T + Q                                                      `states_kernel.predict`
                 F: the pose's Jacobian, W: walks, Q = G diag(density^2 / dt) G^T            `linear_motion`
                 e <- a e + sqrt(1 - a^2) noise, a = exp(-step / (AREA l)), l: correlation   `states_kernel.decay`
    measurement  z = h(r, v) + b + load e + white, one component after the other             `tracked_measurements`
      birth      first of a VT: v = H_v^-1 (z - H_r r - b - load e), from a flat prior       `recursion_kernel._birth`
      update     s = H P H^T + R,  g = P H^T s^-1/2,  P <- P - g g^T                         `recursion_kernel._update`
    leaving      rows and columns of what is not met again are left out                      `states_kernel.leave`
    bound        pose_covariance = P_rr after each snapshot; horizontal: sqrt(P_xx + P_yy)

Source: Tichavsky, Muravchik and Nehorai, "Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE
Trans. Signal Processing 46(5), 1998, in covariance form, as the odometry noise is singular.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from cellslam.benchmarks.bound.bound_model import Core, Errors, Found, Motion, Sightings, Views, room
from cellslam.benchmarks.bound.drawn_errors import jumps, residuals
from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.frames import mean_velocity, rotation
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, OdometryModel, Recording, Sites, Truth
from cellslam.slam.model.measurement_model import jacobians, predict

if TYPE_CHECKING:
    from cellslam.sim.lte.persisting_errors import Cause

# Snapshots from one step of the progress bar to the next.
BLOCK = 100
# A component that a VT's first measurement lacks: known this well (m, rad, rad).
BROAD_STD = np.array([1e4, 10.0, 10.0])
# How little is known of a clock's offset after a step, m.
STEP_STD_M = 1e3
# Least standard deviation in noiseless recordings: relative for distances, radians for angles.
SMALLEST_STD = 1e-6


@dataclass(frozen=True, repr=False)
class BoundResult(Described):
    """Least covariances of an unbiased filter after each snapshot.

    `pose_covariance` (T, 6, 6) in metres and radians; `clock_offset_std_m` (T, S); `pose_error` (T, 6): estimate less
    truth, on this drive, of the filter that is linear about the truth and has these covariances (`drawn_errors`).
    `merged_m`: the bound of the drive's horizontal error with what merging does as an error that persists, None where
    few measurements are merged (`merged_paths`).
    """

    pose_covariance: Floats
    clock_offset_std_m: Floats
    pose_error: Floats
    merged_m: float | None = None

    @property
    def horizontal_std_m(self) -> Floats:
        """Bound of the horizontal position error (T,) in m: root of the trace of the x-y covariance."""
        return np.sqrt(self.pose_covariance[:, 0, 0] + self.pose_covariance[:, 1, 1])

    @property
    def position_rmse_m(self) -> float:
        """Bound of the root mean squared horizontal error over the drive."""
        return float(np.sqrt(np.mean(self.horizontal_std_m**2)))


def bound(
    recording: Recording, progress: Progress = silent, calibrated: bool = False, merging: Cause | None = None
) -> BoundResult:
    """Return the posterior Cramer-Rao bound of a recording with truth.

    VTs enter with a flat prior at their first detection, one for all links of a site. Errors that persist are states
    too, where `truth.persisting_std` is there. Pitch, roll and height are known where neither the start nor the
    odometry's data sheet is uncertain of them. `calibrated`: the array's calibration is known. `merging`: an error more
    of each VT, which lasts for a time (`merged_paths`). Raises InputError without truth.
    """
    if recording.truth is None:
        raise InputError("the recording has no truth: the bound needs the true trajectory, VTs and measurement noise")
    from cellslam.benchmarks.bound.persisting_states import rates_among
    from cellslam.benchmarks.bound.recursion_kernel import covariance_recursion

    truth, snapshots, sites = recording.truth, len(recording.time_s), len(recording.sites)
    core = core_of(recording.odometry_model, recording.sites)
    motion = motion_of(recording, truth, core)
    with threadpool_limits(1):  # the matrices are small: threads of BLAS would wait for one another more than they work
        views, sightings, errors = tracked_measurements(recording, truth, core, calibrated, merging)
    drifted = drifted_std(recording)
    drift = rates_among(errors, drifted)
    work = room(core.size, most_states(views, sightings, errors, snapshots), views, sightings, errors)
    found = Found(np.zeros((snapshots, 6, 6)), np.zeros((snapshots, sites)), np.zeros((snapshots, 6)))
    model = work, motion, views, sightings, errors
    if not covariance_recursion.signatures:  # type: ignore[attr-defined]
        with progress("compiling Cramer-Rao bound, once per machine", 1) as advance:
            covariance_recursion(*model, 0, 0, core.size, drift, drifted, found)
            advance(1)
    with progress("Cramer-Rao bound", snapshots) as advance:
        states = core.size
        for begin in range(0, snapshots, BLOCK):
            end = min(begin + BLOCK, snapshots)
            states = covariance_recursion(*model, begin, end, states, drift, drifted, found)
            advance(end - begin)
    return BoundResult(found.pose, np.sqrt(np.maximum(found.offset, 0.0)), found.error)


def core_of(model: OdometryModel, sites: Sites) -> Core:
    """Return the layout of the shared states: only errors that the data sheets have become states."""
    bias, scale = np.full(6, -1, np.int64), np.full(6, -1, np.int64)
    biased = np.flatnonzero((model.bias > 0) | (model.bias_walk_density > 0))
    bias[biased] = 6 + np.arange(len(biased))
    scaled = np.flatnonzero(model.scale > 0)
    scale[scaled] = 6 + len(biased) + np.arange(len(scaled))
    walks = sites.walk_densities[1] > 0.0
    first = 6 + len(biased) + len(scaled)
    rate = np.where(walks, first + np.cumsum(walks) - 1, -1).astype(np.int64)
    mean = first + int(walks.sum())
    offsets = mean + 1 + np.arange(len(sites))
    return Core(bias=bias, scale=scale, rate=rate, mean=mean, offsets=offsets, size=mean + 1 + len(sites))


def motion_of(recording: Recording, truth: Truth, core: Core) -> Motion:
    """Return the drive's motion about the truth, with what was drawn of its errors; units as in `Motion`."""
    step, noise, walk = linear_motion(recording, truth, core)
    drawn, dt_s = jumps(recording, truth, core, step), np.diff(recording.time_s, prepend=recording.time_s[0])
    return Motion(
        start=start_variance(recording, core), step=step, noise=noise, walk=walk, jump=drawn, mean=core.mean,
        rate=core.rate, dt_s=dt_s,
    )  # fmt: skip


def start_variance(recording: Recording, core: Core) -> Floats:
    """Return the prior variances (core,) at the first snapshot, in the squared units of the states."""
    model = recording.odometry_model
    variance = np.zeros(core.size)
    variance[:6] = recording.start_std**2
    variance[core.bias[core.bias >= 0]] = model.bias[core.bias >= 0] ** 2
    variance[core.scale[core.scale >= 0]] = model.scale[core.scale >= 0] ** 2
    variance[core.offsets] = recording.sites.clock_offset_std_m**2
    return variance


def linear_motion(recording: Recording, truth: Truth, core: Core) -> tuple[Floats, Floats, Floats]:
    """Return the pose's transition F (T, 6, core), its noise Q (T, 6, 6) and the core's walk variances W (T, core).

    Row t leads from snapshot t - 1 to t; row 0 is not used. Linearised `frames.integrate_pose` at the truth, with true
    velocity = (measured - bias - white) / (1 + scale). Units: those of the states (m, rad, m/s, rad/s).
    """
    count, model = len(recording.time_s), recording.odometry_model
    F, Q, W = np.zeros((count, 6, core.size)), np.zeros((count, 6, 6)), np.zeros((count, core.size))
    if count < 2:
        return F, Q, W
    dt = np.diff(recording.time_s)
    W[1:] = clock_walk(recording, truth, core)[1:]
    velocity = mean_velocity(truth.poses[:-1], truth.poses[1:], dt)
    F[1:, :, :6], G = pose_jacobians(truth.poses[:-1], velocity, dt)
    G = G / (1.0 + truth.odometry_scale)
    for component in range(6):
        if core.bias[component] >= 0:
            F[1:, :, core.bias[component]] = -G[:, :, component]
            W[1:, core.bias[component]] = model.bias_walk_density[component] ** 2 * dt
        if core.scale[component] >= 0:
            F[1:, :, core.scale[component]] = -G[:, :, component] * velocity[:, component, None]
    white = model.noise_density**2 / dt[:, None]
    Q[1:] = np.einsum("tac,tc,tbc->tab", G, white, G)
    return F, Q, W


def clock_walk(recording: Recording, truth: Truth, core: Core) -> Floats:
    """Return the variances (T, core), in m^2 and (m/s)^2, that clock offsets and rates gain: by their walks, and where
    a clock steps, at a known time, by a step of which nothing is known."""
    out, dt = np.zeros((len(recording.time_s), core.size)), np.diff(recording.time_s, prepend=recording.time_s[0])
    walk, rate_walk = recording.sites.walk_densities
    out[:, core.offsets] = np.outer(dt, walk**2) + np.outer(dt**3 / 3.0, rate_walk**2)
    out[:, core.rate[core.rate >= 0]] = np.outer(dt, rate_walk[core.rate >= 0] ** 2)
    steps = truth.clock_steps
    if steps is not None:
        np.add.at(out, (np.searchsorted(recording.elapsed_s, steps.time_s), core.offsets[steps.site]), STEP_STD_M**2)
    return out


def pose_jacobians(pose: Floats, velocity: Floats, dt_s: Floats) -> tuple[Floats, Floats]:
    """Return d(pose')/d(pose) and d(pose')/d(velocity), each (n, 6, 6), of `frames.integrate_pose`.

    At poses (n, 6) in m and rad, body velocities (n, 6) in m/s and rad/s and intervals (n,) in s.
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


def drifted_std(recording: Recording) -> Floats:
    """Return how far each clock may have drifted since the first snapshot, one deviation (T, S) in m."""
    return np.asarray(np.multiply.outer(recording.elapsed_s, recording.sites.drift_std_m_s))


def tracked_measurements(
    recording: Recording, truth: Truth, core: Core, calibrated: bool = False, merging: Cause | None = None
) -> tuple[Views, Sightings, Errors]:
    """Return the measurements of true VTs.

    With their Jacobians and variances at the truth, and the errors that persist, rates of clocks among them. The ports
    and sectors of a site stand at one place and see the same VTs. Sectors on one port differ by white noise alone: what
    they measure of a VT in a snapshot is one measurement of their joint variance, exactly.
    """
    from cellslam.benchmarks.bound.persisting_states import Seen, persisting_errors, with_drift

    m, vts = recording.measurements, max(len(truth.vts), 1)
    real = np.flatnonzero(truth.measurement_vt >= 0)
    pose, vt = truth.poses[m.snapshot[real]], truth.vts.position_m[truth.measurement_vt[real]]
    with np.errstate(divide="ignore", invalid="ignore"):
        real = real[np.isfinite(np.concatenate(jacobians(pose, vt), axis=-1)).all(axis=(1, 2))]
    port, view = recording.links.port[m.link[real]], m.snapshot[real] * vts + truth.measurement_vt[real]
    _, at, of = np.unique(view * (port.max(initial=0) + 1) + port, return_index=True, return_inverse=True)
    snapshot, vt_of, port = m.snapshot[real[at]], truth.measurement_vt[real[at]], port[at]
    _, first_row, nth = np.unique(vt_of, return_index=True, return_inverse=True)
    _, last_row = np.unique(vt_of[::-1], return_index=True)
    rows = np.arange(len(at))
    first, last = rows == first_row[nth], rows == len(at) - 1 - last_row[nth]

    _, begin, view = np.unique(snapshot * vts + vt_of, return_index=True, return_inverse=True)
    position = truth.vts.position_m[vt_of[begin]]
    by_vt, by_pose = jacobians(truth.poses[snapshot[begin]], position)
    distance_m, azimuth_rad, elevation_rad = predict(truth.poses[snapshot[begin]], position).T
    seen = Seen(snapshot[begin], azimuth_rad, elevation_rad, view, vt_of, port)
    site = recording.links.site[m.link[real[at[begin]]]]
    persisting = persisting_errors(recording, seen, calibrated, merging)
    persisting = with_drift(persisting, drifted_std(recording), seen, site)
    every = np.arange(len(recording.time_s) + 1)
    views = Views(
        rows=np.searchsorted(snapshot[begin], every), by_pose=by_pose, by_vt=by_vt, offset=core.offsets[site],
        state=persisting.state, load=persisting.load,
    )  # fmt: skip
    at_view = view[of]
    white = _white_variance(recording, truth, real, distance_m[at_view], persisting.variance)
    predicted = np.stack([distance_m, azimuth_rad, elevation_rad], axis=1)[at_view]
    variance, residual = _together(white, residuals(recording, truth, real, predicted), of, len(at))
    missing = np.where(first[:, None], BROAD_STD**2, np.inf)
    sightings = Sightings(
        rows=np.searchsorted(snapshot, every), view_of=view, key=vt_of, first=first, last=last,
        variance=np.where(np.isfinite(variance), variance, missing), residual=residual, state=persisting.own_state,
        load=persisting.own_load,
    )  # fmt: skip
    return views, sightings, persisting.errors


def most_states(views: Views, sightings: Sightings, errors: Errors, snapshots: int) -> int:
    """Return the most states beside the core that the recursion holds at once."""
    enter = np.full(len(errors.last), snapshots)
    at = np.repeat(np.arange(snapshots), np.diff(views.rows))
    _first(enter, views.state, at)
    seen_at = np.repeat(np.arange(snapshots), np.diff(sightings.rows))
    _first(enter, sightings.state, seen_at)
    used = enter < snapshots
    change = np.bincount(enter[used], minlength=snapshots + 1)
    change -= np.bincount(errors.last[used] + 1, minlength=snapshots + 1)
    change += 3 * np.bincount(seen_at[sightings.first], minlength=snapshots + 1)
    change -= 3 * np.bincount(seen_at[sightings.last] + 1, minlength=snapshots + 1)
    return int(np.cumsum(change).max())


def _first(enter: Ints, state: Ints, at: Ints) -> None:
    there = state >= 0
    rows = np.broadcast_to(at.reshape(-1, *[1] * (state.ndim - 1)), state.shape)
    np.minimum.at(enter, state[there], rows[there])


def _white_variance(recording: Recording, truth: Truth, rows: Ints, distance_m: Floats, persisting: Floats) -> Floats:
    """Return the variances (n, 3) of the white errors of measurements `rows` (n,); infinite: not measured."""
    m = recording.measurements
    measured = np.stack([m.distance_m[rows], m.azimuth_rad[rows], m.elevation_rad[rows]], axis=1)
    variance = truth.measurement_std[rows] ** 2 - persisting
    smallest = SMALLEST_STD * np.stack([distance_m, np.ones(len(rows)), np.ones(len(rows))], axis=1)
    there = np.isfinite(measured) & np.isfinite(variance)
    return np.where(there, np.maximum(variance, smallest**2), np.inf)


def _together(variance: Floats, residual: Floats, of: Ints, count: int) -> tuple[Floats, Floats]:
    """Return variance and residual (count, 3) of what independent measurements, (n, 3) in groups `of` (n,), tell
    together."""
    with np.errstate(divide="ignore"):
        weight = 1.0 / variance
        information, weighted = (
            np.stack([np.bincount(of, column, count) for column in x.T], axis=1) for x in (weight, weight * residual)
        )
        return 1.0 / information, weighted / np.where(information > 0.0, information, 1.0)
