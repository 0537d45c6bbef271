"""Compiled: which measurements may be of which Gaussians, and the probabilities of it.

Sources: Williams and Lau, "Approximate evaluation of marginal association probabilities with belief propagation", IEEE
Trans. AES 50(4), 2014; Mullane et al., "A random-finite-set approach to Bayesian SLAM", IEEE Trans. Robotics 27(2),
2011 (field of view).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model import matrices_kernel as algebra
from cellslam.slam.model.matrices_kernel import Vec3, dot, transposed, vec_at, vec_of
from cellslam.slam.model.measurement_kernel import LEAST_FLAT2
from cellslam.slam.phd_slam import map_kernel
from cellslam.slam.phd_slam.map_kernel import COVARIANCE, LINK, MEAN, VISIBLE, Map, Measured, seen_from
from cellslam.slam.phd_slam.motion_kernel import Moved, slopes

SWEEPS = 3  # of belief propagation: nearly all associations are of one or two rivals
FARTHEST = 4.0  # deviations beyond the field of view at which a Gaussian need not be looked at
LARGEST_LOG = 600.0  # of a likelihood ratio: its exponential is still a number
SURELY2 = 36.0  # squared deviations from an edge at which there is none
RIGHT2 = (0.5 * math.pi) ** 2  # square of a right angle
UNSEEN = 1e-3  # probability of detection below which it is not looked at either


class Visibility(NamedTuple):
    """Probability that what is visible is detected; probabilities of the step to visible from visible, `stay`, and from
    hidden, `back`; field of view `limits` (L, 4) of each link: farthest distance in m, largest azimuth in rad, and the
    variances of both."""

    detection: float
    stay: float
    back: float
    limits: Floats


class Upkeep(NamedTuple):
    """Weight of what is born, weight below which a Gaussian is dropped, squared distance up to which two are merged."""

    birth: float
    drop: float
    merge: float


class Matching(NamedTuple):
    """Squared Mahalanobis distance of the gate, linearisations of the importance density, what share of the evidence is
    `new`, site of each link (L,)."""

    gate: float
    iterations: int
    new: float
    site_of: Ints


class Rules(NamedTuple):
    """What does not change within a snapshot."""

    visibility: Visibility
    upkeep: Upkeep
    matching: Matching


class Near(NamedTuple):
    """Gaussians in the field of view, or nearly: their places in the map, which ascend; distance (m, with the clock's
    offset), offset ahead and to the left (m), squared horizontal distance (m^2) and trace of the covariance (m^2) in
    rows (., 5); probabilities of detection."""

    place: Ints
    where: Floats
    chance: Floats


class Pairs(NamedTuple):
    """Places of the Gaussian in `Near` and of the measurement of each pair, sorted by Gaussians, and how likely the
    pair is against clutter."""

    gaussian: Ints
    measurement: Ints
    odds: Floats


@lean
def _inside(margin: float, variance: float) -> float:
    """Return the probability that something so far inside of an edge, with that variance, is inside."""
    if margin * margin > SURELY2 * variance:
        return 1.0 if margin > 0.0 else 0.0
    return 0.5 + 0.5 * math.erf(margin / math.sqrt(2.0 * variance))


@lean
def _within(v: Vec3, span: float, variance: float, flat2: float) -> float:
    """Return the probability that the azimuth of v (m) is below the span, with that variance in rad^2.

    Behind, an arc is longer than its chord: most of what is there needs no arc tangent.
    """
    least = span - 0.5 * math.pi + v.x / math.sqrt(flat2)
    if v.x < 0.0 and least < 0.0 and least * least > SURELY2 * variance:
        return 0.0
    return _inside(span - abs(math.atan2(v.y, v.x)), variance)


@part
def find_near(own: Map, among: Ints, at: Moved, offset: Floats, rules: Rules, moved: float, turn: float) -> Near:
    """Return which of the Gaussians at these places, which ascend, may be detected; offset (S,) in m: the clocks.

    The edge of the field of view is as soft as they are uncertain, and the pose (moved in m^2, turn in rad^2).
    """
    rows, names, count = own.rows, own.names, len(among)
    limits, site_of = rules.visibility.limits, rules.matching.site_of
    place, where, probability, n = np.empty(count, np.int64), np.empty((count, 5)), np.empty(count), 0
    for j in among:
        link = names[j, LINK]
        reach, span, clock = limits[link, 0], limits[link, 1], offset[site_of[link]]
        w = algebra.vec_minus(vec_at(rows[j], MEAN), at.place)
        loose = rows[j, COVARIANCE] + rows[j, COVARIANCE + 3] + rows[j, COVARIANCE + 5]  # trace
        most = reach - clock + FARTHEST * math.sqrt(limits[link, 2] + loose)
        full2 = dot(w, w)
        if most <= 0.0 or full2 > most * most:
            continue
        v = algebra.transposed_vec(at.turned.r, w)
        flat2 = max(v.x * v.x + v.y * v.y, LEAST_FLAT2)
        distance, chance = math.sqrt(full2) + clock, rules.visibility.detection
        if span < math.pi:
            chance *= _within(v, span, limits[link, 3] + turn + loose / flat2, flat2)
        if chance > UNSEEN:
            chance *= _inside(reach - distance, limits[link, 2] + moved + loose)
        if chance > UNSEEN:
            place[n], probability[n] = j, chance
            where[n, 0], where[n, 1], where[n, 2], where[n, 3], where[n, 4] = distance, v.x, v.y, flat2, loose
            n += 1
    return Near(place[:n], where[:n], probability[:n])


@lean
def _off(c: float, s: float, ahead: float, aside: float, limit2: float) -> bool:
    """Return whether the angle between the directions (c, s), of length 1, and (ahead, aside) is surely above the root
    of limit2, in rad: its sine is smaller, and behind it is above a right angle."""
    cross, along = c * aside - s * ahead, c * ahead + s * aside
    if along < 0.0:
        return limit2 < RIGHT2
    return cross * cross > limit2 * (cross * cross + along * along)


@part
def pair_up(
    own: Map, near: Near, at: Moved, std: Floats, offset: Floats, variance: Floats, measured: Measured, rules: Rules
) -> Pairs:
    """Return the pairs of Gaussians and measurements within the gate, with p_D w N(e; 0, S) / kappa.

    std (6,): deviations (m/s, rad/s) of the velocity that has led here, in S too; offset, variance (S,): of the
    clocks. Jacobians are worked out where they are needed only: no component alone has a greater normalised distance
    than all, and a Gaussian's trace bounds the variances of its distance and azimuth.
    """
    rows, names, site_of, where = own.rows, own.names, rules.matching.site_of, near.where
    z, known, single, gain, gate = measured.z, measured.known, measured.single, measured.gain, rules.matching.gate
    most, size, dt2 = len(where) * len(z), 0, at.dt * at.dt
    gaussian, measurement, odds = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    toward = np.empty((len(z), 2))
    for k in range(len(z)):
        toward[k, 0], toward[k, 1] = math.cos(z[k, 1]), math.sin(z[k, 1])
    moved, turn = dt2 * (std[0] ** 2 + std[1] ** 2 + std[2] ** 2), dt2 * (std[3] ** 2 + std[4] ** 2 + std[5] ** 2)
    for n in range(len(where)):
        j = near.place[n]
        link, mean, distance, flat2 = names[j, LINK], vec_at(rows[j], MEAN), where[n, 0], where[n, 3]
        site, ahead, aside = site_of[link], where[n, 1], where[n, 2]
        wide = where[n, 4] + 3.0 * (moved + 2.0 * variance[site])
        across, looked = wide / flat2 + 3.0 * turn, False
        wide += 3.0 * turn * flat2
        for k in range(measured.first[link], measured.first[link + 1]):
            e = known[k, 0] * (z[k, 0] - distance)
            if e * e > gate * (single[k, 0] + wide):
                continue
            if known[k, 1] > 0.0 and _off(toward[k, 0], toward[k, 1], ahead, aside, gate * (single[k, 1] + across)):
                continue
            if not looked:
                seen = seen_from(at.place, at.turned.r, rows, j, offset[site])
                spread, looked = map_kernel.with_clock(seen, variance[site]), True
                if moved + turn > 0.0:
                    by = slopes(seen, mean, at, std)
                    for by_part in by:
                        spread = algebra.sym_plus(spread, algebra.sym_product(by_part, transposed(by_part)))
            new = map_kernel.innovation(
                map_kernel.residual(seen, vec_of(z[k]), vec_of(known[k])), spread, vec_of(single[k])
            )
            if 0.0 <= new.distance2 < gate:
                gaussian[size], measurement[size] = n, k
                likelihood = math.exp(min(new.log_density + gain[k], LARGEST_LOG))
                odds[size] = near.chance[n] * rows[j, VISIBLE] * likelihood
                size += 1
    return Pairs(gaussian[:size], measurement[:size], odds[:size])


@part
def exclusive(pairs: Pairs, measurements: int) -> Floats:
    """Return the marginal probability (P,) of each pair, where a Gaussian has one measurement at most and the
    reverse."""
    gaussian, measurement, odds = pairs
    size = len(odds)
    ratio, out, of_measurement = np.ones(size), np.empty(size), np.empty(measurements)
    for sweep in range(SWEEPS + 1):
        begin = 0
        while begin < size:
            end, total = begin, 1.0
            while end < size and gaussian[end] == gaussian[begin]:
                total += odds[end] * ratio[end]
                end += 1
            for p in range(begin, end):
                mine = odds[p] * ratio[p]
                out[p] = mine / total if sweep == SWEEPS else odds[p] / max(total - mine, 1.0)
            begin = end
        if sweep < SWEEPS:
            of_measurement[:] = 1.0
            for p in range(size):
                of_measurement[measurement[p]] += out[p]
            for p in range(size):
                ratio[p] = 1.0 / max(of_measurement[measurement[p]] - out[p], 1.0)
    return out
