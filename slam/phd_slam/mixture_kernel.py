"""Compiled: the mixture after a snapshot: births, and Gaussians that are dropped or merged.

Source: Vo and Ma, "The Gaussian mixture probability hypothesis density filter", IEEE Trans. Signal Processing 54(11),
2006, table II (pruning and merging); births from measurements: Mullane et al., IEEE Trans. Robotics 27(2), 2011.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
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
    MEAN,
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
AROUND, GUESSES, NEAREST_GUESS_M = 24, 7, 15.0  # of a lone distance or a lone azimuth
APART = 0.3  # deviation of a guess over its distance from the next one
SETTLING = 20.0  # detections after which a guess that has not been refuted counts as found
UNKNOWN_ELEVATION_RAD = math.radians(15.0)


class Pool(NamedTuple):
    """Gaussians in the making, as of a map, and how many (1,)."""

    rows: Floats
    names: Ints
    size: Ints


@njit(cache=True)
def new_pool(most: int) -> Pool:
    """Return an empty pool with room for so many rows (n, WIDTH)."""
    return Pool(np.empty((most, WIDTH)), np.empty((most, NAMES), np.int64), np.zeros(1, np.int64))


@njit
def added(pool: Pool, link: int, name: int, visible: float, hidden: float, hits: float) -> int:
    """Return the place of a new Gaussian, whose mean, covariance and gain are still to be written."""
    n = pool.size[0]
    pool.size[0] = n + 1
    pool.rows[n, VISIBLE], pool.rows[n, HIDDEN], pool.rows[n, HITS] = visible, hidden, hits
    pool.names[n, LINK], pool.names[n, NAME] = link, name
    return int(n)


@njit(cache=True)
def give_birth(pool: Pool, at: Moved, offset: float, span: float, measured: Measured, k: int, weight: float) -> None:
    """Add the Gaussians of a VT that a measurement may be of, with `weight` in all: one, or, where the distance or the
    azimuth is missing, as many guesses as go round the field of view or up to its end.

    Guesses have a negative number of detections until they have settled.
    """
    z, known, var = vec_at(measured.z, k, 0), vec_at(measured.known, k, 0), vec_at(measured.fresh, k, 0)
    elevation, var_elevation = (z.z, var.z) if known.z > 0.0 else (0.0, UNKNOWN_ELEVATION_RAD**2)
    distance = z.x - offset
    if known.x > 0.0 and distance < LEAST_RANGE_M:
        return
    if known.x > 0.0 and known.y > 0.0:
        _born(pool, at, measured, k, (distance, z.y, elevation), (var.x, var.y, var_elevation), weight, 1.0)
    elif known.x > 0.0:
        step = 2.0 * span / AROUND
        for i in range(AROUND):
            guess = distance, (i + 0.5) * step - span, elevation
            _born(pool, at, measured, k, guess, (var.x, (APART * step) ** 2, var_elevation), weight / AROUND, -SETTLING)
    elif known.y > 0.0:
        for i in range(GUESSES):
            far = NEAREST_GUESS_M * 2.0**i
            guess = far, z.y, elevation
            _born(pool, at, measured, k, guess, ((APART * far) ** 2, var.y, var_elevation), weight / GUESSES, -SETTLING)


@njit
def _born(
    pool: Pool, at: Moved, measured: Measured, k: int, z: tuple[float, float, float], var: tuple[float, float, float],
    weight: float, hits: float,
) -> None:  # fmt: skip
    """Add the Gaussian of a measurement: Sigma = J Q J^T; a greater clock offset brings it nearer."""
    ahead = mat_vec(at.turned.r, direction(z[1], z[2]))
    j: Mat3 = mat_mat(at.turned.r, cartesian_jacobian(z[0], z[1], z[2]))
    n = added(pool, measured.link[k], measured.born + k, weight, 0.0, hits)
    put_gaussian(
        pool.rows, n,
        vec_plus(at.place, vec_scaled(ahead, z[0])),
        congruence(j, Sym3(var[0], 0.0, 0.0, var[1], 0.0, var[2])),
        vec_scaled(ahead, -measured.known[k, 0]),
    )  # fmt: skip


@njit(cache=True)
def condense(pool: Pool, own: Map, drop: float, merge: float) -> None:
    """Move the pool's Gaussians into the map, the weightiest first, each with those that lie within its reach; drop
    what weighs less than `drop`, and what there is no room for."""
    rows, names, target, target_names = pool.rows, pool.names, own.rows, own.names
    n, size = 0, own.size[0]
    weights = rows[: pool.size[0], VISIBLE] + rows[: pool.size[0], HIDDEN]
    order, taken = np.argsort(-weights), np.zeros(len(weights), np.bool_)
    x, y, wide_x, wide_y = np.empty(len(order)), np.empty(len(order)), np.empty(len(order)), np.empty(len(order))
    for i in order:
        if weights[i] < drop:
            break
        x[n], wide_x[n] = rows[i, MEAN], merge * rows[i, COVARIANCE]
        y[n], wide_y[n] = rows[i, MEAN + 1], merge * rows[i, COVARIANCE + 3]
        n += 1
    for a in range(n):
        if taken[a] or size == len(target):
            continue
        i, east, north = order[a], x[a], y[a]
        centre = mean_of(rows, i)
        for b in range(a + 1, n):
            dx, dy = x[b] - east, y[b] - north
            if dx * dx > wide_x[b] or dy * dy > wide_y[b] or taken[b]:
                continue
            k = order[b]
            apart = vec_minus(mean_of(rows, k), centre)
            if names[k, LINK] == names[i, LINK] and quadratic(inverse(covariance_of(rows, k)), apart) <= merge:
                taken[b] = True
                _absorb(rows, i, k)
        put_row(target, target_names, size, rows, names, i)
        size += 1
    own.size[0] = size


@njit(cache=True)
def _absorb(rows: Floats, i: int, k: int) -> None:
    """Replace two Gaussians by one of their weight, mean and covariance, in row i."""
    mine, its = rows[i, VISIBLE] + rows[i, HIDDEN], rows[k, VISIBLE] + rows[k, HIDDEN]
    share = its / (mine + its)
    apart = vec_minus(mean_of(rows, k), mean_of(rows, i))
    within = sym_plus(sym_scaled(covariance_of(rows, i), 1.0 - share), sym_scaled(covariance_of(rows, k), share))
    put_gaussian(
        rows, i,
        vec_plus(mean_of(rows, i), vec_scaled(apart, share)),
        sym_plus(within, sym_scaled(outer(apart), share * (1.0 - share))),
        vec_plus(vec_scaled(gain_of(rows, i), 1.0 - share), vec_scaled(gain_of(rows, k), share)),
    )  # fmt: skip
    rows[i, VISIBLE] += rows[k, VISIBLE]
    rows[i, HIDDEN] += rows[k, HIDDEN]
