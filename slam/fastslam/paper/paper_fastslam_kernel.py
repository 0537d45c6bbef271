"""Compiled: the paper's FastSLAM, a snapshot for every particle. Cartesian VTs, an EKF each, Hungarian association.

Source: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
information", section III (h, H and the EKF of a VT) and section IV (association).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.assignment_kernel import assign
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
    Vec3,
    adjugate,
    determinant,
    mat_mat,
    mat_of,
    mat_sym,
    mat_vec,
    put_sym,
    quadratic,
    sym_minus,
    sym_of,
    sym_product,
    sym_scaled,
    transposed,
    transposed_vec,
    vec_minus,
    vec_of,
    vec_plus,
)
from cellslam.slam.model.measurement_kernel import (
    Spherical,
    cartesian_jacobian,
    direction,
    spherical,
    spherical_jacobian,
)

LAST, IDENT = 0, 1
SLACK = 1e-3  # m^2: rounding, and that a predicted distance is never below a millimetre
NEAREST_M = 1.0  # a VT is born no nearer
LOG_TURN = math.log(2.0 * math.pi)


class Maps(NamedTuple):
    """VTs of N particles: means (N, L, C, 3) and covs (N, L, C, 3, 3) in m, slots (N, L, C, 2): snapshot of the last
    update and identity, counts (N, L). Within a particle, the same without N."""

    means: Floats
    covs: Floats
    slots: Ints
    counts: Ints


class Measured(NamedTuple):
    """The measurements z (M, 3) in m and rad, their variances q (M, 3), first (L + 1,) of each link, offset (L,): clock
    offset (m) taken for each link."""

    z: Floats
    q: Floats
    first: Ints
    offset: Floats


class Scratch(NamedTuple):
    """Memory to work in, for each of N particles: score (N, C, M + 1), work (N, .), numbers (N, .)."""

    score: Floats
    work: Floats
    numbers: Ints


class Seen(NamedTuple):
    """A VT as a particle sees it: h, H Sigma and H Sigma H^T."""

    h: Spherical
    h_sigma: Mat3
    spread: Sym3


class Innovation(NamedTuple):
    """e = z - h; det S and S^-1 where S = H Sigma H^T + Q; e^T S^-1 e."""

    e: Vec3
    det: float
    inverse: Sym3
    distance2: float


@part
def _seen(place: Vec3, r: Mat3, mean: Vec3, cov: Sym3) -> Seen:
    """Return how a VT is seen from a place with the rotation R, body to world (corrected: the paper prints
    H^T Sigma H)."""
    v = transposed_vec(r, vec_minus(mean, place))
    jacobian = mat_mat(spherical_jacobian(v), transposed(r))
    h_sigma = mat_sym(jacobian, cov)
    return Seen(spherical(v), h_sigma, sym_product(h_sigma, transposed(jacobian)))


@part
def _innovation(seen: Seen, z: Floats, q: Floats, offset: float) -> Innovation:
    h, p = seen.h, seen.spread
    e = Vec3(z[0] - offset - h.distance, wrap(z[1] - h.azimuth), z[2] - h.elevation)
    s = Sym3(p.xx + q[0], p.xy, p.xz, p.yy + q[1], p.yz, p.zz + q[2])
    cofactors = adjugate(s)
    det = determinant(s, cofactors)
    inverse = sym_scaled(cofactors, 1.0 / det)
    return Innovation(e, det, inverse, quadratic(inverse, e))


@part
def _within_reach(place: Vec3, maps: Maps, link: int, given: Measured, gate: float, near: Ints) -> int:
    """Write which of a link's VTs may have a measurement within the gate, by distance; return how many.

    No component alone has a greater normalised distance than all three, and the variance of the predicted distance is
    at most the trace of the VT's covariance: what is too far off by that needs no Jacobian.
    """
    found = 0
    for j in range(maps.counts[link]):
        w, cov = vec_minus(vec_of(maps.means[link, j]), place), maps.covs[link, j]
        distance = math.sqrt(w.x * w.x + w.y * w.y + w.z * w.z)
        most = cov[0, 0] + cov[1, 1] + cov[2, 2]
        near[found] = j
        for k in range(given.first[link], given.first[link + 1]):
            e = given.z[k, 0] - given.offset[link] - distance
            if e * e <= gate * (most + given.q[k, 0]) + SLACK:
                found += 1
                break
    return found


@part
def _score(seen: Seen, given: Measured, link: int, gate: float, score: Floats) -> bool:
    """Write by how much each measurement of a link is within a VT's gate, at most 0 where not; return if any is."""
    found, start = False, given.first[link]
    for k in range(start, given.first[link + 1]):
        score[k - start] = -1.0
        e = given.z[k, 0] - given.offset[link] - seen.h.distance
        if e * e > gate * (seen.spread.xx + given.q[k, 0]):
            continue
        new = _innovation(seen, given.z[k], given.q[k], given.offset[link])
        # A covariance that rounding has spoilt takes no measurement.
        if new.det > 0.0 and new.distance2 >= 0.0:
            score[k - start] = gate - new.distance2
            found |= new.distance2 < gate
    return found


@part
def _update(seen: Seen, new: Innovation, mean: Floats, cov: Floats) -> float:
    """Update a VT: K = Sigma H^T S^-1, mean + K e, Sigma - K H Sigma; return the measurement's log-density."""
    gain = mat_sym(transposed(seen.h_sigma), new.inverse)
    moved = vec_plus(vec_of(mean), mat_vec(gain, new.e))
    mean[0], mean[1], mean[2] = moved.x, moved.y, moved.z
    put_sym(cov, sym_minus(sym_of(cov), sym_product(gain, seen.h_sigma)))
    return -0.5 * (new.distance2 + math.log(new.det) + 3.0 * LOG_TURN)


@part
def _give_birth(place: Vec3, r: Mat3, z: Floats, q: Floats, offset: float, mean: Floats, cov: Floats) -> None:
    """Write mean and covariance of the VT that a measurement points to: Sigma = J Q J^T."""
    distance = max(z[0] - offset, NEAREST_M)
    n = mat_vec(r, direction(z[1], z[2]))
    mean[0], mean[1], mean[2] = place.x + distance * n.x, place.y + distance * n.y, place.z + distance * n.z
    j = mat_mat(r, cartesian_jacobian(distance, z[1], z[2]))
    put_sym(cov, sym_product(mat_sym(j, Sym3(q[0], 0.0, 0.0, q[1], 0.0, q[2])), transposed(j)))


@part
def _room(maps: Maps, link: int) -> int:
    """Return a place for a VT of a link: a new one, or that of the one unseen for longest."""
    if maps.counts[link] < maps.means.shape[1]:
        maps.counts[link] += 1
        return int(maps.counts[link]) - 1
    return int(np.argmin(maps.slots[link, :, LAST]))


@part
def _particle(
    now: int, pose: Floats, rotation: Floats, maps: Maps, given: Measured, born: int, gate: float, association: Ints,
    scratch: Scratch,
) -> float:  # fmt: skip
    """Use a snapshot in one particle; return its log-likelihood."""
    place, r, log_weight = vec_of(pose), mat_of(rotation), 0.0
    rows, places = len(given.z) + 1, maps.means.shape[1]
    row_of, near = scratch.numbers[:rows], scratch.numbers[rows : rows + places + 1]
    for link in range(len(given.offset)):
        start, stop, offset = given.first[link], given.first[link + 1], given.offset[link]
        rivals = 0  # VTs with a measurement within the gate: the solver need not know of others
        for n in range(_within_reach(place, maps, link, given, gate, near)):
            near[rivals] = j = near[n]
            seen = _seen(place, r, vec_of(maps.means[link, j]), sym_of(maps.covs[link, j]))
            rivals += _score(seen, given, link, gate, scratch.score[rivals])
        assign(scratch.score, rivals, stop - start, row_of, scratch.work, scratch.numbers[rows + places + 1 :])
        for k in range(start, stop):
            association[k] = -1
            if row_of[k - start] >= 0:
                j = near[row_of[k - start]]
                mean, cov = maps.means[link, j], maps.covs[link, j]
                seen = _seen(place, r, vec_of(mean), sym_of(cov))
                log_weight += _update(seen, _innovation(seen, given.z[k], given.q[k], offset), mean, cov)
                maps.slots[link, j, LAST] = now
                association[k] = maps.slots[link, j, IDENT]
        for k in range(start, stop):
            if row_of[k - start] < 0:
                j = _room(maps, link)
                _give_birth(place, r, given.z[k], given.q[k], offset, maps.means[link, j], maps.covs[link, j])
                maps.slots[link, j, LAST], maps.slots[link, j, IDENT] = now, born + k
    return log_weight


@njit(cache=True, parallel=True)
def use_snapshot(
    now: int, poses: Floats, rotations: Floats, maps: Maps, given: Measured, born: int, gate: float, log_weight: Floats,
    association: Ints, scratch: Scratch,
) -> None:  # fmt: skip
    """Use one snapshot in N particles.

    poses (N, 6) in m and rad, rotations (N, 3, 3), body to world; maps: written; now: number of the snapshot, born:
    identity of the VT that the first measurement may bear; gate: squared Mahalanobis distance; log_weight (N,):
    log-likelihoods are added; association (N, M): identities of VTs are written, -1 for none.
    """
    for i in prange(len(poses)):
        own = Maps(maps.means[i], maps.covs[i], maps.slots[i], maps.counts[i])
        room = Scratch(scratch.score[i], scratch.work[i], scratch.numbers[i])
        log_weight[i] += _particle(now, poses[i], rotations[i], own, given, born, gate, association[i], room)
