"""The posterior Cramer-Rao bound of a drive: what a filter that makes no mistake of association could reach.

The covariance recursion of the joint filter over pose, odometry biases and scales, clock offsets, the VTs of every site
and the measurement errors that persist, with all Jacobians at the truth, the true associations, the odometry's noise
model and each measurement's true covariance. It is conditional on the realised trajectory and detections. Estimators
that use the priors, and single trials, can fall below it.

State x = [pose r, odometry biases and scales, clock rates and offsets b, VTs v, errors that persist e], covariance P,
and m, the error of the mean of the filter that has this covariance:

    prediction   P <- F P F^T + Q,  m <- F m + jump                                            `linear_model.motion_of`
                 e <- a e + sqrt(1 - a^2) noise, a = exp(-step / (AREA l)), l: correlation     `_predict`
                 which with e = s e', s <- a s leaves P as it is, but for (1 - a^2) / s^2 on its diagonal
    entering     an error that persists begins with variance 1
    measurement  z = h(r, v) + b + load e + white: H, R            `linear_model.tracked_measurements`
      survey     v of a surveyed transmitter is there from the start   `linear_model.survey_of`
      birth      first of another VT: v = H_v^-1 (z - H_r r - b - load e), from a flat prior         `_give_births`
      update     S = H P H^T + R = L L^T,  G = L^-1 H P,  P <- P - G^T G
                 m <- m + G^T L^-1 (residual - H m)                                            `_update`
    leaving      rows and columns of what is not met again are left out, which is exact        `Joint.only`
    bound        pose_covariance = P_rr after each snapshot; horizontal: sqrt(P_xx + P_yy)
    map          of a VT: sqrt(trace P_vv)                                                        `_map_bound`

Source: Tichavsky, Muravchik and Nehorai, "Posterior Cramer-Rao bounds for discrete-time nonlinear filtering", IEEE
Trans. Signal Processing 46(5), 1998, in covariance form, as the odometry noise is singular.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.linalg.blas import dtrsm
from threadpoolctl import threadpool_limits

from cellslam.benchmarks.bound import DETECTIONS_OF_A_TRUE_VT
from cellslam.benchmarks.bound.linear_model import NEVER, Core, Drive, linear_model
from cellslam.benchmarks.bound.products_kernel import Loads, Sparse, subtract_gains, times
from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, Recording

if TYPE_CHECKING:
    from cellslam.sim.lte.persisting_errors import Cause

SMALLEST_SCALE = 1e-6  # s of a state: before it is smaller P takes it over, or 1 / s^2 would drown the rest
EVERY = 10  # snapshots from one value of the map's bound to the next
ROUNDING = 1e-14  # of a matrix's trace, that its eigenvalues can be wrong by
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


@dataclass(frozen=True)
class Joint:
    """What is known of the n states that are there: covariance `P` (n, n), error `m` (n,) of the mean, and the numbers
    `states` (n,) of these states. P and m are those of the states divided by their `scale` (n,), which is 1 for states
    that do not fade."""

    P: Floats
    m: Floats
    states: Ints
    scale: Floats

    def with_more(self, states: Ints, m: Floats, P: Floats, P_old: Floats | float = 0.0) -> Joint:
        """Return the joint with k more states, of errors m (k,), covariance P (k, k) and covariances P_old (k, n) with
        those that were there."""
        n, size = len(self.m), len(self.m) + len(m)
        joint = np.zeros((size, size))
        joint[:n, :n], joint[n:, n:], joint[n:, :n] = self.P, P, P_old
        joint[:n, n:] = joint[n:, :n].T
        scale = np.concatenate([self.scale, np.ones(len(m))])
        return Joint(joint, np.concatenate([self.m, m]), np.concatenate([self.states, states]), scale)

    def only(self, kept: Ints) -> Joint:
        """Return some of the states alone, those at the places `kept` (k,)."""
        return Joint(self.P[np.ix_(kept, kept)], self.m[kept], self.states[kept], self.scale[kept])


NOTHING = Joint(np.zeros((0, 0)), np.zeros(0), np.zeros(0, np.int64), np.zeros(0))


def bound(
    recording: Recording, progress: Progress = silent, calibrated: bool = False, merging: Cause | None = None
) -> BoundResult:
    """Return the posterior Cramer-Rao bound of a recording with truth.

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
    core: Core, drive: Drive, known: Joint = NOTHING, progress: Progress = silent
) -> tuple[BoundResult, Joint]:
    """Return the bound of a drive that begins with a `known` map, and the map that it leaves: VTs that stay."""
    motion, count = drive.motion, len(drive.motion.jump)
    pose, offset, error = np.zeros((count, 6, 6)), np.zeros((count, len(core.offsets))), np.zeros((count, 6))
    joint = NOTHING.with_more(np.arange(core.size), motion.jump[0], np.diag(motion.start))
    joint = joint.with_more(known.states, known.m, known.P)
    times_seen, over_time = _times_seen(drive, core), np.full(count, np.nan)
    survey, new = drive.survey, ~np.isin(drive.survey.state, known.states)  # a known map has it in
    joint = joint.with_more(survey.state[new], survey.error[new], np.diag(survey.variance[new]))
    with progress("Cramer-Rao bound", count) as advance:
        for t in range(count):
            if t > 0:
                joint = _predict(joint, drive, t)
            joint = _measure(joint, drive, t)
            pose[t], error[t] = joint.P[:6, :6], joint.m[:6]
            offset[t] = joint.P[core.offsets, core.offsets]
            over_time[t] = (
                _rms(_map_bound(joint, drive, core)[0][times_seen[t] >= DETECTIONS_OF_A_TRUE_VT])
                if t % EVERY == 0
                else over_time[t - 1]
            )
            last = drive.states.last[joint.states]
            gone = (last != NEVER) & (last <= t)
            if gone.mean() > IDLE:
                joint = joint.only(np.flatnonzero(~gone))
            advance(1)
    vts = (joint.states >= core.size) & (drive.states.last[joint.states] == NEVER)
    of_map = MapBound(*_map_bound(joint, drive, core), times_seen[-1], over_time)
    return BoundResult(pose, np.sqrt(np.maximum(offset, 0.0)), error, map=of_map), joint.only(np.flatnonzero(vts))


def _map_bound(joint: Joint, drive: Drive, core: Core) -> tuple[Floats, Floats]:
    """Return the bounds (V,) in m of the true VTs, NaN of those that are not there, and the errors (V, 3) of the mean;
    VTs do not fade, so that their scale is 1."""
    place = np.full(len(drive.states.last), -1)
    place[joint.states] = np.arange(len(joint.states))
    at = place[core.size + 3 * drive.vts[:, None] + np.arange(3)]
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


def _predict(joint: Joint, drive: Drive, t: int) -> Joint:
    """Return the states at snapshot t by those at the one before: the core moves, errors that persist are forgotten in
    part and gain as much variance."""
    F, P, m = drive.motion.F[t], joint.P, joint.m
    core = len(F)
    moved = P[:, :core] @ F.T
    moved[:core] = F @ moved[:core] + drive.motion.Q[t]
    P[:, :core], P[:core] = moved, moved.T
    m[:core] = F @ m[:core] + drive.motion.jump[t]
    a = drive.states.decay[t, drive.states.kind[joint.states]]
    scale = joint.scale * a
    if scale.min() < SMALLEST_SCALE:
        P *= scale[:, None] * scale
        m *= scale
        scale = np.ones(len(a))
    np.einsum("ii->i", P)[:] += (1.0 - a**2) / scale**2
    return replace(joint, scale=scale)


def _measure(joint: Joint, drive: Drive, t: int) -> Joint:
    """Return the states after the measurements of snapshot t."""
    s = drive.sightings
    rows = np.arange(s.rows[t], s.rows[t + 1])
    if not len(rows):
        return joint
    first, new = s.first[rows], drive.states.entering(t)
    if len(new):
        joint = joint.with_more(new, np.zeros(len(new)), np.eye(len(new)))
    if first.any():
        joint = _give_births(joint, drive, rows[first])
    measured = np.isfinite(s.variance[rows]) & ~first[:, None]
    if measured.any():
        _update(joint, drive, rows, measured)
    return joint


def _loads(joint: Joint, drive: Drive, rows: Ints, chosen: NDArray[np.bool_]) -> Loads:
    """Return H of the `chosen` (k, 3) components of measurements `rows` (k,); what is not there has no load."""
    views, s = drive.views, drive.sightings
    place, n = np.full(len(drive.states.last) + 1, -1), len(joint.states)
    place[joint.states] = np.arange(n)
    scale = np.append(joint.scale, 0.0)
    first, last = s.view_of[rows[0]], s.view_of[rows[-1]]
    begin = views.rows.begin[3 * first : 3 * last + 4]
    entries = slice(begin[0], begin[-1])
    column = place[views.rows.column[entries]]
    shared = Sparse(begin - begin[0], column, views.rows.load[entries] * scale[column])
    of = 3 * (s.view_of[rows, None] - first) + np.arange(3)
    own = place[s.state[rows][chosen]]
    by_own: Floats = np.broadcast_to(s.load, chosen.shape)[chosen] * scale[own]
    return Loads(shared, of[chosen], own, by_own)


def _give_births(joint: Joint, drive: Drive, rows: Ints) -> Joint:
    """Append the VTs of measurements `rows`, each known from one alone: the limit of a broad prior.

    v = D (z - H x) with D the inverse of H_v; the other states learn nothing.
    """
    s, H = drive.sightings, _loads(joint, drive, rows, np.ones((len(rows), 3), np.bool_))
    D = block_diag(*np.linalg.inv(drive.views.by_vt[s.view_of[rows]]))
    HP = times(H, joint.P)
    P_v = D @ (times(H, HP.T.copy()) + np.diag(s.variance[rows].ravel())) @ D.T
    v = (s.vt[rows, None] + np.arange(3)).ravel()
    return joint.with_more(v, D @ (s.residual[rows].ravel() - times(H, joint.m[:, None])[:, 0]), P_v, -D @ HP)


def _update(joint: Joint, drive: Drive, rows: Ints, measured: NDArray[np.bool_]) -> None:
    """Take the `measured` (k, 3) components of measurements `rows` (k,) in, whose white errors have variances R.

    H, residual and S are divided by the roots of R: S is 1 + H P H^T, whose eigenvalues are 1 or more, but for what the
    largest of them is rounded by. So much is added before S is factored, by Cholesky.
    """
    s, H = drive.sightings, _loads(joint, drive, rows, measured)
    root = np.sqrt(s.variance[rows][measured])
    HP = times(H, joint.P)
    HP /= root[:, None]
    S = times(H, HP.T.copy()) / root[:, None]
    S[np.diag_indices(len(S))] += 1.0 + ROUNDING * np.trace(S)
    L = np.linalg.cholesky(S)
    G = dtrsm(1.0, L, HP.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
    subtract_gains(joint.P, G)
    innovation = (s.residual[rows][measured] - times(H, joint.m[:, None])[:, 0]) / root
    joint.m[:] += dtrsm(1.0, L, innovation[:, None], lower=1)[:, 0] @ G
