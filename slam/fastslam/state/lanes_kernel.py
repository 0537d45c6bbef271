"""Compiled: what a lane has in neighbouring rows, read and written as vectors and matrices.

`rows` is flat, LANES numbers a row (see `layout`); `first`: the first of the rows; `l`: the lane. The compiler takes
vectors and matrices apart, so that a loop over lanes that reads as equations is as fast as one over numbered scalars,
as long as functions that give more than one matrix take matrices, not rows, and arrays are taken out of their tuples
before the loop.
"""

from __future__ import annotations

from typing import Any

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.state.layout import LANES, THETA, Five, Rows
from cellslam.slam.model.matrices_kernel import Mat3, Sym3, Vec3

B = LANES


@njit(error_model="numpy")
def vec_at(rows: Rows, first: int, l: int) -> Vec3:
    """Return a vector."""
    return Vec3(rows[first * B + l], rows[(first + 1) * B + l], rows[(first + 2) * B + l])


@njit(error_model="numpy")
def five_at(rows: Rows, first: int, l: int) -> Five:
    """Return the five numbers of a mean (see `spherical_vt_kernel`)."""
    return (
        rows[first * B + l], rows[(first + 1) * B + l], rows[(first + 2) * B + l],
        rows[(first + 3) * B + l], rows[(first + 4) * B + l],
    )  # fmt: skip


@njit(error_model="numpy")
def sym_at(rows: Rows, first: int, l: int) -> Sym3:
    """Return a symmetric matrix."""
    return Sym3(
        rows[first * B + l], rows[(first + 1) * B + l], rows[(first + 2) * B + l],
        rows[(first + 3) * B + l], rows[(first + 4) * B + l], rows[(first + 5) * B + l],
    )  # fmt: skip


@njit(error_model="numpy")
def mat_at(rows: Rows, first: int, l: int) -> Mat3:
    """Return a matrix."""
    return Mat3(
        rows[first * B + l], rows[(first + 1) * B + l], rows[(first + 2) * B + l],
        rows[(first + 3) * B + l], rows[(first + 4) * B + l], rows[(first + 5) * B + l],
        rows[(first + 6) * B + l], rows[(first + 7) * B + l], rows[(first + 8) * B + l],
    )  # fmt: skip


@njit(error_model="numpy")
def columns_at(rows: Rows, first: int, l: int) -> tuple[Vec3, Vec3]:
    """Return the columns of a 3 x 2 matrix."""
    return (
        Vec3(rows[first * B + l], rows[(first + 2) * B + l], rows[(first + 4) * B + l]),
        Vec3(rows[(first + 1) * B + l], rows[(first + 3) * B + l], rows[(first + 5) * B + l]),
    )


@njit(error_model="numpy")
def put(rows: Rows, first: int, l: int, values: Any) -> None:
    """Write a vector, a matrix or five numbers."""
    for i, value in enumerate(values):
        rows[(first + i) * B + l] = value


@njit(error_model="numpy")
def put_where(rows: Rows, first: int, l: int, on: bool, values: Any) -> None:
    """Write a vector, a matrix or five numbers, if `on`."""
    for i, value in enumerate(values):
        was = rows[(first + i) * B + l]
        rows[(first + i) * B + l] = value if on else was


@njit(error_model="numpy")
def theta_at(state: Rows, site: int, size: int, l: int) -> Vec3:
    """Return the mean of a site's offset, of bias and scale, of K = `size` nuisances."""
    return Vec3(state[(THETA + site) * B + l], state[(THETA + size - 2) * B + l], state[(THETA + size - 1) * B + l])


@njit(error_model="numpy")
def covariance_at(state: Rows, site: int, size: int, l: int) -> Sym3:
    """Return the covariance of a site's offset, bias and scale."""
    bias, scale = size - 2, size - 1
    return Sym3(
        state[(THETA + size * (1 + site) + site) * B + l],
        state[(THETA + size * (1 + site) + bias) * B + l],
        state[(THETA + size * (1 + site) + scale) * B + l],
        state[(THETA + size * (1 + bias) + bias) * B + l],
        state[(THETA + size * (1 + bias) + scale) * B + l],
        state[(THETA + size * (1 + scale) + scale) * B + l],
    )
