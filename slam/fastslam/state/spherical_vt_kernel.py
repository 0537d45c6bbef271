"""Compiled: a VT in range, azimuth and elevation about the place of its birth.

A birth is exact in these, and a Gaussian stays one: s | theta ~ N(mu + G (theta - theta0), Sigma) (see `layout`). mu is
five numbers: range, cosine and sine of azimuth and of elevation, axes of the world.

The vector loops call functions that take and return numbers, vectors and matrices of `matrices_kernel`, never arrays: a
reference to an array inside a loop keeps the compiler from using vectors. F is the type of the numbers.
"""

from __future__ import annotations

import math
from typing import Any

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.state.angle_kernel import cosine, sine
from cellslam.slam.fastslam.state.lanes_kernel import five_at, mat_at, vec_at
from cellslam.slam.fastslam.state.layout import ANCHOR, GAIN, MU, Five, Rows
from cellslam.slam.model.matrices_kernel import Mat3, Sym3, Vec3, mat_vec, vec_plus


@njit(error_model="numpy")
def moved(F: Any, mu: Five, change: Vec3) -> Five:
    """Return mu moved by a small change of s (m, rad, rad)."""
    rho, ca, sa, ce, se = mu
    ca, sa = _turned(F, ca, sa, change.y)
    ce, se = _turned(F, ce, se, change.z)
    return rho + change.x, ca, sa, ce, se


@njit(error_model="numpy")
def corrected(F: Any, mu: Five, change: Vec3) -> Five:
    """Return the same after an update: what has drifted from the unit circle goes back."""
    rho, ca, sa, ce, se = moved(F, mu, change)
    ca, sa = _on_circle(F, ca, sa)
    ce, se = _on_circle(F, ce, se)
    return rho, ca, sa, ce, se


@njit(error_model="numpy")
def place(anchor: Vec3, mu: Five) -> Vec3:
    """Return the position (m) that belongs to mu, with the place of birth."""
    rho, ca, sa, ce, se = mu
    flat = rho * ce
    return Vec3(anchor.x + flat * ca, anchor.y + flat * sa, anchor.z + rho * se)


@njit(error_model="numpy")
def slopes(F: Any, mu: Five) -> Mat3:
    """Return d(position)/ds."""
    rho, ca, sa, ce, se = mu
    nx, ny, rise = ce * ca, ce * sa, rho * se
    return Mat3(nx, -rho * ny, -rise * ca, ny, rho * nx, -rise * sa, se, F(0.0), rho * ce)


@njit(error_model="numpy")
def begin(F: Any, rho: Any, n: Vec3) -> Five:
    """Return mu of a VT born at distance rho (m) in direction n."""
    _, flat = _flat_of(F, n)
    return rho, n.x / flat, n.y / flat, flat, n.z


@njit(error_model="numpy")
def begin_spread(F: Any, n: Vec3, by_azimuth: Vec3, by_elevation: Vec3, q: Vec3) -> Sym3:
    """Return Sigma of such a VT, with n's derivatives by the measured angles and the variances of z (m^2, rad^2)."""
    f2, flat = _flat_of(F, n)
    u, v = by_azimuth, by_elevation
    jaa, jae = (n.x * u.y - n.y * u.x) / f2, (n.x * v.y - n.y * v.x) / f2
    jea = flat * u.z - n.z * (n.x * u.x + n.y * u.y) / flat
    jee = flat * v.z - n.z * (n.x * v.x + n.y * v.y) / flat
    return Sym3(
        q.x, F(0.0), F(0.0), jaa * jaa * q.y + jae * jae * q.z, jaa * jea * q.y + jae * jee * q.z,
        jea * jea * q.y + jee * jee * q.z,
    )  # fmt: skip


@njit(error_model="numpy")
def begin_gain(F: Any, rho: Any, n: Vec3, measured: Any, by_bias: Vec3, by_scale: Vec3) -> Mat3:
    """Return G: measured: whether the distance was; by_bias, by_scale: d(x, y, psi) of the pose."""
    f2, flat = _flat_of(F, n)
    along_bias, along_scale = n.x * by_bias.x + n.y * by_bias.y, n.x * by_scale.x + n.y * by_scale.y
    rise = -n.z / (flat * rho)
    return Mat3(
        -measured, along_bias, along_scale,
        F(0.0), (n.x * by_bias.y - n.y * by_bias.x) / (f2 * rho) + by_bias.z,
        (n.x * by_scale.y - n.y * by_scale.x) / (f2 * rho) + by_scale.z,
        F(0.0), rise * along_bias, rise * along_scale,
    )  # fmt: skip


@njit(error_model="numpy")
def locate(rec: Rows, lane: int, change: Vec3) -> tuple[Vec3, Mat3]:
    """Return position (m) and d(position)/ds of one lane in double precision, theta having changed since the last
    touch."""
    by = mat_vec(mat_at(rec, GAIN, lane), change)
    rho, ca, sa, ce, se = five_at(rec, MU, lane)
    rho, az, el = rho + by.x, math.atan2(sa, ca) + by.y, math.atan2(se, ce) + by.z
    ca, sa, ce, se = math.cos(az), math.sin(az), math.cos(el), math.sin(el)
    nx, ny = ce * ca, ce * sa
    jacobian = Mat3(nx, -rho * ce * sa, -rho * se * ca, ny, rho * ce * ca, -rho * se * sa, se, 0.0, rho * ce)
    return vec_plus(vec_at(rec, ANCHOR, lane), Vec3(rho * nx, rho * ny, rho * se)), jacobian


@njit(error_model="numpy")
def _turned(F: Any, c: Any, s: Any, angle: Any) -> tuple[Any, Any]:
    """Return cosine and sine of an angle that a small one is added to."""
    by_c, by_s = cosine(F, angle), sine(F, angle)
    return c * by_c - s * by_s, s * by_c + c * by_s


@njit(error_model="numpy")
def _on_circle(F: Any, c: Any, s: Any) -> tuple[Any, Any]:
    """Return a point close to the unit circle moved onto it, to first order."""
    size = F(1.5) - F(0.5) * (c * c + s * s)
    return c * size, s * size


@njit(error_model="numpy")
def _flat_of(F: Any, n: Vec3) -> tuple[Any, Any]:
    """Return a direction's length in the plane, squared and as it is."""
    f2 = max(n.x * n.x + n.y * n.y, F(1e-18))
    return f2, math.sqrt(f2)
