"""Compiled: the mixture after a snapshot: births, and Gaussians that are dropped or merged.

Source: Vo and Ma, "The Gaussian mixture probability hypothesis density filter", IEEE Trans. Signal Processing 54(11),
2006, table II (pruning and merging); births from measurements: Mullane et al., IEEE Trans. Robotics 27(2), 2011.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
    Vec3,
    congruence,
    inverse,
    mat_mat,
    mat_vec,
    outer,
    quadratic,
    sym_plus,
    sym_scaled,
    vec_minus,
    vec_plus,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction
from cellslam.slam.phd_slam.gaussians_kernel import (
    COVARIANCE,
    HIDDEN,
    HITS,
    LINK,
    NAME,
    NAMES,
    VISIBLE,
    WIDTH,
    Map,
    Measured,
    covariance_of,
    gain_of,
    mean_of,
    put_gaussian,
    put_row,
    vec_at,
)
from cellslam.slam.phd_slam.motion_kernel import Moved

LEAST_RANGE_M = 1.0  # a VT is born no nearer
UNKNOWN_ELEVATION_RAD = math.radians(15.0)


class Pool(NamedTuple):
    """Gaussians in the making, as of a map, and how many (1,)."""

    rows: Floats
    names: Ints
    size: Ints


@part
def new_pool(most: int) -> Pool:
    """Return an empty pool with room for so many rows (n, WIDTH)."""
    return Pool(np.empty((most, WIDTH)), np.empty((most, NAMES), np.int64), np.zeros(1, np.int64))


@lean
def added(pool: Pool, link: int, name: int, visible: float, hidden: float, hits: float) -> int:
    """Return the place of a new Gaussian, whose mean, covariance and gain are still to be written."""
    n = pool.size[0]
    pool.size[0] = n + 1
    pool.rows[n, VISIBLE], pool.rows[n, HIDDEN], pool.rows[n, HITS] = visible, hidden, hits
    pool.names[n, LINK], pool.names[n, NAME] = link, name
    return int(n)


@lean
def give_birth(pool: Pool, at: Moved, offset: float, measured: Measured, k: int, weight: float) -> None:
    """Add the Gaussian of a VT that a measurement may be of: Sigma = J Q J^T; a greater clock offset brings it nearer.

    Without distance or azimuth, where it is could be anywhere: then none is added.
    """
    z, known, var = vec_at(measured.z, k, 0), vec_at(measured.known, k, 0), vec_at(measured.fresh, k, 0)
    distance = z.x - offset
    if known.x == 0.0 or known.y == 0.0 or distance < LEAST_RANGE_M:
        return
    elevation, var_elevation = (z.z, var.z) if known.z > 0.0 else (0.0, UNKNOWN_ELEVATION_RAD**2)
    ahead = mat_vec(at.turned.r, direction(z.y, elevation))
    j: Mat3 = mat_mat(at.turned.r, cartesian_jacobian(distance, z.y, elevation))
    n = added(pool, measured.link[k], measured.born + k, weight, 0.0, 1.0)
    put_gaussian(
        pool.rows, n,
        vec_plus(at.place, vec_scaled(ahead, distance)),
        congruence(j, Sym3(var.x, 0.0, 0.0, var.y, 0.0, var_elevation)),
        vec_scaled(ahead, -1.0),
    )  # fmt: skip


@part
def condense(pool: Pool, own: Map, place: Ints, drop: float, merge: float) -> None:
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
        centre, host = mean_of(rows, i), -1
        for v in range(len(place)):
            j = place[v]
            if not gone[v] and target_names[j, LINK] == names[i, LINK]:
                lighter = _weight(target, j) < weights[i]
                if lighter and _within(target, j, centre, merge):
                    gone[v] = True
                    _absorb(rows, i, target, j)
                elif not lighter and _within(rows, i, mean_of(target, j), merge):
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
    apart = vec_minus(mean_of(rows, j), place)
    if apart.x * apart.x > merge * rows[j, COVARIANCE] or apart.y * apart.y > merge * rows[j, COVARIANCE + 3]:
        return False
    return bool(quadratic(inverse(covariance_of(rows, j)), apart) <= merge)


@lean
def _absorb(rows: Floats, i: int, source: Floats, k: int) -> None:
    """Replace row i by a Gaussian of the weight, mean and covariance of itself and of row k of a source together."""
    mine, its = _weight(rows, i), _weight(source, k)
    share = its / (mine + its)
    apart = vec_minus(mean_of(source, k), mean_of(rows, i))
    within = sym_plus(sym_scaled(covariance_of(rows, i), 1.0 - share), sym_scaled(covariance_of(source, k), share))
    put_gaussian(
        rows, i,
        vec_plus(mean_of(rows, i), vec_scaled(apart, share)),
        sym_plus(within, sym_scaled(outer(apart), share * (1.0 - share))),
        vec_plus(vec_scaled(gain_of(rows, i), 1.0 - share), vec_scaled(gain_of(source, k), share)),
    )  # fmt: skip
    rows[i, VISIBLE] += source[k, VISIBLE]
    rows[i, HIDDEN] += source[k, HIDDEN]
