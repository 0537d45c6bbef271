"""Compiled: the map of a particle, a mixture of Gaussians, and how one of them is seen.

A Gaussian has two weights, of a VT that can be seen now and of one that is hidden (a Markov chain of two states). Given
the clock offset b of its site, a VT is at mean + gain (b - its estimate), with covariance.

Sources: Vo and Ma, "The Gaussian mixture probability hypothesis density filter", IEEE Trans. Signal Processing 54(11),
2006; Mullane, Vo, Adams and Vo, "A random-finite-set approach to Bayesian SLAM", IEEE Trans. Robotics 27(2), 2011;
Pasha, Vo, Tuan and Ma, "A Gaussian mixture PHD filter for jump Markov system models", IEEE Trans. AES 45(3), 2009.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellslam.sim.compiling import lean, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
    Vec3,
    adjugate,
    determinant,
    mat_mat,
    mat_sym,
    mat_vec,
    outer,
    quadratic,
    sym_minus,
    sym_plus,
    sym_product,
    sym_scaled,
    transposed,
    transposed_vec,
    vec_minus,
    vec_plus,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import Spherical, spherical, spherical_jacobian

# A row of a map: mean (3), covariance (6, by rows of its upper triangle), gain (3), weights, detections.
MEAN, COVARIANCE, GAIN, VISIBLE, HIDDEN, HITS, WIDTH = 0, 3, 9, 12, 13, 14, 15
LINK, NAME, NAMES = 0, 1, 2
MISSING = 1e12  # variance, in m^2 or rad^2, of a component that was not measured
LOG_TURN = math.log(2.0 * math.pi)


class Map(NamedTuple):
    """Gaussians of a particle (C, WIDTH) with their links and identities (C, NAMES), and how many there are (1,); of N
    particles the same behind an axis N."""

    rows: Floats
    names: Ints
    size: Ints


class Measured(NamedTuple):
    """A snapshot: z (M, 3) in m and rad, 0 where not measured, known (M, 3): 1 or 0; variances (M, 3) of one
    measurement, of an update, of a birth; `gain` (M,): log of what a density of it over that of clutter lacks; link
    (M,); begins (M,); `born`: identity that the first one may give to a VT."""

    z: Floats
    known: Floats
    single: Floats
    many: Floats
    fresh: Floats
    gain: Floats
    link: Ints
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
def vec_at(a: Floats, i: int, first: int) -> Vec3:
    """Return three neighbours in row i of an array (n, k), of any unit, as a vector."""
    return Vec3(a[i, first], a[i, first + 1], a[i, first + 2])


@lean
def mean_of(rows: Floats, j: int) -> Vec3:
    """Return the mean (m) of a row of rows (C, WIDTH)."""
    return Vec3(rows[j, MEAN], rows[j, MEAN + 1], rows[j, MEAN + 2])


@lean
def covariance_of(rows: Floats, j: int) -> Sym3:
    """Return the covariance (m^2) of a row of rows (C, WIDTH), given the clock offset."""
    c = COVARIANCE
    return Sym3(rows[j, c], rows[j, c + 1], rows[j, c + 2], rows[j, c + 3], rows[j, c + 4], rows[j, c + 5])


@lean
def trace_of(rows: Floats, j: int) -> float:
    """Return the trace (m^2) of the covariance of a row of rows (C, WIDTH)."""
    return float(rows[j, COVARIANCE] + rows[j, COVARIANCE + 3] + rows[j, COVARIANCE + 5])


@lean
def gain_of(rows: Floats, j: int) -> Vec3:
    """Return d(place)/d(clock offset), in m/m, of a row of rows (C, WIDTH)."""
    return Vec3(rows[j, GAIN], rows[j, GAIN + 1], rows[j, GAIN + 2])


@lean
def put_gaussian(rows: Floats, j: int, mean: Vec3, covariance: Sym3, gain: Vec3) -> None:
    """Write mean (m), covariance (m^2) and gain into a row of rows (C, WIDTH)."""
    rows[j, MEAN], rows[j, MEAN + 1], rows[j, MEAN + 2] = mean.x, mean.y, mean.z
    c = COVARIANCE
    rows[j, c], rows[j, c + 1], rows[j, c + 2] = covariance.xx, covariance.xy, covariance.xz
    rows[j, c + 3], rows[j, c + 4], rows[j, c + 5] = covariance.yy, covariance.yz, covariance.zz
    rows[j, GAIN], rows[j, GAIN + 1], rows[j, GAIN + 2] = gain.x, gain.y, gain.z


@lean
def seen_from(place: Vec3, r: Mat3, rows: Floats, j: int, offset: float) -> Seen:
    """Return how a Gaussian, row j of rows (C, WIDTH), is seen from a place (m) with the rotation r, body to world;
    `offset` (m) of its clock."""
    v = transposed_vec(r, vec_minus(mean_of(rows, j), place))
    h = spherical(v)
    by_place = mat_mat(spherical_jacobian(v), transposed(r))
    h_sigma = mat_sym(by_place, covariance_of(rows, j))
    by_offset = mat_vec(by_place, gain_of(rows, j))
    return Seen(
        Spherical(h.distance + offset, h.azimuth, h.elevation), by_place, h_sigma,
        sym_product(h_sigma, transposed(by_place)), Vec3(by_offset.x + 1.0, by_offset.y, by_offset.z),
    )  # fmt: skip


@lean
def residual(seen: Seen, z: Vec3, known: Vec3) -> Vec3:
    """Return z - h, zero where it was not measured."""
    h = seen.h
    return Vec3(known.x * (z.x - h.distance), known.y * wrap(z.y - h.azimuth), known.z * (z.z - h.elevation))


@lean
def innovation(e: Vec3, spread: Sym3, variance: Vec3) -> Innovation:
    """Return the innovation e with S = spread + diag(variance)."""
    s = sym_plus(spread, Sym3(variance.x, 0.0, 0.0, variance.y, 0.0, variance.z))
    cofactors = adjugate(s)
    det = max(determinant(s, cofactors), 1e-300)
    inverse = sym_scaled(cofactors, 1.0 / det)
    distance2 = quadratic(inverse, e)
    return Innovation(e, inverse, distance2, -0.5 * (distance2 + math.log(det) + 3.0 * LOG_TURN))


@lean
def with_clock(seen: Seen, variance: float) -> Sym3:
    """Return the spread of what is seen where the clock offset has a variance (m^2), too."""
    spread: Sym3 = sym_plus(seen.spread, sym_scaled(outer(seen.by_offset), variance))
    return spread


@lean
def put_update(out: Floats, n: int, rows: Floats, j: int, seen: Seen, new: Innovation) -> None:
    """Write row j of rows (C, WIDTH), in m, into row n of `out` (P, WIDTH) as a measurement corrects it: K = Sigma
    H^T S^-1, mean + K e, Sigma - K H Sigma, and gain - K dh/db. `new` is given the clock offset."""
    k = mat_sym(transposed(seen.h_sigma), new.inverse)
    put_gaussian(
        out, n,
        vec_plus(mean_of(rows, j), mat_vec(k, new.e)),
        sym_minus(covariance_of(rows, j), sym_product(k, seen.h_sigma)),
        vec_minus(gain_of(rows, j), mat_vec(k, seen.by_offset)),
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
        g = gain_of(rows, j)
        spread = sym_plus(covariance_of(rows, j), sym_scaled(outer(g), kept[site, 1]))
        put_gaussian(rows, j, mean_of(rows, j), spread, vec_scaled(g, kept[site, 0]))


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
