"""Compiled algebra of three dimensions: vectors and 3 x 3 matrices as named tuples of scalars.

A kernel written with them reads as its equations. Numba takes the tuples apart, so that it runs as fast as one written
with numbered scalars. The functions work in the precision of what they are given.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from cellslam.sim.compiling import njit


class Vec3(NamedTuple):
    """A vector."""

    x: Any
    y: Any
    z: Any


class Sym3(NamedTuple):
    """A symmetric 3 x 3 matrix: its upper triangle by rows."""

    xx: Any
    xy: Any
    xz: Any
    yy: Any
    yz: Any
    zz: Any


class Mat3(NamedTuple):
    """A 3 x 3 matrix by rows."""

    xx: Any
    xy: Any
    xz: Any
    yx: Any
    yy: Any
    yz: Any
    zx: Any
    zy: Any
    zz: Any


@njit
def dot(a: Vec3, b: Vec3) -> Any:
    """Return a^T b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@njit
def mat_vec(m: Mat3, v: Vec3) -> Vec3:
    """Return m v."""
    return Vec3(
        m.xx * v.x + m.xy * v.y + m.xz * v.z, m.yx * v.x + m.yy * v.y + m.yz * v.z, m.zx * v.x + m.zy * v.y + m.zz * v.z
    )


@njit
def transposed_vec(m: Mat3, v: Vec3) -> Vec3:
    """Return m^T v."""
    return Vec3(
        m.xx * v.x + m.yx * v.y + m.zx * v.z, m.xy * v.x + m.yy * v.y + m.zy * v.z, m.xz * v.x + m.yz * v.y + m.zz * v.z
    )


@njit
def sym_vec(s: Sym3, v: Vec3) -> Vec3:
    """Return s v."""
    return Vec3(
        s.xx * v.x + s.xy * v.y + s.xz * v.z, s.xy * v.x + s.yy * v.y + s.yz * v.z, s.xz * v.x + s.yz * v.y + s.zz * v.z
    )


@njit
def mat_sym(m: Mat3, s: Sym3) -> Mat3:
    """Return m s."""
    return Mat3(
        m.xx * s.xx + m.xy * s.xy + m.xz * s.xz,
        m.xx * s.xy + m.xy * s.yy + m.xz * s.yz,
        m.xx * s.xz + m.xy * s.yz + m.xz * s.zz,
        m.yx * s.xx + m.yy * s.xy + m.yz * s.xz,
        m.yx * s.xy + m.yy * s.yy + m.yz * s.yz,
        m.yx * s.xz + m.yy * s.yz + m.yz * s.zz,
        m.zx * s.xx + m.zy * s.xy + m.zz * s.xz,
        m.zx * s.xy + m.zy * s.yy + m.zz * s.yz,
        m.zx * s.xz + m.zy * s.yz + m.zz * s.zz,
    )


@njit
def mat_mat(a: Mat3, b: Mat3) -> Mat3:
    """Return a b."""
    return Mat3(
        a.xx * b.xx + a.xy * b.yx + a.xz * b.zx,
        a.xx * b.xy + a.xy * b.yy + a.xz * b.zy,
        a.xx * b.xz + a.xy * b.yz + a.xz * b.zz,
        a.yx * b.xx + a.yy * b.yx + a.yz * b.zx,
        a.yx * b.xy + a.yy * b.yy + a.yz * b.zy,
        a.yx * b.xz + a.yy * b.yz + a.yz * b.zz,
        a.zx * b.xx + a.zy * b.yx + a.zz * b.zx,
        a.zx * b.xy + a.zy * b.yy + a.zz * b.zy,
        a.zx * b.xz + a.zy * b.yz + a.zz * b.zz,
    )


@njit
def transposed(m: Mat3) -> Mat3:
    """Return m^T."""
    return Mat3(m.xx, m.yx, m.zx, m.xy, m.yy, m.zy, m.xz, m.yz, m.zz)


@njit
def sym_product(a: Mat3, b: Mat3) -> Sym3:
    """Return a b, a product that is symmetric."""
    return Sym3(
        a.xx * b.xx + a.xy * b.yx + a.xz * b.zx,
        a.xx * b.xy + a.xy * b.yy + a.xz * b.zy,
        a.xx * b.xz + a.xy * b.yz + a.xz * b.zz,
        a.yx * b.xy + a.yy * b.yy + a.yz * b.zy,
        a.yx * b.xz + a.yy * b.yz + a.yz * b.zz,
        a.zx * b.xz + a.zy * b.yz + a.zz * b.zz,
    )


@njit
def congruence(m: Mat3, s: Sym3) -> Sym3:
    """Return m s m^T."""
    product: Sym3 = sym_product(mat_sym(m, s), transposed(m))
    return product


@njit
def scaled(m: Mat3, x: Any) -> Mat3:
    """Return m x, x a scalar."""
    return Mat3(m.xx * x, m.xy * x, m.xz * x, m.yx * x, m.yy * x, m.yz * x, m.zx * x, m.zy * x, m.zz * x)


@njit
def mat_minus(a: Mat3, b: Mat3) -> Mat3:
    """Return a - b."""
    return Mat3(
        a.xx - b.xx, a.xy - b.xy, a.xz - b.xz,
        a.yx - b.yx, a.yy - b.yy, a.yz - b.yz,
        a.zx - b.zx, a.zy - b.zy, a.zz - b.zz,
    )  # fmt: skip


@njit
def sym_minus(a: Sym3, b: Sym3) -> Sym3:
    """Return a - b."""
    return Sym3(a.xx - b.xx, a.xy - b.xy, a.xz - b.xz, a.yy - b.yy, a.yz - b.yz, a.zz - b.zz)


@njit
def sym_plus(a: Sym3, b: Sym3) -> Sym3:
    """Return a + b."""
    return Sym3(a.xx + b.xx, a.xy + b.xy, a.xz + b.xz, a.yy + b.yy, a.yz + b.yz, a.zz + b.zz)


@njit
def vec_minus(a: Vec3, b: Vec3) -> Vec3:
    """Return a - b."""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@njit
def vec_plus(a: Vec3, b: Vec3) -> Vec3:
    """Return a + b."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@njit
def adjugate(s: Sym3) -> Sym3:
    """Return the adjugate of s: its inverse times its determinant."""
    return Sym3(
        s.yy * s.zz - s.yz * s.yz,
        s.xz * s.yz - s.xy * s.zz,
        s.xy * s.yz - s.xz * s.yy,
        s.xx * s.zz - s.xz * s.xz,
        s.xz * s.xy - s.xx * s.yz,
        s.xx * s.yy - s.xy * s.xy,
    )


@njit
def quadratic(s: Sym3, v: Vec3) -> Any:
    """Return v^T s v."""
    crossed = s.xy * v.x * v.y + s.xz * v.x * v.z + s.yz * v.y * v.z
    return s.xx * v.x * v.x + s.yy * v.y * v.y + s.zz * v.z * v.z + (crossed + crossed)


@njit
def vec_scaled(v: Vec3, x: Any) -> Vec3:
    """Return v x, x a scalar."""
    return Vec3(v.x * x, v.y * x, v.z * x)


@njit
def sym_scaled(s: Sym3, x: Any) -> Sym3:
    """Return s x, x a scalar."""
    return Sym3(s.xx * x, s.xy * x, s.xz * x, s.yy * x, s.yz * x, s.zz * x)


@njit
def outer_sum(a: Vec3, b: Vec3) -> Sym3:
    """Return a b^T + b a^T."""
    return Sym3(
        2.0 * a.x * b.x, a.x * b.y + a.y * b.x, a.x * b.z + a.z * b.x,
        2.0 * a.y * b.y, a.y * b.z + a.z * b.y, 2.0 * a.z * b.z,
    )  # fmt: skip


@njit
def rotation(psi: Any, theta: Any, phi: Any) -> Mat3:
    """Return Rz(psi) Ry(theta) Rx(phi), which takes body to world vectors; quickly where pitch and roll are zero."""
    cp, sp, ct, st, cr, sr = math.cos(psi), math.sin(psi), 1.0, 0.0, 1.0, 0.0
    if theta != 0.0 or phi != 0.0:
        ct, st, cr, sr = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
    return Mat3(
        cp * ct, cp * st * sr - sp * cr, cp * st * cr + sp * sr,
        sp * ct, sp * st * sr + cp * cr, sp * st * cr - cp * sr,
        -st, ct * sr, ct * cr,
    )  # fmt: skip


@njit
def determinant(s: Sym3, adjugate_of_s: Sym3) -> Any:
    """Return det s, with its adjugate."""
    return s.xx * adjugate_of_s.xx + s.xy * adjugate_of_s.xy + s.xz * adjugate_of_s.xz


@njit
def outer(v: Vec3) -> Sym3:
    """Return v v^T."""
    return Sym3(v.x * v.x, v.x * v.y, v.x * v.z, v.y * v.y, v.y * v.z, v.z * v.z)


@njit
def inverse(s: Sym3) -> Sym3:
    """Return s^-1."""
    a = adjugate(s)
    det = determinant(s, a)
    return Sym3(a.xx / det, a.xy / det, a.xz / det, a.yy / det, a.yz / det, a.zz / det)


class Lower3(NamedTuple):
    """A lower triangular 3 x 3 matrix by rows."""

    xx: Any
    yx: Any
    yy: Any
    zx: Any
    zy: Any
    zz: Any


@njit
def cholesky(s: Sym3) -> Lower3:
    """Return L with L L^T = s; all zero where s is not positive definite."""
    if s.xx > 0.0:
        a = math.sqrt(s.xx)
        b, c = s.xy / a, s.xz / a
        dd = s.yy - b * b
        if dd > 0.0:
            d = math.sqrt(dd)
            e = (s.yz - b * c) / d
            ff = s.zz - c * c - e * e
            if ff > 0.0:
                return Lower3(a, b, d, c, e, math.sqrt(ff))
    return Lower3(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@njit
def solved(lower: Lower3, v: Vec3) -> Vec3:
    """Return L^-1 v."""
    x = v.x / lower.xx
    y = (v.y - lower.yx * x) / lower.yy
    return Vec3(x, y, (v.z - lower.zx * x - lower.zy * y) / lower.zz)


@njit
def mat_of(a: Any) -> Mat3:
    """Return an array (3, 3) as a matrix."""
    return Mat3(a[0, 0], a[0, 1], a[0, 2], a[1, 0], a[1, 1], a[1, 2], a[2, 0], a[2, 1], a[2, 2])


@njit
def vec_of(a: Any) -> Vec3:
    """Return an array (3,) as a vector."""
    return Vec3(a[0], a[1], a[2])


@njit
def columns(a: Vec3, b: Vec3, c: Vec3) -> Mat3:
    """Return the matrix of three columns."""
    return Mat3(a.x, b.x, c.x, a.y, b.y, c.y, a.z, b.z, c.z)


@njit
def put_mat(out: Any, m: Mat3) -> None:
    """Write a matrix into the first three rows and columns of an array."""
    out[0, 0], out[0, 1], out[0, 2] = m.xx, m.xy, m.xz
    out[1, 0], out[1, 1], out[1, 2] = m.yx, m.yy, m.yz
    out[2, 0], out[2, 1], out[2, 2] = m.zx, m.zy, m.zz


@njit
def put_sym(out: Any, s: Sym3) -> None:
    """Write a symmetric matrix into an array (3, 3)."""
    out[0, 0], out[1, 1], out[2, 2] = s.xx, s.yy, s.zz
    out[0, 1] = out[1, 0] = s.xy
    out[0, 2] = out[2, 0] = s.xz
    out[1, 2] = out[2, 1] = s.yz


class Mat32(NamedTuple):
    """A 3 x 2 matrix: its columns."""

    a: Vec3
    b: Vec3


@njit
def mat32_minus(m: Mat32, n: Mat32) -> Mat32:
    """Return m - n."""
    return Mat32(vec_minus(m.a, n.a), vec_minus(m.b, n.b))


@njit
def mat_mat32(m: Mat3, n: Mat32) -> Mat32:
    """Return m n."""
    return Mat32(mat_vec(m, n.a), mat_vec(m, n.b))


@njit
def congruence32(m: Mat32, p: Any) -> Sym3:
    """Return m P m^T; p (3,): the upper triangle of P."""
    crossed: Sym3 = sym_scaled(outer_sum(m.a, m.b), p[1])
    return sym_plus(crossed, sym_plus(sym_scaled(outer(m.a), p[0]), sym_scaled(outer(m.b), p[2])))


@njit
def vec_at(a: Any, i: int) -> Vec3:
    """Return three neighbours in an array (n,), from i on, as a vector."""
    return Vec3(a[i], a[i + 1], a[i + 2])


@njit
def put_vec_at(a: Any, i: int, v: Vec3) -> None:
    """Write a vector into an array (n,), from i on."""
    a[i], a[i + 1], a[i + 2] = v.x, v.y, v.z


@njit
def sym_at(a: Any, i: int) -> Sym3:
    """Return six neighbours in an array (n,), from i on, as the upper triangle of a symmetric matrix."""
    return Sym3(a[i], a[i + 1], a[i + 2], a[i + 3], a[i + 4], a[i + 5])


@njit
def put_sym_at(a: Any, i: int, s: Sym3) -> None:
    """Write the upper triangle of a symmetric matrix into an array (n,), from i on."""
    a[i], a[i + 1], a[i + 2], a[i + 3], a[i + 4], a[i + 5] = s.xx, s.xy, s.xz, s.yy, s.yz, s.zz


@njit
def mat_at(a: Any, i: int) -> Mat3:
    """Return nine neighbours in an array (n,), from i on, as a matrix by rows."""
    return Mat3(a[i], a[i + 1], a[i + 2], a[i + 3], a[i + 4], a[i + 5], a[i + 6], a[i + 7], a[i + 8])


@njit
def put_mat_at(a: Any, i: int, m: Mat3) -> None:
    """Write a matrix by rows into an array (n,), from i on."""
    a[i], a[i + 1], a[i + 2], a[i + 3], a[i + 4], a[i + 5] = m.xx, m.xy, m.xz, m.yx, m.yy, m.yz
    a[i + 6], a[i + 7], a[i + 8] = m.zx, m.zy, m.zz


@njit
def mat32_at(a: Any, i: int) -> Mat32:
    """Return six neighbours in an array (n,), from i on, as a matrix by columns."""
    return Mat32(vec_at(a, i), vec_at(a, i + 3))


@njit
def put_mat32_at(a: Any, i: int, m: Mat32) -> None:
    """Write a matrix by columns into an array (n,), from i on."""
    put_vec_at(a, i, m.a)
    put_vec_at(a, i + 3, m.b)
