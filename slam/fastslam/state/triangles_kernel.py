"""Compiled algebra of four dimensions: vectors and triangular matrices as named tuples of scalars."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.state.layout import LANES, Rows

B = LANES


class Vec4(NamedTuple):
    """A vector."""

    a: Any
    b: Any
    c: Any
    d: Any


class Tri4(NamedTuple):
    """The lower triangle of a 4 x 4 matrix, by rows: of a triangular or of a symmetric one."""

    aa: Any
    ba: Any
    bb: Any
    ca: Any
    cb: Any
    cc: Any
    da: Any
    db: Any
    dc: Any
    dd: Any


@njit(error_model="numpy")
def vec4_at(rows: Rows, first: int, l: int) -> Vec4:
    """Return a vector of lane l."""
    i = first * B + l
    return Vec4(rows[i], rows[i + B], rows[i + 2 * B], rows[i + 3 * B])


@njit(error_model="numpy")
def triangle_at(rows: Rows, first: int, l: int) -> Tri4:
    """Return the lower triangle of a matrix of lane l, all of which has rows."""
    i = first * B + l
    return Tri4(
        rows[i],
        rows[i + 4 * B], rows[i + 5 * B],
        rows[i + 8 * B], rows[i + 9 * B], rows[i + 10 * B],
        rows[i + 12 * B], rows[i + 13 * B], rows[i + 14 * B], rows[i + 15 * B],
    )  # fmt: skip


@njit(error_model="numpy")
def dot4(x: Vec4, y: Vec4) -> Any:
    """Return x^T y."""
    return x.a * y.a + x.b * y.b + x.c * y.c + x.d * y.d


@njit(error_model="numpy")
def reciprocal(x: Any) -> Any:
    """Return 1 / x, 0 where x is 0."""
    return 1.0 / x if x > 1e-150 else 0.0


@njit(error_model="numpy")
def cholesky(s: Tri4) -> Tri4:
    """Return L of s = L L^T; a zero pivot gives a zero column."""
    aa = math.sqrt(max(s.aa, 0.0))
    r = reciprocal(aa)
    ba, ca, da = s.ba * r, s.ca * r, s.da * r
    bb = math.sqrt(max(s.bb - ba * ba, 0.0))
    r = reciprocal(bb)
    cb, db = (s.cb - ca * ba) * r, (s.db - da * ba) * r
    cc = math.sqrt(max(s.cc - ca * ca - cb * cb, 0.0))
    dc = (s.dc - da * ca - db * cb) * reciprocal(cc)
    return Tri4(aa, ba, bb, ca, cb, cc, da, db, dc, math.sqrt(max(s.dd - da * da - db * db - dc * dc, 0.0)))


@njit(error_model="numpy")
def forward(c: Tri4, v: Vec4) -> Vec4:
    """Return c^-1 v for triangular c."""
    x = v.a * reciprocal(c.aa)
    y = (v.b - c.ba * x) * reciprocal(c.bb)
    z = (v.c - c.ca * x - c.cb * y) * reciprocal(c.cc)
    return Vec4(x, y, z, (v.d - c.da * x - c.db * y - c.dc * z) * reciprocal(c.dd))


@njit(error_model="numpy")
def one_and_congruence(s: Tri4, m: Tri4) -> Tri4:
    """Return 1 + m^T s m for symmetric s and triangular m."""
    p = Tri4(  # of s m
        s.aa * m.aa + s.ba * m.ba + s.ca * m.ca + s.da * m.da,
        s.ba * m.aa + s.bb * m.ba + s.cb * m.ca + s.db * m.da, s.bb * m.bb + s.cb * m.cb + s.db * m.db,
        s.ca * m.aa + s.cb * m.ba + s.cc * m.ca + s.dc * m.da, s.cb * m.bb + s.cc * m.cb + s.dc * m.db,
        s.cc * m.cc + s.dc * m.dc,
        s.da * m.aa + s.db * m.ba + s.dc * m.ca + s.dd * m.da, s.db * m.bb + s.dc * m.cb + s.dd * m.db,
        s.dc * m.cc + s.dd * m.dc, s.dd * m.dd,
    )  # fmt: skip
    return Tri4(
        1.0 + m.aa * p.aa + m.ba * p.ba + m.ca * p.ca + m.da * p.da,
        m.bb * p.ba + m.cb * p.ca + m.db * p.da, 1.0 + m.bb * p.bb + m.cb * p.cb + m.db * p.db,
        m.cc * p.ca + m.dc * p.da, m.cc * p.cb + m.dc * p.db, 1.0 + m.cc * p.cc + m.dc * p.dc,
        m.dd * p.da, m.dd * p.db, m.dd * p.dc, 1.0 + m.dd * p.dd,
    )  # fmt: skip
