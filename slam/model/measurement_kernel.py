"""Compiled: the measurement model h and its Jacobians, the same as those of `measurement_model`, of which they are the
parts: rotations, and the change from Cartesian to spherical coordinates and back.

With R the rotation of the array, body to world, and w the vector from the array to a VT in the world frame,

    h = spherical(R^T w),   dh/dw = D R^T,   dh/dangle = D (dR/dangle)^T w,   D = spherical_jacobian(R^T w).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import part
from cellslam.slam.model.matrices_kernel import Mat3, Vec3, rotation
from cellslam.slam.model.measurement_model import LEAST_FLAT_M

LEAST_FLAT2 = LEAST_FLAT_M**2


class Spherical(NamedTuple):
    """What h predicts: distance (m), azimuth and elevation (rad)."""

    distance: float
    azimuth: float
    elevation: float


class Rotations(NamedTuple):
    """A rotation R = Rz(psi) Ry(theta) Rx(phi), body to world, and its derivatives by the three angles."""

    r: Mat3
    by_psi: Mat3
    by_theta: Mat3
    by_phi: Mat3


@part
def rotations(psi: float, theta: float, phi: float) -> Rotations:
    """Return R(psi, theta, phi), angles in rad, and its derivatives."""
    cp, sp, ct, st = math.cos(psi), math.sin(psi), math.cos(theta), math.sin(theta)
    cr, sr = math.cos(phi), math.sin(phi)
    r = rotation(psi, theta, phi)
    by_theta = Mat3(-cp * st, cp * ct * sr, cp * ct * cr, -sp * st, sp * ct * sr, sp * ct * cr, -ct, -st * sr, -st * cr)
    by_psi = Mat3(-r.yx, -r.yy, -r.yz, r.xx, r.xy, r.xz, 0.0, 0.0, 0.0)
    return Rotations(r, by_psi, by_theta, Mat3(0.0, r.xz, -r.xy, 0.0, r.yz, -r.yy, 0.0, r.zz, -r.zy))


@part
def spherical(v: Vec3) -> Spherical:
    """Return length (m), azimuth and elevation (rad) of a vector (m); its xy-part is taken as a millimetre at least."""
    flat2 = max(v.x * v.x + v.y * v.y, LEAST_FLAT2)
    return Spherical(math.sqrt(flat2 + v.z * v.z), math.atan2(v.y, v.x), math.atan2(v.z, math.sqrt(flat2)))


@part
def spherical_jacobian(v: Vec3) -> Mat3:
    """Return d(length, azimuth, elevation)/d(x, y, z) of a vector (m): rows in m/m, rad/m, rad/m."""
    flat2 = max(v.x * v.x + v.y * v.y, LEAST_FLAT2)
    full2 = flat2 + v.z * v.z
    flat, full = math.sqrt(flat2), math.sqrt(full2)
    k = 1.0 / (flat * full2)
    return Mat3(
        v.x / full, v.y / full, v.z / full,
        -v.y / flat2, v.x / flat2, 0.0,
        -v.x * v.z * k, -v.y * v.z * k, flat / full2,
    )  # fmt: skip


@part
def direction(azimuth: float, elevation: float) -> Vec3:
    """Return the unit vector to an azimuth and elevation (rad)."""
    ce = math.cos(elevation)
    return Vec3(ce * math.cos(azimuth), ce * math.sin(azimuth), math.sin(elevation))


@part
def cartesian_jacobian(length: float, azimuth: float, elevation: float) -> Mat3:
    """Return d(x, y, z)/d(length, azimuth, elevation) of a vector: columns in m/m, m/rad, m/rad; the inverse of
    `spherical_jacobian`."""
    ca, sa, ce, se = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    return Mat3(
        ce * ca, -length * ce * sa, -length * se * ca,
        ce * sa, length * ce * ca, -length * se * sa,
        se, 0.0, length * ce,
    )  # fmt: skip
