"""The factor graph: poses, odometry errors, clock offsets, VTs; built and solved with GTSAM.

Sources: paper, eq. 22 to 27, with the elevation corrected; Barfoot, "State estimation for robotics", 2017, chapter 7
(derivatives by a rotation vector).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, E, L, X

from cellslam.sim.compiling import njit
from cellslam.sim.frames import rotation, rotation_angles
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model import matrices_kernel as algebra
from cellslam.slam.model.matrices_kernel import Mat3, mat_mat, transposed, transposed_vec, vec_at, vec_minus, vec_of
from cellslam.slam.model.measurement_kernel import spherical, spherical_jacobian

LEAST_SURVEY_STD_M = 1e-3  # keeps the graph regular where a survey is exact


@dataclass(frozen=True)
class Leg:
    """Motion from one keyframe to the next, over n snapshots.

    `inner` (n, 6): poses of the snapshots after the first keyframe in its frame, the last one the next keyframe; `std`
    (6,): deviations of rotation vector and translation in the frame of the end; `by_error` (6, e): how these change
    with each odometry error: biases, then scales.
    """

    inner: Floats
    std: Floats
    by_error: Floats

    @property
    def relative(self) -> Floats:
        """The end in the frame of the start, (6,), in m and rad."""
        end: Floats = self.inner[-1]
        return end


@dataclass(frozen=True)
class Sighting:
    """All measurements of one VT about one keyframe: their places relative to it (m, 12), values (m, 3).

    `std` (3,): deviations of their mean, with errors that persist; `single` (3,): of one measurement.
    """

    keyframe: int
    vt: int
    site: int
    relative: Floats
    z: Floats
    std: Floats
    single: Floats


@dataclass(frozen=True)
class Priors:
    """What is known before: `start` pose (6,) and its deviations `start_std` (6,); deviations `error_std` (e,) of the
    odometry errors, and `walk_std` (e,) from one segment to the next; clock offsets `offset_mean_m`, `offset_std_m`
    (S,); of surveyed transmitters that are seen, the VTs that they are, `surveyed` (n,), positions and deviations (n,
    3)."""

    start: Floats
    start_std: Floats
    error_std: Floats
    walk_std: Floats
    offset_mean_m: Floats
    offset_std_m: Floats
    surveyed: Ints
    surveyed_m: Floats
    survey_std_m: Floats


@dataclass(frozen=True)
class Problem:
    """What is solved: keyframes (K, 6), clock offsets (S,) and VTs (V, 3) to begin with; legs between the keyframes
    (K - 1), `segment` (K - 1,): which odometry errors hold on a leg; sightings."""

    priors: Priors
    keyframes: Floats
    offset_m: Floats
    vts: Floats
    legs: tuple[Leg, ...]
    segment: Ints
    sightings: tuple[Sighting, ...]


@dataclass(frozen=True)
class Solution:
    """Keyframes (K, 6), clock offsets (S,), VTs (V, 3), and which sightings were left out as outliers (n,)."""

    keyframes: Floats
    offset_m: Floats
    vts: Floats
    outlier: Ints


def solve(problem: Problem, gate: float, huber: float, rounds: int, iterations: int) -> Solution:
    """Solve, leave out what does not fit, and solve again, until nothing changes or for `rounds` times."""
    values = _initial(problem)
    outlier = np.zeros(len(problem.sightings), bool)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(1e-5)
    parameters.setOrdering(_ordering(problem))
    for _ in range(rounds):
        graph = _graph(problem, ~outlier, huber)
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        found = np.array([_distance2(values, s) > gate for s in problem.sightings], bool)
        if (found == outlier).all():
            break
        outlier = found
    frames = np.array([_pose6(values.atPose3(X(k))) for k in range(len(problem.keyframes))])
    offsets = np.array([values.atVector(B(s))[0] for s in range(len(problem.priors.offset_mean_m))])
    vts = np.array([values.atPoint3(L(v)) for v in range(len(problem.vts))]).reshape(-1, 3)
    return Solution(frames, offsets, vts, outlier.astype(np.int64))


def _ordering(problem: Problem) -> Any:
    """Eliminate VTs first, then poses along the drive with the odometry errors of their segment, clock offsets last."""
    order, seen = gtsam.Ordering(), {s.vt for s in problem.sightings}
    for v in range(len(problem.vts)):
        if v in seen:
            order.push_back(L(v))
    for k in range(len(problem.keyframes)):
        order.push_back(X(k))
    if len(problem.priors.error_std):
        for segment in range(int(problem.segment.max(initial=0)) + 1):
            order.push_back(E(segment))
    for site in range(len(problem.priors.offset_mean_m)):
        order.push_back(B(site))
    return order


def _initial(problem: Problem) -> Any:
    values = gtsam.Values()
    for k, pose in enumerate(problem.keyframes):
        values.insert(X(k), _pose3(pose))
    for segment in range(int(problem.segment.max(initial=0)) + 1):
        values.insert(E(segment), np.zeros(len(problem.priors.error_std)))
    for site, offset in enumerate(problem.offset_m):
        values.insert(B(site), np.array([offset]))
    for v, place in enumerate(problem.vts):
        values.insert(L(v), place)
    return values


def _graph(problem: Problem, used: Any, huber: float) -> Any:
    graph, diagonal = gtsam.NonlinearFactorGraph(), gtsam.noiseModel.Diagonal.Sigmas
    start_std = np.maximum(np.concatenate([problem.priors.start_std[[5, 4, 3]], problem.priors.start_std[:3]]), 1e-4)
    graph.add(gtsam.PriorFactorPose3(X(0), _pose3(problem.priors.start), diagonal(start_std)))
    if len(problem.priors.error_std):
        graph.add(
            gtsam.PriorFactorVector(E(0), np.zeros(len(problem.priors.error_std)), diagonal(problem.priors.error_std))
        )
        for segment in range(int(problem.segment.max(initial=0))):
            keys = gtsam.KeyVector([E(segment), E(segment + 1)])
            graph.add(gtsam.CustomFactor(diagonal(problem.priors.walk_std), keys, _walk))
    for site, (mean, std) in enumerate(zip(problem.priors.offset_mean_m, problem.priors.offset_std_m, strict=True)):
        graph.add(gtsam.PriorFactorVector(B(site), np.array([mean]), diagonal(np.array([max(std, 1e-6)]))))
    surveyed = zip(problem.priors.surveyed, problem.priors.surveyed_m, problem.priors.survey_std_m, strict=True)
    for vt, place, std in surveyed:
        graph.add(gtsam.PriorFactorPoint3(L(int(vt)), place, diagonal(np.maximum(std, LEAST_SURVEY_STD_M))))
    for k, leg in enumerate(problem.legs):
        keys = [X(k), X(k + 1), *([E(int(problem.segment[k]))] if len(problem.priors.error_std) else [])]
        graph.add(gtsam.CustomFactor(diagonal(leg.std), gtsam.KeyVector(keys), _driven(leg)))
    loss = gtsam.noiseModel.mEstimator.Huber.Create(huber)
    for sighting in (s for s, use in zip(problem.sightings, used, strict=True) if use):
        noise = gtsam.noiseModel.Robust.Create(loss, diagonal(sighting.std))
        keys = [X(sighting.keyframe), L(sighting.vt), B(sighting.site)]
        graph.add(gtsam.CustomFactor(noise, gtsam.KeyVector(keys), _seen(sighting)))
    return graph


def _walk(factor: Any, values: Any, jacobians: Any) -> Floats:
    """Odometry biases of one segment and the next."""
    first, second = factor.keys()
    a, b = values.atVector(first), values.atVector(second)
    if jacobians is not None:
        jacobians[0], jacobians[1] = -np.eye(len(a), order="F"), np.eye(len(a), order="F")
    return np.asarray(b - a)


def _driven(leg: Leg) -> Any:
    """Return the error function of a leg: rotation vector and translation between odometry and keyframes."""
    measured = _pose3(leg.relative)

    def error(factor: Any, values: Any, jacobians: Any) -> Floats:
        keys = factor.keys()
        between = values.atPose3(keys[0]).between(values.atPose3(keys[1]))
        apart = measured.between(between)
        out = gtsam.Pose3.Logmap(apart)
        if len(keys) == 3:
            out = out - leg.by_error @ values.atVector(keys[2])
        if jacobians is not None:
            slope = gtsam.Pose3.LogmapDerivative(apart)
            jacobians[0] = np.asfortranarray(-slope @ between.inverse().AdjointMap())
            jacobians[1] = np.asfortranarray(slope)
            if len(keys) == 3:
                jacobians[2] = np.asfortranarray(-leg.by_error)
        return np.asarray(out)

    return error


def _seen(sighting: Sighting) -> Any:
    """Return the error function of a sighting: mean of h + b - z."""

    def error(factor: Any, values: Any, jacobians: Any) -> Floats:
        keys = factor.keys()
        out, by_pose, by_vt = _mean_residual(values, sighting, keys)
        if jacobians is not None:
            jacobians[0], jacobians[1] = np.asfortranarray(by_pose), np.asfortranarray(by_vt)
            jacobians[2] = np.array([[1.0], [0.0], [0.0]], order="F")
        return out

    return error


def _mean_residual(values: Any, sighting: Sighting, keys: Any) -> tuple[Floats, Floats, Floats]:
    pose, vt, offset = values.atPose3(keys[0]), values.atPoint3(keys[1]), values.atVector(keys[2])[0]
    out, by_pose, by_vt = np.empty(3), np.empty((3, 6)), np.empty((3, 3))
    turned = np.ascontiguousarray(pose.rotation().matrix())
    residual(turned, pose.translation(), vt, offset, sighting.relative, sighting.z, out, by_pose, by_vt)
    return out, by_pose, by_vt


def _distance2(values: Any, sighting: Sighting) -> float:
    """Return the squared residual of a sighting in deviations of one measurement."""
    keys = (X(sighting.keyframe), L(sighting.vt), B(sighting.site))
    return float(np.sum((_mean_residual(values, sighting, keys)[0] / sighting.single) ** 2))


def _pose3(pose: Floats) -> Any:
    return gtsam.Pose3(gtsam.Rot3(rotation(*pose[3:])), pose[:3])


def _pose6(pose: Any) -> Floats:
    return np.concatenate([pose.translation(), rotation_angles(pose.rotation().matrix())])


@njit(cache=True)
def residual(
    rotation: Floats, position: Floats, vt: Floats, offset: float, relative: Floats, z: Floats, out: Floats,
    by_pose: Floats, by_vt: Floats,
) -> None:  # fmt: skip
    """Write the mean over measurements of h + offset - z, and its Jacobians.

    rotation (3, 3), position (3,): keyframe; vt (3,) and offset in m; relative (m, 12): rotation row by row, and place,
    of the vehicle in the keyframe's frame; z (m, 3): distance, azimuth, elevation, in m and rad. out (3,); by_pose (3,
    6): rotation vector and translation in the keyframe's frame; by_vt (3, 3). The offset's Jacobian is (1, 0, 0).
    """
    r, slope = algebra.mat_of(rotation), algebra.mat_of(np.zeros((3, 3)))
    q, share = transposed_vec(r, vec_minus(vec_of(vt), vec_of(position))), 1.0 / len(z)
    out[:] = 0.0
    for m in range(len(z)):
        turned = algebra.mat_at(relative[m], 0)
        y = transposed_vec(turned, vec_minus(q, vec_at(relative[m], 9)))
        h = spherical(y)
        out[0] += share * (h.distance + offset - z[m, 0])
        out[1] += share * wrap(h.azimuth - z[m, 1])
        out[2] += share * (h.elevation - z[m, 2])
        one = algebra.scaled(mat_mat(spherical_jacobian(y), transposed(turned)), -share)
        slope = algebra.mat_minus(slope, one)
    crossed = Mat3(0.0, -q.z, q.y, q.z, 0.0, -q.x, -q.y, q.x, 0.0)  # dq = [q]x omega - v
    algebra.put_mat(by_pose[:, :3], mat_mat(slope, crossed))
    algebra.put_mat(by_pose[:, 3:], algebra.scaled(slope, -1.0))
    algebra.put_mat(by_vt, mat_mat(slope, transposed(r)))
