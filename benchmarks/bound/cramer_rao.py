"""The posterior Cramér-Rao bound of a drive: what a filter that makes no mistake of association could reach.

The covariance recursion of the joint filter over pose, odometry biases and scales, clock offsets, the VTs of every site
and the measurement errors that persist, with all Jacobians at the truth, the true associations, the odometry's noise
model and each measurement's true covariance. It is conditional on the realised trajectory and detections. Estimators
that use the priors, and single trials, can fall below it.

State x = [pose r, odometry biases and scales, clock rates and offsets b, VTs v, errors that persist e] with covariance
P (`Joint`). m is the error of the mean, estimate less truth, of the filter that has this covariance on this drive: jump
and residual are what was really drawn of the odometry's and the measurements' errors, and m does not change the bound.

    prediction   P <- F P F^T + Q,  m <- F m + jump                                            `linear_model.motion_of`
                 e <- a e + sqrt(1 - a^2) noise, a = exp(-step / (AREA l)), l: correlation     `predict`
                 which with e = s e', s <- a s leaves P as it is, but for (1 - a^2) / s^2 on its diagonal
    entering     an error that persists begins with variance 1
    measurement  z = h(r, v) + b + load e + white: H, R            `linear_model.tracked_measurements`
      prior      v of a surveyed transmitter, and of a scatterer, is there from the start   `linear_model.prior_of`
      birth      first of another VT: v = H_v^-1 (z - H_r r - b - load e), from a flat prior         `give_births`
      update     S = H P H^T + R = L L^T,  G = L^-1 H P,  P <- P - G^T G
                 m <- m + G^T L^-1 (residual - H m)                                            `update`
    leaving      rows and columns of what is not met again are left out, which is exact        `Joint.keep`
    bound        pose_covariance = P_rr after each snapshot; horizontal: sqrt(P_xx + P_yy)
    map          of a VT: sqrt(trace P_vv)                                                        `_map_bound`

Source: Tichavsky, Muravchik and Nehorai, "Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE
Trans. Signal Processing 46(5), 1998, in covariance form, as the odometry noise is singular.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from threadpoolctl import threadpool_limits

from cellslam.benchmarks.bound import DETECTIONS_OF_A_TRUE_VT
from cellslam.benchmarks.bound.linear_model import NEVER, Core, Drive, linear_model
from cellslam.benchmarks.bound.recursion_kernel import Components, keep, predict, times, update
from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.lte.persisting_errors import Cause
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, Recording

EVERY = 10  # snapshots from one value of the map's bound to the next
IDLE = 0.03  # share of states that nothing meets any more, from which on they are taken out: to copy P takes time


@dataclass(frozen=True, repr=False)
class MapBound(Described):
    """Bound of the V true VTs at the end of a drive: `std_m` (V,), root of the trace of the position's covariance, NaN
    of VTs that were not seen; `error` (V, 3), estimate less truth in m of the filter that is linear about the truth.

    `times_seen` (V,): in how many snapshots each was seen. `over_time_m` (T,): root mean square of the bound over the
    VTs that have been seen at least `DETECTIONS_OF_A_TRUE_VT` times by then, NaN before there is one.
    """

    std_m: Floats
    error: Floats
    times_seen: Ints
    over_time_m: Floats


@dataclass(frozen=True, repr=False)
class BoundResult(Described):
    """Least covariances of an unbiased filter after each snapshot.

    `pose_covariance` (T, 6, 6) in metres and radians; `clock_offset_std_m` (T, S); `pose_error` (T, 6): estimate less
    truth, on this drive, of the filter that is linear about the truth and has these covariances (`linear_model`).
    `merged_m`: the bound of the drive's horizontal error with what merging does as an error that persists, None where
    few measurements are merged (`merged_paths`). `map`: the bound of the VTs.
    """

    pose_covariance: Floats
    clock_offset_std_m: Floats
    pose_error: Floats
    merged_m: float | None = None
    map: MapBound | None = None

    @property
    def horizontal_std_m(self) -> Floats:
        """Bound of the horizontal position error (T,) in m: root of the trace of the x-y covariance."""
        return np.sqrt(self.pose_covariance[:, 0, 0] + self.pose_covariance[:, 1, 1])

    @property
    def position_rmse_m(self) -> float:
        """Bound of the root mean squared horizontal error over the drive."""
        return float(np.sqrt(np.mean(self.horizontal_std_m**2)))


class Joint:
    """What is known of the `n` states that are there, of K: the first n rows, and columns, of the covariance `P` and of
    the error `m` of the mean, of the states divided by their `scale`, which is 1 for states that do not fade.

    Arrays have capacity for more. `states`: the numbers of those that are there; `index` (K,): the row of each of all
    K states, -1: it is not there.
    """

    def __init__(self, every: int) -> None:
        self.n, self.index = 0, np.full(every, -1)
        self.P: Floats = np.empty((0, 0))
        self.m: Floats = np.empty(0)
        self.scale: Floats = np.empty(0)
        self.states: Ints = np.empty(0, np.int64)

    @property
    def there(self) -> Ints:
        """The numbers of the states (n,) that are there."""
        return self.states[: self.n]

    def add(self, states: Ints, m: Floats, P: Floats, P_old: Floats | float = 0.0) -> None:
        """Add k states, of errors m (k,), covariance P (k, k) and covariances P_old (k, n) with those there."""
        n, size = self.n, self.n + len(states)
        if size > len(self.m):
            self._grow(2 * size + 1)  # odd: rows a multiple of 4096 bytes apart would evict one another from the cache
        self.P[n:size, n:size], self.P[n:size, :n], self.P[:n, n:size] = P, P_old, np.transpose(P_old)
        self.m[n:size], self.scale[n:size], self.states[n:size] = m, 1.0, states
        self.n, self.index[states] = size, np.arange(n, size)

    def keep(self, kept: Ints) -> None:
        """Leave only the states of the rows `kept` (k,), which ascend."""
        self.index[self.there] = -1
        keep(self.P, self.m, self.scale, self.states, kept)
        self.n = len(kept)
        self.index[self.there] = np.arange(self.n)

    def _grow(self, size: int) -> None:
        more = size - len(self.m)
        self.P, self.states = np.pad(self.P, (0, more)), np.pad(self.states, (0, more))
        self.m, self.scale = np.pad(self.m, (0, more)), np.pad(self.scale, (0, more))


def bound(
    recording: Recording, progress: Progress = silent, calibrated: bool = False, merging: Cause | None = None
) -> BoundResult:
    """Return the posterior Cramér-Rao bound of a recording with truth.

    VTs enter with a flat prior at their first detection, one for all links of a site; transmitters that were surveyed
    are there from the start, as uncertain as the survey. Errors that persist are states too, where
    `truth.persisting_std` is there. Pitch, roll and height are known where neither the start nor the odometry's data
    sheet is uncertain of them. `calibrated`: the array's calibration is known. `merging`: an error more of each VT,
    which lasts for a time (`merged_paths`). Raises InputError without truth.
    """
    if recording.truth is None:
        raise InputError("the recording has no truth: the bound needs the true trajectory, VTs and measurement noise")
    # The matrices are small: threads of BLAS would wait for one another more than they work.
    with threadpool_limits(1):
        return recursion(*linear_model(recording, calibrated, merging), progress=progress)[0]


def recursion(
    core: Core, drive: Drive, known: Joint | None = None, progress: Progress = silent
) -> tuple[BoundResult, Joint]:
    """Return the bound of a drive that begins with a `known` map, and the map that it leaves: VTs that stay."""
    motion, states, prior, count = drive.motion, drive.states, drive.prior, len(drive.motion.jump)
    pose, offset, error = np.zeros((count, 6, 6)), np.zeros((count, len(core.offsets))), np.zeros((count, 6))
    times_seen, over_time = _times_seen(drive, core), np.full(count, np.nan)
    joint, step = Joint(len(states.last)), Steps.of(drive)
    joint.add(np.arange(core.size), motion.jump[0], np.diag(motion.start))
    if known is not None:
        joint.add(known.there, known.m[: known.n], known.P[: known.n, : known.n])
    new = joint.index[prior.state] < 0  # a known map has it in
    joint.add(prior.state[new], prior.error[new], np.diag(prior.variance[new]))
    with progress("Cramér-Rao bound", count) as advance:
        for t in range(count):
            if t > 0:
                a = states.decay[t, states.kind[joint.there]]
                predict(joint.P, joint.m, joint.scale, motion.F[t], motion.Q[t], motion.jump[t], a)
            step.measure(joint, t)
            pose[t], error[t] = joint.P[:6, :6], joint.m[:6]
            offset[t] = joint.P[core.offsets, core.offsets]
            over_time[t] = (
                _rms(_map_bound(joint, drive, core)[0][times_seen[t] >= DETECTIONS_OF_A_TRUE_VT])
                if t % EVERY == 0
                else over_time[t - 1]
            )
            last = states.last[joint.there]
            stays = (last == NEVER) | (last > t)
            if stays.mean() < 1.0 - IDLE:
                joint.keep(np.flatnonzero(stays))
            advance(1)
    of_map = MapBound(*_map_bound(joint, drive, core), times_seen[-1], over_time)
    there = joint.there
    joint.keep(np.flatnonzero((there >= core.size) & (states.last[there] == NEVER)))
    return BoundResult(pose, np.sqrt(np.maximum(offset, 0.0)), error, map=of_map), joint


def _map_bound(joint: Joint, drive: Drive, core: Core) -> tuple[Floats, Floats]:
    """Return the bounds (V,) in m of the true VTs, NaN of those that are not there, and the errors (V, 3) of the mean;
    VTs do not fade, so that their scale is 1."""
    at = joint.index[core.size + 3 * drive.vts[:, None] + np.arange(3)]
    there = at >= 0
    variance = np.where(there, joint.P[at, at], np.nan).sum(axis=1)
    return np.sqrt(variance), np.where(there, joint.m[at], np.nan)


def _times_seen(drive: Drive, core: Core) -> Ints:
    """Return in how many snapshots (T, V) each true VT has been seen by the end of each."""
    s, vt = drive.sightings, (drive.views.state[:, 0, 0] - core.size) // 3
    snapshot = np.zeros(len(vt), np.int64)
    snapshot[s.view_of] = np.repeat(np.arange(len(s.rows) - 1), np.diff(s.rows))
    seen = np.zeros((len(s.rows) - 1, int(max(drive.vts.max(initial=-1), vt.max(initial=-1))) + 1), np.int32)
    seen[snapshot, vt] = 1
    return np.asarray(seen.cumsum(axis=0)[:, drive.vts], np.int64)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


class Steps(NamedTuple):
    """What the snapshots of a drive add: births of VTs, components that are measured, and errors that persist, those of
    snapshot t being new[begin[t]:begin[t + 1]]."""

    drive: Drive
    births: Components
    measured: Components
    new: Ints
    begin: Ints

    @classmethod
    def of(cls, drive: Drive) -> Steps:
        """Return the steps of a drive."""
        s, first = drive.sightings, drive.states.first
        born, new = np.repeat(s.first[:, None], 3, axis=1), np.argsort(first, kind="stable")
        begin = np.searchsorted(first[new], np.arange(len(s.rows)))
        return cls(drive, s.components(born), s.components(np.isfinite(s.variance) & ~born), new, begin)

    def measure(self, joint: Joint, t: int) -> None:
        """Bring the states to what they are after the measurements of snapshot t."""
        if (new := self.new[self.begin[t] : self.begin[t + 1]]).size:
            joint.add(new, np.zeros(len(new)), np.eye(len(new)))
        if self.births.begin[t] < self.births.begin[t + 1]:
            self.give_births(joint, t)
        if self.measured.begin[t] < self.measured.begin[t + 1]:
            update(joint.P, joint.m, joint.n, self.measured, t, self.drive.views.rows, joint.index, joint.scale)

    def give_births(self, joint: Joint, t: int) -> None:
        """Add the VTs that are seen for the first time, each known from one measurement alone: the limit of a broad
        prior. v = D (z - H x) with D the inverse of H_v; the other states learn nothing."""
        H, s, n = self.births, self.drive.sightings, joint.n
        own, rows = slice(H.begin[t], H.begin[t + 1]), np.flatnonzero(s.first[s.rows[t] : s.rows[t + 1]]) + s.rows[t]
        of_state = H, t, self.drive.views.rows, joint.index, joint.scale
        D = block_diag(*np.linalg.inv(self.drive.views.by_vt[s.view_of[rows]]))
        HP = times(*of_state, joint.P, n)
        P_v = D @ (times(*of_state, HP.T.copy(), len(HP)) + np.diag(H.std[own] ** 2)) @ D.T
        v = (s.vt[rows, None] + np.arange(3)).ravel()
        joint.add(v, D @ (H.residual[own] - times(*of_state, joint.m[:, None], 1)[:, 0]), P_v, -D @ HP)
