"""How a VT is kept: parts of the filter. Both keep s | theta ~ N(mu + G (theta - theta0), Sigma) (see `layout`).

What is inlined into the vector loops takes and returns numbers, never arrays: a reference to an array inside a loop
keeps the compiler from using vectors. F is the type of the numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit
from numba.extending import overload

from cellslam.slam.fastslam.parts.part_types import COMPILED, INLINE, is_of
from cellslam.slam.fastslam.state.angle_kernel import cosine, sine
from cellslam.slam.fastslam.state.layout import ANCHOR, CA, CE, GAIN, LANES, RANGE, SA, SE

B = LANES


class Spherical(NamedTuple):
    """Range, azimuth and elevation about the place of birth: a birth is exact, and a Gaussian stays one.

    The five numbers of mu: range, cosine and sine of azimuth and of elevation.
    """


class Cartesian(NamedTuple):
    """x, y, z, as in the paper: linearised at birth, its range error of some rho sigma^2 / 2 always points one way.

    The five numbers of mu: x, y, z, and two that are not used.
    """


def moved(part, F, mu, first, second, third):
    """Return mu (5) moved by three components of s."""
    raise NotImplementedError


def corrected(part, F, mu, first, second, third):
    """Return the same after an update: what has drifted from the unit circle goes back."""
    raise NotImplementedError


def place(part, F, anchor, mu):
    """Return the position (3) that belongs to mu (5), with the place of birth (3)."""
    raise NotImplementedError


def slopes(part, F, mu):
    """Return d(position)/ds (9, row by row)."""
    raise NotImplementedError


def begin(part, F, anchor, rho, n):
    """Return mu (5) of a VT born at `anchor` (3) and distance rho in direction n (3)."""
    raise NotImplementedError


def begin_spread(part, F, rho, n, by_azimuth, by_elevation, q0, q1, q2):
    """Return Sigma (00 01 02 11 12 22) of such a VT, with n's derivatives (3) by the measured angles, and three
    variances."""
    raise NotImplementedError


def begin_gain(part, F, rho, n, measured, by_bias, by_scale):
    """Return G (9, row by row): measured: whether the distance was; by_bias, by_scale: d(x, y, psi) of the pose."""
    raise NotImplementedError


def locate(part, rec, lane, d0, d1, d2, position, jacobian):
    """Write position (3,) and d(position)/ds (3, 3) of one lane in double precision, theta having changed by d0, d1,
    d2 since the last touch."""
    raise NotImplementedError


@overload(moved, **INLINE)
def _moved(part, F, mu, first, second, third):
    if is_of(part, Spherical):

        def spherical(part, F, mu, first, second, third):
            s, c = sine(F, second), cosine(F, second)
            t, d = sine(F, third), cosine(F, third)
            return (
                mu[0] + first, mu[1] * c - mu[2] * s, mu[2] * c + mu[1] * s, mu[3] * d - mu[4] * t,
                mu[4] * d + mu[3] * t,
            )  # fmt: skip

        return spherical
    if is_of(part, Cartesian):
        return lambda part, F, mu, first, second, third: (mu[0] + first, mu[1] + second, mu[2] + third, mu[3], mu[4])
    return None


@overload(corrected, **INLINE)
def _corrected(part, F, mu, first, second, third):
    if is_of(part, Spherical):

        def spherical(part, F, mu, first, second, third):
            s, c = sine(F, second), cosine(F, second)
            t, d = sine(F, third), cosine(F, third)
            ca, sa, ce, se = mu[1] * c - mu[2] * s, mu[2] * c + mu[1] * s, mu[3] * d - mu[4] * t, mu[4] * d + mu[3] * t
            a, e = F(1.5) - F(0.5) * (ca * ca + sa * sa), F(1.5) - F(0.5) * (ce * ce + se * se)
            return mu[0] + first, ca * a, sa * a, ce * e, se * e

        return spherical
    if is_of(part, Cartesian):
        return lambda part, F, mu, first, second, third: (mu[0] + first, mu[1] + second, mu[2] + third, mu[3], mu[4])
    return None


@overload(place, **INLINE)
def _place(part, F, anchor, mu):
    if is_of(part, Spherical):

        def spherical(part, F, anchor, mu):
            flat = mu[0] * mu[3]
            return anchor[0] + flat * mu[1], anchor[1] + flat * mu[2], anchor[2] + mu[0] * mu[4]

        return spherical
    if is_of(part, Cartesian):
        return lambda part, F, anchor, mu: (mu[0], mu[1], mu[2])
    return None


@overload(slopes, **INLINE)
def _slopes(part, F, mu):
    if is_of(part, Spherical):

        def spherical(part, F, mu):
            nx, ny, rise = mu[3] * mu[1], mu[3] * mu[2], mu[0] * mu[4]
            return nx, -mu[0] * ny, -rise * mu[1], ny, mu[0] * nx, -rise * mu[2], mu[4], F(0.0), mu[0] * mu[3]

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, mu):
            none, one = F(0.0), F(1.0)
            return one, none, none, none, one, none, none, none, one

        return cartesian
    return None


@overload(begin, **INLINE)
def _begin(part, F, anchor, rho, n):
    if is_of(part, Spherical):

        def spherical(part, F, anchor, rho, n):
            flat = math.sqrt(max(n[0] * n[0] + n[1] * n[1], F(1e-18)))
            return rho, n[0] / flat, n[1] / flat, flat, n[2]

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, anchor, rho, n):
            return anchor[0] + rho * n[0], anchor[1] + rho * n[1], anchor[2] + rho * n[2], F(0.0), F(0.0)

        return cartesian
    return None


@overload(begin_spread, **INLINE)
def _begin_spread(part, F, rho, n, by_azimuth, by_elevation, q0, q1, q2):
    if is_of(part, Spherical):

        def spherical(part, F, rho, n, by_azimuth, by_elevation, q0, q1, q2):
            f2 = max(n[0] * n[0] + n[1] * n[1], F(1e-18))
            flat = math.sqrt(f2)
            jaa = (n[0] * by_azimuth[1] - n[1] * by_azimuth[0]) / f2
            jae = (n[0] * by_elevation[1] - n[1] * by_elevation[0]) / f2
            jea = flat * by_azimuth[2] - n[2] * (n[0] * by_azimuth[0] + n[1] * by_azimuth[1]) / flat
            jee = flat * by_elevation[2] - n[2] * (n[0] * by_elevation[0] + n[1] * by_elevation[1]) / flat
            return (
                q0, F(0.0), F(0.0), jaa * jaa * q1 + jae * jae * q2, jaa * jea * q1 + jae * jee * q2,
                jea * jea * q1 + jee * jee * q2,
            )  # fmt: skip

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, rho, n, by_azimuth, by_elevation, q0, q1, q2):
            a, e = rho * rho * q1, rho * rho * q2
            u, v = by_azimuth, by_elevation
            return (
                n[0] * n[0] * q0 + u[0] * u[0] * a + v[0] * v[0] * e,
                n[0] * n[1] * q0 + u[0] * u[1] * a + v[0] * v[1] * e,
                n[0] * n[2] * q0 + u[0] * u[2] * a + v[0] * v[2] * e,
                n[1] * n[1] * q0 + u[1] * u[1] * a + v[1] * v[1] * e,
                n[1] * n[2] * q0 + u[1] * u[2] * a + v[1] * v[2] * e,
                n[2] * n[2] * q0 + u[2] * u[2] * a + v[2] * v[2] * e,
            )

        return cartesian
    return None


@overload(begin_gain, **INLINE)
def _begin_gain(part, F, rho, n, measured, by_bias, by_scale):
    if is_of(part, Spherical):

        def spherical(part, F, rho, n, measured, by_bias, by_scale):
            f2 = max(n[0] * n[0] + n[1] * n[1], F(1e-18))
            flat = math.sqrt(f2)
            along_bias, along_scale = n[0] * by_bias[0] + n[1] * by_bias[1], n[0] * by_scale[0] + n[1] * by_scale[1]
            rise = -n[2] / (flat * rho)
            return (
                -measured, along_bias, along_scale,
                F(0.0), (n[0] * by_bias[1] - n[1] * by_bias[0]) / (f2 * rho) + by_bias[2],
                (n[0] * by_scale[1] - n[1] * by_scale[0]) / (f2 * rho) + by_scale[2],
                F(0.0), rise * along_bias, rise * along_scale,
            )  # fmt: skip

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, F, rho, n, measured, by_bias, by_scale):
            return (
                -measured * n[0], by_bias[0] - rho * n[1] * by_bias[2], by_scale[0] - rho * n[1] * by_scale[2],
                -measured * n[1], by_bias[1] + rho * n[0] * by_bias[2], by_scale[1] + rho * n[0] * by_scale[2],
                -measured * n[2], F(0.0), F(0.0),
            )  # fmt: skip

        return cartesian
    return None


@overload(locate, **COMPILED)
def _locate(part, rec, lane, d0, d1, d2, position, jacobian):
    if is_of(part, Spherical):

        def spherical(part, rec, lane, d0, d1, d2, position, jacobian):
            change = _change(rec, lane, d0, d1, d2)
            rho = rec[RANGE * B + lane] + change[0]
            az = math.atan2(rec[SA * B + lane], rec[CA * B + lane]) + change[1]
            el = math.atan2(rec[SE * B + lane], rec[CE * B + lane]) + change[2]
            ca, sa, ce, se = math.cos(az), math.sin(az), math.cos(el), math.sin(el)
            jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = ce * ca, -rho * ce * sa, -rho * se * ca
            jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = ce * sa, rho * ce * ca, -rho * se * sa
            jacobian[2, 0], jacobian[2, 1], jacobian[2, 2] = se, 0.0, rho * ce
            for r in range(3):
                position[r] = rec[(ANCHOR + r) * B + lane] + rho * jacobian[r, 0]

        return spherical
    if is_of(part, Cartesian):

        def cartesian(part, rec, lane, d0, d1, d2, position, jacobian):
            change = _change(rec, lane, d0, d1, d2)
            jacobian[:] = 0.0
            for r in range(3):
                jacobian[r, r] = 1.0
                position[r] = rec[(RANGE + r) * B + lane] + change[r]

        return cartesian
    return None


@njit(error_model="numpy")
def _change(rec, lane, d0, d1, d2):
    """Return G (theta - theta0) of one lane."""
    return (
        rec[GAIN * B + lane] * d0 + rec[(GAIN + 1) * B + lane] * d1 + rec[(GAIN + 2) * B + lane] * d2,
        rec[(GAIN + 3) * B + lane] * d0 + rec[(GAIN + 4) * B + lane] * d1 + rec[(GAIN + 5) * B + lane] * d2,
        rec[(GAIN + 6) * B + lane] * d0 + rec[(GAIN + 7) * B + lane] * d1 + rec[(GAIN + 8) * B + lane] * d2,
    )
