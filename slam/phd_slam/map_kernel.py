"""Compiled: the map of a particle, a mixture of Gaussians: how these are seen, updated, born and merged.

A Gaussian has two weights, of a VT that can be seen now and of one that is hidden (a Markov chain of two states). Given
the clock offset b of its site, a VT is at mean + gain (b - its estimate), with covariance.

Sources: Vo and Ma, "The Gaussian mixture probability hypothesis density filter", IEEE Trans. Signal Processing 54(11),
2006 (table II: pruning and merging); Mullane, Vo, Adams and Vo, "A random-finite-set approach to Bayesian SLAM", IEEE
Trans. Robotics 27(2), 2011 (births from measurements); Pasha, Vo, Tuan and Ma, "A Gaussian mixture PHD filter for jump
Markov system models", IEEE Trans. AES 45(3), 2009.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model import matrices_kernel as algebra
from cellslam.slam.model import measurement_kernel
from cellslam.slam.model.matrices_kernel import Mat3, Sym3, Vec3, mat_mat, mat_vec, sym_at, transposed, vec_at, vec_of
from cellslam.slam.model.measurement_kernel import Spherical, spherical, spherical_jacobian

# A row of a map: mean (3), covariance (6, by rows of its upper triangle), gain (3), weights, detections.
MEAN, COVARIANCE, GAIN, VISIBLE, HIDDEN, HITS, WIDTH = 0, 3, 9, 12, 13, 14, 15
LINK, NAME, NAMES = 0, 1, 2
MISSING = 1e12  # variance, in m^2 or rad^2, of a component that was not measured
LOG_TURN = math.log(2.0 * math.pi)
LEAST_RANGE_M = 1.0  # a VT is born no nearer
UNKNOWN_ELEVATION_RAD = math.radians(15.0)


class Map(NamedTuple):
    """Gaussians of a particle (C, WIDTH) with their links and identities (C, NAMES), and how many there are (1,); of N
    particles the same behind an axis N."""

    rows: Floats
    names: Ints
    size: Ints


class Measured(NamedTuple):
    """A snapshot: z (M, 3) in m and rad, 0 where not measured, known (M, 3): 1 or 0; variances (M, 3) of one
    measurement, of an update, of a birth; `gain` (M,): log of what a density of it over that of clutter lacks; link
    (M,), and the `first` measurement of each link (L + 1,); begins (M,); `born`: identity that the first one may give
    to a VT."""

    z: Floats
    known: Floats
    single: Floats
    many: Floats
    fresh: Floats
    gain: Floats
    link: Ints
    first: Ints
    begins: Any
    born: int


class Seen(NamedTuple):
    """A Gaussian as seen from a pose: h, H = dh/d(place), H Sigma, H Sigma H^T, and dh/d(clock offset)."""

    h: Spherical
    by_place: Mat3
    h_sigma: Mat3
    spread: Sym3
    by_offset: Vec3


class Innovation(NamedTuple):
    """e = z - h, the inverse of its covariance S, e^T S^-1 e and log N(e; 0, S)."""

    e: Vec3
    inverse: Sym3
    distance2: float
    log_density: float


@lean
def put_gaussian(rows: Floats, j: int, mean: Vec3, covariance: Sym3, gain: Vec3) -> None:
    """Write mean (m), covariance (m^2) and gain into a row of rows (C, WIDTH)."""
    algebra.put_vec_at(rows[j], MEAN, mean)
    algebra.put_sym_at(rows[j], COVARIANCE, covariance)
    algebra.put_vec_at(rows[j], GAIN, gain)


@lean
def seen_from(place: Vec3, r: Mat3, rows: Floats, j: int, offset: float) -> Seen:
    """Return how a Gaussian, row j of rows (C, WIDTH), is seen from a place (m) with the rotation r, body to world;
    `offset` (m) of its clock."""
    v = algebra.transposed_vec(r, algebra.vec_minus(vec_at(rows[j], MEAN), place))
    h = spherical(v)
    by_place = mat_mat(spherical_jacobian(v), transposed(r))
    h_sigma = algebra.mat_sym(by_place, sym_at(rows[j], COVARIANCE))
    by_offset = mat_vec(by_place, vec_at(rows[j], GAIN))
    return Seen(
        Spherical(h.distance + offset, h.azimuth, h.elevation), by_place, h_sigma,
        algebra.sym_product(h_sigma, transposed(by_place)), Vec3(by_offset.x + 1.0, by_offset.y, by_offset.z),
    )  # fmt: skip


@lean
def residual(seen: Seen, z: Vec3, known: Vec3) -> Vec3:
    """Return z - h, zero where it was not measured."""
    h = seen.h
    return Vec3(known.x * (z.x - h.distance), known.y * wrap(z.y - h.azimuth), known.z * (z.z - h.elevation))


@lean
def innovation(e: Vec3, spread: Sym3, variance: Vec3) -> Innovation:
    """Return the innovation e with S = spread + diag(variance)."""
    s = algebra.sym_plus(spread, Sym3(variance.x, 0.0, 0.0, variance.y, 0.0, variance.z))
    cofactors = algebra.adjugate(s)
    det = max(algebra.determinant(s, cofactors), 1e-300)
    inverse = algebra.sym_scaled(cofactors, 1.0 / det)
    distance2 = algebra.quadratic(inverse, e)
    return Innovation(e, inverse, distance2, -0.5 * (distance2 + math.log(det) + 3.0 * LOG_TURN))


@lean
def with_clock(seen: Seen, variance: float) -> Sym3:
    """Return the spread of what is seen where the clock offset has a variance (m^2), too."""
    spread: Sym3 = algebra.sym_plus(seen.spread, algebra.sym_scaled(algebra.outer(seen.by_offset), variance))
    return spread


@lean
def put_update(out: Floats, n: int, rows: Floats, j: int, seen: Seen, new: Innovation) -> None:
    """Write row j of rows (C, WIDTH), in m, into row n of `out` (P, WIDTH) as a measurement corrects it: K = Sigma
    H^T S^-1, mean + K e, Sigma - K H Sigma, and gain - K dh/db. `new` is given the clock offset."""
    k = algebra.mat_sym(transposed(seen.h_sigma), new.inverse)
    put_gaussian(
        out, n,
        algebra.vec_plus(vec_at(rows[j], MEAN), mat_vec(k, new.e)),
        algebra.sym_minus(sym_at(rows[j], COVARIANCE), algebra.sym_product(k, seen.h_sigma)),
        algebra.vec_minus(vec_at(rows[j], GAIN), mat_vec(k, seen.by_offset)),
    )  # fmt: skip


@lean
def follow(own: Map, site_of: Ints, change: Floats) -> None:
    """Let the means follow their sites' clock offsets, which have changed by `change` (S,) in m."""
    rows, names = own.rows, own.names
    for j in range(own.size[0]):
        by = change[site_of[names[j, LINK]]]
        for c in range(3):
            rows[j, MEAN + c] += rows[j, GAIN + c] * by


@lean
def forget(own: Map, site_of: Ints, kept: Floats) -> None:
    """Let clock offsets walk: of their variances P the share kept[:, 0] is left in the new ones.

    Regression on the new offset: gain' = gain kept, Sigma' = Sigma + gain gain^T P (1 - kept); `kept` (S, 2) has that
    share and P (1 - kept) in m^2; site_of (L,): indices.
    """
    rows, names = own.rows, own.names
    for j in range(own.size[0]):
        site = site_of[names[j, LINK]]
        g = vec_at(rows[j], GAIN)
        spread = algebra.sym_plus(sym_at(rows[j], COVARIANCE), algebra.sym_scaled(algebra.outer(g), kept[site, 1]))
        put_gaussian(rows, j, vec_at(rows[j], MEAN), spread, algebra.vec_scaled(g, kept[site, 0]))


@lean
def come_and_go(own: Map, stay: float, back: float) -> None:
    """Let VTs become hidden and visible again: a step of the Markov chain with these probabilities."""
    rows = own.rows
    for j in range(own.size[0]):
        visible, hidden = rows[j, VISIBLE], rows[j, HIDDEN]
        rows[j, VISIBLE] = stay * visible + back * hidden
        rows[j, HIDDEN] = (1.0 - stay) * visible + (1.0 - back) * hidden


@lean
def put_row(rows: Floats, names: Ints, j: int, source: Floats, source_names: Ints, i: int) -> None:
    """Copy row i of a source (P, WIDTH) with its names (P, NAMES), indices, into row j of rows (C, WIDTH)."""
    for c in range(WIDTH):
        rows[j, c] = source[i, c]
    names[j, LINK], names[j, NAME] = source_names[i, LINK], source_names[i, NAME]


@part
def copy_map(source: Map, target: Map) -> None:
    """Copy a map into another one."""
    count = source.size[0]
    target.size[0] = count
    target.rows[:count] = source.rows[:count]
    target.names[:count] = source.names[:count]


@part
def new_pool(most: int) -> Map:
    """Return an empty map, for Gaussians in the making, with room for so many rows (n, WIDTH)."""
    return Map(np.empty((most, WIDTH)), np.empty((most, NAMES), np.int64), np.zeros(1, np.int64))


@lean
def added(pool: Map, link: int, name: int, visible: float, hidden: float, hits: float) -> int:
    """Return the place of a new Gaussian, whose mean, covariance and gain are still to be written."""
    n = pool.size[0]
    pool.size[0] = n + 1
    pool.rows[n, VISIBLE], pool.rows[n, HIDDEN], pool.rows[n, HITS] = visible, hidden, hits
    pool.names[n, LINK], pool.names[n, NAME] = link, name
    return int(n)


@lean
def give_birth(pool: Map, place: Vec3, r: Mat3, offset: float, measured: Measured, k: int, weight: float) -> None:
    """Add the Gaussian of a VT that a measurement from a place (m), with the rotation r, may be of: Sigma = J Q J^T.

    A greater clock offset (m) brings the VT nearer.
    Without distance or azimuth, where it is could be anywhere: then none is added.
    """
    z, known, var = vec_of(measured.z[k]), vec_of(measured.known[k]), vec_of(measured.fresh[k])
    distance = z.x - offset
    if known.x == 0.0 or known.y == 0.0 or distance < LEAST_RANGE_M:
        return
    elevation, var_elevation = (z.z, var.z) if known.z > 0.0 else (0.0, UNKNOWN_ELEVATION_RAD**2)
    ahead = mat_vec(r, measurement_kernel.direction(z.y, elevation))
    j: Mat3 = mat_mat(r, measurement_kernel.cartesian_jacobian(distance, z.y, elevation))
    n = added(pool, measured.link[k], measured.born + k, weight, 0.0, 1.0)
    put_gaussian(
        pool.rows, n,
        algebra.vec_plus(place, algebra.vec_scaled(ahead, distance)),
        algebra.congruence(j, Sym3(var.x, 0.0, 0.0, var.y, 0.0, var_elevation)),
        algebra.vec_scaled(ahead, -1.0),
    )  # fmt: skip


@part
def condense(pool: Map, own: Map, place: Ints, drop: float, merge: float) -> None:
    """Take the pool's Gaussians into the map, the weightiest first: into a weightier one at one of the places in view
    (V,), which ascend, if it is within reach, else with those lighter ones that are; drop what weighs less than `drop`.

    Those in view that no measurement has changed have been compared before.
    """
    rows, names, target, target_names = pool.rows, pool.names, own.rows, own.names
    n, size, gone = pool.size[0], own.size[0], np.zeros(len(place), np.bool_)
    for v in range(len(place)):
        gone[v] = _weight(target, place[v]) < drop
    weights = rows[:n, VISIBLE] + rows[:n, HIDDEN]
    order, taken = np.argsort(-weights), weights < drop
    for a in range(n):
        i = order[a]
        if taken[i]:
            continue
        centre, host = vec_at(rows[i], MEAN), -1
        for v in range(len(place)):
            j = place[v]
            if not gone[v] and target_names[j, LINK] == names[i, LINK]:
                lighter = _weight(target, j) < weights[i]
                if lighter and _within(target, j, centre, merge):
                    gone[v] = True
                    _absorb(rows, i, target, j)
                elif not lighter and _within(rows, i, vec_at(target[j], MEAN), merge):
                    host = j
                    break
        if host >= 0:
            _absorb(target, host, rows, i)
            continue
        for b in range(a + 1, n):
            k = order[b]
            if not taken[k] and names[k, LINK] == names[i, LINK] and _within(rows, k, centre, merge):
                taken[k] = True
                _absorb(rows, i, rows, k)
        if size < len(target):
            put_row(target, target_names, size, rows, names, i)
            size += 1
    for v in range(len(place) - 1, -1, -1):
        if gone[v]:
            size -= 1
            put_row(target, target_names, place[v], target, target_names, size)
    own.size[0] = size


@lean
def _weight(rows: Floats, j: int) -> float:
    """Return how many VTs a row stands for."""
    return float(rows[j, VISIBLE] + rows[j, HIDDEN])


@lean
def _within(rows: Floats, j: int, place: Vec3, merge: float) -> bool:
    """Return whether the squared normalised distance of a place (m) from the Gaussian in a row is at most `merge`."""
    apart = algebra.vec_minus(vec_at(rows[j], MEAN), place)
    if apart.x * apart.x > merge * rows[j, COVARIANCE] or apart.y * apart.y > merge * rows[j, COVARIANCE + 3]:
        return False
    return bool(algebra.quadratic(algebra.inverse(sym_at(rows[j], COVARIANCE)), apart) <= merge)


@lean
def _absorb(rows: Floats, i: int, source: Floats, k: int) -> None:
    """Replace row i by a Gaussian of the weight, mean and covariance of itself and of row k of a source together."""
    mine, its = _weight(rows, i), _weight(source, k)
    share = its / (mine + its)
    mean, covariance, gain = vec_at(rows[i], MEAN), sym_at(rows[i], COVARIANCE), vec_at(rows[i], GAIN)
    apart = algebra.vec_minus(vec_at(source[k], MEAN), mean)
    its_covariance, its_gain = sym_at(source[k], COVARIANCE), vec_at(source[k], GAIN)
    within = algebra.sym_plus(algebra.sym_scaled(covariance, 1.0 - share), algebra.sym_scaled(its_covariance, share))
    put_gaussian(
        rows, i,
        algebra.vec_plus(mean, algebra.vec_scaled(apart, share)),
        algebra.sym_plus(within, algebra.sym_scaled(algebra.outer(apart), share * (1.0 - share))),
        algebra.vec_plus(algebra.vec_scaled(gain, 1.0 - share), algebra.vec_scaled(its_gain, share)),
    )  # fmt: skip
    rows[i, VISIBLE] += source[k, VISIBLE]
    rows[i, HIDDEN] += source[k, HIDDEN]
