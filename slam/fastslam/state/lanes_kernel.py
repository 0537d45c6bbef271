"""Compiled: what a lane has in neighbouring rows, read and written as vectors and matrices.

`rows` is flat, LANES numbers a row (see `layout`); `first`: the first of the rows; `l`: the lane.
"""

from __future__ import annotations

from typing import Any

from numba import njit

from cellslam.slam.fastslam.state.layout import LANES, THETA, Five, Rows
from cellslam.slam.model.matrices_kernel import Mat3, Sym3, Vec3

B = LANES


@njit
def vec_at(rows: Rows, first: int, l: int) -> Vec3:
    """Return a vector."""
    return Vec3(rows[first * B + l], rows[(first + 1) * B + l], rows[(first + 2) * B + l])


@njit
def five_at(rows: Rows, first: int, l: int) -> Five:
    """Return the five numbers of a mean (see `parts.landmarks`)."""
    i = first * B + l
    return rows[i], rows[i + B], rows[i + 2 * B], rows[i + 3 * B], rows[i + 4 * B]


@njit
def sym_at(rows: Rows, first: int, l: int) -> Sym3:
    """Return a symmetric matrix."""
    i = first * B + l
    return Sym3(rows[i], rows[i + B], rows[i + 2 * B], rows[i + 3 * B], rows[i + 4 * B], rows[i + 5 * B])


@njit
def mat_at(rows: Rows, first: int, l: int) -> Mat3:
    """Return a matrix."""
    i = first * B + l
    return Mat3(
        rows[i], rows[i + B], rows[i + 2 * B],
        rows[i + 3 * B], rows[i + 4 * B], rows[i + 5 * B],
        rows[i + 6 * B], rows[i + 7 * B], rows[i + 8 * B],
    )  # fmt: skip


@njit
def columns_at(rows: Rows, first: int, l: int) -> tuple[Vec3, Vec3]:
    """Return the columns of a 3 x 2 matrix."""
    i = first * B + l
    return Vec3(rows[i], rows[i + 2 * B], rows[i + 4 * B]), Vec3(rows[i + B], rows[i + 3 * B], rows[i + 5 * B])


@njit
def put(rows: Rows, first: int, l: int, values: Any) -> None:
    """Write a vector, a matrix or five numbers."""
    for i, value in enumerate(values):
        rows[(first + i) * B + l] = value


@njit
def add_where(rows: Rows, first: int, l: int, on: bool, values: Any) -> None:
    """Add a vector or a matrix, if `on`."""
    for i, value in enumerate(values):
        was = rows[(first + i) * B + l]
        rows[(first + i) * B + l] = was + value if on else was


@njit
def put_where(rows: Rows, first: int, l: int, on: bool, values: Any) -> None:
    """Write a vector, a matrix or five numbers, if `on`."""
    for i, value in enumerate(values):
        was = rows[(first + i) * B + l]
        rows[(first + i) * B + l] = value if on else was


@njit
def theta_at(state: Rows, site: int, size: int, l: int) -> Vec3:
    """Return the mean of a site's offset, of bias and scale, of K = `size` nuisances."""
    return Vec3(state[(THETA + site) * B + l], state[(THETA + size - 2) * B + l], state[(THETA + size - 1) * B + l])


@njit
def covariance_at(state: Rows, site: int, size: int, l: int) -> Sym3:
    """Return the covariance of a site's offset, bias and scale."""
    bias, scale = size - 2, size - 1
    by_site, by_bias, by_scale = THETA + size * (1 + site), THETA + size * (1 + bias), THETA + size * (1 + scale)
    return Sym3(
        state[(by_site + site) * B + l], state[(by_site + bias) * B + l], state[(by_site + scale) * B + l],
        state[(by_bias + bias) * B + l], state[(by_bias + scale) * B + l], state[(by_scale + scale) * B + l],
    )  # fmt: skip
