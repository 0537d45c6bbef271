"""How a VT is kept: parts of the filter. Both keep s | theta ~ N(mu + G (theta - theta0), Sigma) (see `layout`).

What is inlined into the vector loops takes and returns numbers, vectors and matrices of `matrices_kernel`, never
arrays: a reference to an array inside a loop keeps the compiler from using vectors. F is the type of the numbers.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.parts.part_types import COMPILED, INLINE, is_of
from cellslam.slam.fastslam.state.angle_kernel import cosine, sine
from cellslam.slam.fastslam.state.lanes_kernel import five_at, mat_at, vec_at
from cellslam.slam.fastslam.state.layout import ANCHOR, GAIN, MU, Five, Rows
from cellslam.slam.model.matrices_kernel import Mat3, Sym3, Vec3, mat_vec, vec_plus


class Spherical(NamedTuple):
    """Range, azimuth and elevation about the place of birth: a birth is exact, and a Gaussian stays one.

    The five numbers of mu: range, cosine and sine of azimuth and of elevation.
    """


class Cartesian(NamedTuple):
    """x, y, z, as in the paper: linearised at birth, its range error of some rho sigma^2 / 2 always points one way.

    The five numbers of mu: x, y, z, and two that are not used.
    """


def moved(part: Any, F: Any, mu: Five, change: Vec3) -> Five:
    """Return mu moved by a change of s."""
    raise NotImplementedError


def corrected(part: Any, F: Any, mu: Five, change: Vec3) -> Five:
    """Return the same after an update: what has drifted from the unit circle goes back."""
    raise NotImplementedError


def place(part: Any, F: Any, anchor: Vec3, mu: Five) -> Vec3:
    """Return the position that belongs to mu, with the place of birth."""
    raise NotImplementedError


def slopes(part: Any, F: Any, mu: Five) -> Mat3:
    """Return d(position)/ds."""
    raise NotImplementedError


def begin(part: Any, F: Any, anchor: Vec3, rho: Any, n: Vec3) -> Five:
    """Return mu of a VT born at `anchor` and distance rho in direction n."""
    raise NotImplementedError


def begin_spread(part: Any, F: Any, rho: Any, n: Vec3, by_azimuth: Vec3, by_elevation: Vec3, q: Vec3) -> Sym3:
    """Return Sigma of such a VT, with n's derivatives by the measured angles and the variances of z."""
    raise NotImplementedError


def begin_gain(part: Any, F: Any, rho: Any, n: Vec3, measured: Any, by_bias: Vec3, by_scale: Vec3) -> Mat3:
    """Return G: measured: whether the distance was; by_bias, by_scale: d(x, y, psi) of the pose."""
    raise NotImplementedError


def locate(part: Any, rec: Rows, lane: int, change: Vec3) -> tuple[Vec3, Mat3]:
    """Return position and d(position)/ds of one lane in double precision, theta having changed since the last touch."""
    raise NotImplementedError


@njit(error_model="numpy")
def turned(F: Any, c: Any, s: Any, angle: Any) -> tuple[Any, Any]:
    """Return cosine and sine of an angle that a small one is added to."""
    by_c, by_s = cosine(F, angle), sine(F, angle)
    return c * by_c - s * by_s, s * by_c + c * by_s


@njit(error_model="numpy")
def on_circle(F: Any, c: Any, s: Any) -> tuple[Any, Any]:
    """Return a point close to the unit circle moved onto it, to first order."""
    size = F(1.5) - F(0.5) * (c * c + s * s)
    return c * size, s * size


@njit(error_model="numpy")
def flat_of(F: Any, n: Vec3) -> tuple[Any, Any]:
    """Return a direction's length in the plane, squared and as it is."""
    f2 = max(n.x * n.x + n.y * n.y, F(1e-18))
    return f2, math.sqrt(f2)


@overload(moved, **INLINE)
def _moved(part, F, mu, change):
    if is_of(part, Spherical):

        def spherical(part, F, mu, change):
            rho, ca, sa, ce, se = mu
            ca, sa = turned(F, ca, sa, change.y)
            ce, se = turned(F, ce, se, change.z)
            return rho + change.x, ca, sa, ce, se

        return spherical
    if is_of(part, Cartesian):
        return lambda part, F, mu, change: (mu[0] + change.x, mu[1] + change.y, mu[2] + change.z, mu[3], mu[4])
    return None


@overload(corrected, **INLINE)
def _corrected(part, F, mu, change):
    if is_of(part, Spherical):

        def spherical(part, F, mu, change):
            rho, ca, sa, ce, se = moved(part, F, mu, change)
            ca, sa = on_circle(F, ca, sa)
            ce, se = on_circle(F, ce, se)
            return rho, ca, sa, ce, se

        return spherical
    if is_of(part, Cartesian):
        return lambda part, F, mu, change: moved(part, F, mu, change)
    return None


@overload(place, **INLINE)
def _place(part, F, anchor, mu):
    if is_of(part, Spherical):

        def spherical(part, F, anchor, mu):
            rho, ca, sa, ce, se = mu
            flat = rho * ce
            return Vec3(anchor.x + flat * ca, anchor.y + flat * sa, anchor.z + rho * se)

        return spherical
    if is_of(part, Cartesian):
        return lambda part, F, anchor, mu: Vec3(mu[0], mu[1], mu[2])
    return None


@overload(slopes, **INLINE)
def _slopes(part, F, mu):
    if is_of(part, Spherical):

        def spherical(part, F, mu):
            rho, ca, sa, ce, se = mu
            nx, ny, rise = ce * ca, ce * sa, rho * se
            return Mat3(nx, -rho * ny, -rise * ca, ny, rho * nx, -rise * sa, se, F(0.0), rho * ce)

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, mu):
            none, one = F(0.0), F(1.0)
            return Mat3(one, none, none, none, one, none, none, none, one)

        return cartesian
    return None


@overload(begin, **INLINE)
def _begin(part, F, anchor, rho, n):
    if is_of(part, Spherical):

        def spherical(part, F, anchor, rho, n):
            _, flat = flat_of(F, n)
            return rho, n.x / flat, n.y / flat, flat, n.z

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, anchor, rho, n):
            return anchor.x + rho * n.x, anchor.y + rho * n.y, anchor.z + rho * n.z, F(0.0), F(0.0)

        return cartesian
    return None


@overload(begin_spread, **INLINE)
def _begin_spread(part, F, rho, n, by_azimuth, by_elevation, q):
    if is_of(part, Spherical):

        def spherical(part, F, rho, n, by_azimuth, by_elevation, q):
            f2, flat = flat_of(F, n)
            u, v = by_azimuth, by_elevation
            jaa, jae = (n.x * u.y - n.y * u.x) / f2, (n.x * v.y - n.y * v.x) / f2
            jea = flat * u.z - n.z * (n.x * u.x + n.y * u.y) / flat
            jee = flat * v.z - n.z * (n.x * v.x + n.y * v.y) / flat
            return Sym3(
                q.x, F(0.0), F(0.0), jaa * jaa * q.y + jae * jae * q.z, jaa * jea * q.y + jae * jee * q.z,
                jea * jea * q.y + jee * jee * q.z,
            )  # fmt: skip

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, rho, n, by_azimuth, by_elevation, q):
            d, a, e = q.x, rho * rho * q.y, rho * rho * q.z
            u, v = by_azimuth, by_elevation
            return Sym3(
                n.x * n.x * d + u.x * u.x * a + v.x * v.x * e,
                n.x * n.y * d + u.x * u.y * a + v.x * v.y * e,
                n.x * n.z * d + u.x * u.z * a + v.x * v.z * e,
                n.y * n.y * d + u.y * u.y * a + v.y * v.y * e,
                n.y * n.z * d + u.y * u.z * a + v.y * v.z * e,
                n.z * n.z * d + u.z * u.z * a + v.z * v.z * e,
            )

        return cartesian
    return None


@overload(begin_gain, **INLINE)
def _begin_gain(part, F, rho, n, measured, by_bias, by_scale):
    if is_of(part, Spherical):

        def spherical(part, F, rho, n, measured, by_bias, by_scale):
            f2, flat = flat_of(F, n)
            along_bias, along_scale = n.x * by_bias.x + n.y * by_bias.y, n.x * by_scale.x + n.y * by_scale.y
            rise = -n.z / (flat * rho)
            return Mat3(
                -measured, along_bias, along_scale,
                F(0.0), (n.x * by_bias.y - n.y * by_bias.x) / (f2 * rho) + by_bias.z,
                (n.x * by_scale.y - n.y * by_scale.x) / (f2 * rho) + by_scale.z,
                F(0.0), rise * along_bias, rise * along_scale,
            )  # fmt: skip

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, rho, n, measured, by_bias, by_scale):
            return Mat3(
                -measured * n.x, by_bias.x - rho * n.y * by_bias.z, by_scale.x - rho * n.y * by_scale.z,
                -measured * n.y, by_bias.y + rho * n.x * by_bias.z, by_scale.y + rho * n.x * by_scale.z,
                -measured * n.z, F(0.0), F(0.0),
            )  # fmt: skip

        return cartesian
    return None


@overload(locate, **COMPILED)
def _locate(part, rec, lane, change):
    if is_of(part, Spherical):

        def spherical(part, rec, lane, change):
            by = mat_vec(mat_at(rec, GAIN, lane), change)
            rho, ca, sa, ce, se = five_at(rec, MU, lane)
            rho, az, el = rho + by.x, math.atan2(sa, ca) + by.y, math.atan2(se, ce) + by.z
            ca, sa, ce, se = math.cos(az), math.sin(az), math.cos(el), math.sin(el)
            nx, ny = ce * ca, ce * sa
            jacobian = Mat3(nx, -rho * ce * sa, -rho * se * ca, ny, rho * ce * ca, -rho * se * sa, se, 0.0, rho * ce)
            return vec_plus(vec_at(rec, ANCHOR, lane), Vec3(rho * nx, rho * ny, rho * se)), jacobian

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, rec, lane, change):
            mu, by = five_at(rec, MU, lane), mat_vec(mat_at(rec, GAIN, lane), change)
            return vec_plus(Vec3(mu[0], mu[1], mu[2]), by), slopes(part, np.float64, mu)

        return cartesian
    return None
