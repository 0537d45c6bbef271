"""Compiled: a snapshot for every particle: a velocity is drawn, the map updated, the particle weighed.

Sources: Mullane, Vo, Adams and Vo, "A random-finite-set approach to Bayesian SLAM", IEEE Trans. Robotics 27(2), 2011;
Kaltiokallio et al., "A multihypotheses importance density for SLAM in cluttered scenarios", IEEE Trans. Robotics 40,
2024; the evidence of a snapshot under a Poisson map: Vo and Ma, IEEE Trans. Signal Processing 54(11), 2006.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.matrices_kernel import dot, sym_vec, vec_at, vec_of, vec_plus
from cellslam.slam.phd_slam import map_kernel, motion_kernel, pairs_kernel
from cellslam.slam.phd_slam.map_kernel import HIDDEN, HITS, LINK, MEAN, NAME, VISIBLE, Map, Measured, seen_from
from cellslam.slam.phd_slam.motion_kernel import Interval, Moved, moved
from cellslam.slam.phd_slam.pairs_kernel import Matching, Near, Pairs, Rules, Upkeep, Visibility, find_near, pair_up

SURE = 0.5  # a measurement is taken to be of a VT to which it belongs with at least this probability


class Particles(NamedTuple):
    """N particles: pose (N, 6) in m and rad; of bias and scale of the odometry the means, error (N, 6, 2), and
    variances with covariance, error_variance (N, 6, 3); offset and variance (N, S) of clocks in m and m^2; log_weight
    (N, 1); a map in rows, names and size (N, 1)."""

    pose: Floats
    error: Floats
    error_variance: Floats
    offset: Floats
    variance: Floats
    log_weight: Floats
    rows: Floats
    names: Ints
    size: Ints


class One(NamedTuple):
    """One of the particles, with its map."""

    pose: Floats
    error: Floats
    error_variance: Floats
    offset: Floats
    variance: Floats
    log_weight: Floats
    map: Map


@part
def one_of(p: Particles, i: int) -> One:
    """Return one of the particles."""
    own = Map(p.rows[i], p.names[i], p.size[i])
    return One(p.pose[i], p.error[i], p.error_variance[i], p.offset[i], p.variance[i], p.log_weight[i], own)


@njit(cache=True, parallel=True)
def use_snapshot(
    particles: Particles, interval: Interval, measured: Measured, visibility: Visibility, upkeep: Upkeep,
    matching: Matching, walk: Floats, drawn: Floats, association: Ints,
) -> None:  # fmt: skip
    """Use one snapshot in every particle.

    walk (S,): variance of the clock offsets' change, in m^2; drawn (N, 6): standard normal; association (N, M):
    written, identity of the VT or -1.
    """
    for i in prange(len(particles.pose)):
        one, rules = one_of(particles, i), Rules(visibility, upkeep, matching)  # a prange takes no tuple of tuples
        own = one.map
        _walk(one, walk, rules)
        among = np.arange(own.size[0])
        if interval.dt > 0.0:
            map_kernel.come_and_go(own, visibility.stay, visibility.back)
            among = _move(one, interval, measured, rules, drawn[i])
        _update(one, moved(one.pose, np.zeros(6), 0.0), among, measured, rules, association[i])


@part
def _walk(one: One, walk: Floats, rules: Rules) -> None:
    """Let the clock offsets walk."""
    kept, any_walks = np.ones((len(walk), 2)), False
    for s in range(len(walk)):
        if walk[s] > 0.0:
            any_walks = True
            kept[s, 0] = one.variance[s] / (one.variance[s] + walk[s])
            kept[s, 1] = one.variance[s] * (1.0 - kept[s, 0])
            one.variance[s] += walk[s]
    if any_walks:
        map_kernel.forget(one.map, rules.matching.site_of, kept)


@part
def _move(one: One, interval: Interval, measured: Measured, rules: Rules, drawn: Floats) -> Ints:
    """Draw the velocity from its density given the snapshot, linearised at its mean; weigh by prior over density.

    Return the places of what may be seen.
    """
    mean, std, x, factor = np.empty(6), np.empty(6), np.zeros(6), np.zeros((6, 6))
    motion_kernel.predict_velocity(one.error, one.error_variance, interval, mean, std)
    velocity, dt2 = mean.copy(), interval.dt**2
    at, everywhere = moved(one.pose, mean, interval.dt), np.arange(one.map.size[0])
    shift, turn = dt2 * np.sum(std[:3] ** 2), dt2 * np.sum(std[3:] ** 2)
    near = find_near(one.map, everywhere, at, one.offset, rules, shift, turn)
    pairs = pair_up(one.map, near, at, std, one.offset, one.variance, measured, rules)
    shares = pairs_kernel.exclusive(pairs, len(measured.z))
    for _ in range(rules.matching.iterations):
        y = np.zeros(6)
        factor[:] = 0.0
        _inform(one, moved(one.pose, velocity, interval.dt), std, measured, rules, near, pairs, shares, x, factor, y)
        motion_kernel.factorise(factor, y, x)
        for c in range(6):
            velocity[c] = mean[c] + std[c] * x[c]
    part = drawn.copy()
    motion_kernel.back(factor, part)
    log_ratio = 0.0
    for c in range(6):
        log_ratio += 0.5 * drawn[c] * drawn[c] - 0.5 * (x[c] + part[c]) ** 2 - math.log(factor[c, c])
        velocity[c] = mean[c] + std[c] * (x[c] + part[c])
    one.log_weight[0] += log_ratio
    motion_kernel.put_pose(one.pose, velocity, moved(one.pose, velocity, interval.dt))
    motion_kernel.learn(one.error, one.error_variance, interval, velocity)
    return near.place


@lean
def _inform(
    one: One, at: Moved, std: Floats, measured: Measured, rules: Rules, near: Near, pairs: Pairs, shares: Floats,
    x: Floats, information: Floats, y: Floats,
) -> None:  # fmt: skip
    """Add what the pairs say of the velocity, linearised at x (6,) deviations of it, each by its probability."""
    for p in range(len(pairs.odds)):
        j, k = near.place[pairs.gaussian[p]], pairs.measurement[p]
        if shares[p] < rules.upkeep.drop:
            continue
        site = rules.matching.site_of[measured.link[k]]
        seen = seen_from(at.place, at.turned.r, one.map.rows, j, one.offset[site])
        by = motion_kernel.slopes(seen, vec_at(one.map.rows[j], MEAN), at, std)
        e = vec_plus(
            map_kernel.residual(seen, vec_of(measured.z[k]), vec_of(measured.known[k])), motion_kernel.times(by, x)
        )
        inverse = map_kernel.innovation(
            e, map_kernel.with_clock(seen, one.variance[site]), vec_of(measured.many[k])
        ).inverse
        motion_kernel.inform(by, inverse, e, shares[p], information, y)


@part
def _update(one: One, at: Moved, among: Ints, measured: Measured, rules: Rules, association: Ints) -> None:
    """Update the clock offsets, the map, of which the Gaussians at the places `among` may be seen, and the weight of a
    particle whose pose is drawn."""
    own, nothing = one.map, np.zeros(6)
    near = find_near(own, among, at, one.offset, rules, 0.0, 0.0)
    pairs = pair_up(own, near, at, nothing, one.offset, one.variance, measured, rules)
    if one.variance.any():
        _learn_offsets(one, at, measured, rules, near, pairs)
        near = find_near(own, among, at, one.offset, rules, 0.0, 0.0)
        known = np.zeros(len(one.variance))
        pairs = pair_up(own, near, at, nothing, one.offset, known, measured, rules)
    total, evidence = np.ones(len(measured.z)), 0.0
    for p in range(len(pairs.odds)):
        total[pairs.measurement[p]] += pairs.odds[p]
    for k in range(len(total)):
        evidence += math.log(total[k])
    for n in range(len(near.place)):
        evidence -= near.chance[n] * own.rows[near.place[n], VISIBLE]
    one.log_weight[0] += rules.matching.new * evidence
    pool = _updated(one, at, measured, rules, near, pairs, total, association)
    map_kernel.condense(pool, own, near.place, rules.upkeep.drop, rules.upkeep.merge)


@part
def _learn_offsets(one: One, at: Moved, measured: Measured, rules: Rules, near: Near, pairs: Pairs) -> None:
    """Condition the clock offsets on the pairs, each by its probability; weigh by what that costs.

    I = sum A^T S^-1 A, y = sum A^T S^-1 e with A = dh/db: P_new = P / (1 + I P), b += P_new y (Laplace's method).
    """
    total, sites = np.ones(len(measured.z)), len(one.offset)
    information, y, change = np.zeros(sites), np.zeros(sites), np.zeros(sites)
    for p in range(len(pairs.odds)):
        total[pairs.measurement[p]] += pairs.odds[p]
    for p in range(len(pairs.odds)):
        j, k = near.place[pairs.gaussian[p]], pairs.measurement[p]
        site = rules.matching.site_of[measured.link[k]]
        share = pairs.odds[p] / total[k]
        if share < rules.upkeep.drop or one.variance[site] == 0.0:
            continue
        seen = seen_from(at.place, at.turned.r, one.map.rows, j, one.offset[site])
        e = map_kernel.residual(seen, vec_of(measured.z[k]), vec_of(measured.known[k]))
        known = sym_vec(map_kernel.innovation(e, seen.spread, vec_of(measured.many[k])).inverse, seen.by_offset)
        information[site] += share * dot(known, seen.by_offset)
        y[site] += share * dot(known, e)
    for s in range(sites):
        if one.variance[s] > 0.0:
            left = 1.0 + information[s] * one.variance[s]
            change[s] = one.variance[s] / left * y[s]
            one.log_weight[0] -= 0.5 * (change[s] ** 2 / one.variance[s] + math.log(left))
            one.variance[s] /= left
            one.offset[s] += change[s]
    map_kernel.follow(one.map, rules.matching.site_of, change)


@part
def _updated(
    one: One, at: Moved, measured: Measured, rules: Rules, near: Near, pairs: Pairs, total: Floats, association: Ints
) -> Map:
    """Leave the Gaussians in view in the map as they are if missed; return one for each detection, and those that are
    born."""
    rows, names, z, known, many = one.map.rows, one.map.names, measured.z, measured.known, measured.many
    pool, count = map_kernel.new_pool(len(pairs.odds) + len(total)), len(pairs.odds)
    best, p = np.full(len(total), SURE), 0
    association[:] = -1
    for n in range(len(near.place)):
        j, found = near.place[n], 0.0
        link, name, hits = names[j, LINK], names[j, NAME], rows[j, HITS]
        if p < count and pairs.gaussian[p] == n:
            seen = seen_from(at.place, at.turned.r, rows, j, one.offset[rules.matching.site_of[link]])
        while p < count and pairs.gaussian[p] == n:
            k = pairs.measurement[p]
            share = pairs.odds[p] / total[k]
            found += share
            if share > rules.upkeep.drop:
                e = map_kernel.residual(seen, vec_of(z[k]), vec_of(known[k]))
                new = map_kernel.innovation(e, seen.spread, vec_of(many[k]))
                place = map_kernel.added(pool, link, name, share, 0.0, hits + share)
                map_kernel.put_update(pool.rows, place, rows, j, seen, new)
            if share > best[k]:
                best[k], association[k] = share, name
            p += 1
        rows[j, VISIBLE] *= 1.0 - near.chance[n]
        rows[j, HIDDEN] *= max(1.0 - found, 0.0)
    for k in range(len(total)):
        weight = rules.upkeep.birth / total[k]
        if weight > rules.upkeep.drop and measured.begins[k]:
            link = measured.link[k]
            map_kernel.give_birth(
                pool, at.place, at.turned.r, one.offset[rules.matching.site_of[link]], measured, k, weight
            )
    return pool


@njit(cache=True, parallel=True)
def resample(particles: Particles, ancestors: Ints) -> None:
    """Put copies of the ancestors, sorted indices (N,), in the place of particles that have no offspring."""
    p, n = particles, len(ancestors)
    children = np.zeros(n, np.int64)
    for ancestor in ancestors:
        children[ancestor] += 1
    spare = np.repeat(np.arange(n), np.maximum(children - 1, 0))
    free = np.flatnonzero(children == 0)
    for i in prange(len(free)):
        _copy(p, spare[i], free[i])
    p.log_weight[:] = 0.0


@part
def _copy(p: Particles, a: int, b: int) -> None:
    """Put a copy of particle a in the place of particle b."""
    p.pose[b], p.error[b], p.error_variance[b] = p.pose[a], p.error[a], p.error_variance[a]
    p.offset[b], p.variance[b] = p.offset[a], p.variance[a]
    map_kernel.copy_map(one_of(p, a).map, one_of(p, b).map)
