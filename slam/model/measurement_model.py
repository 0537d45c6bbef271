"""The measurement model h and its Jacobians: used by every estimator and by the bound.

h(r, v) = (distance, azimuth, elevation) of VT v seen from pose r, without clock offset. With the offset b of its site a
measurement is z = h(r, v) + (b, 0, 0) + noise. Azimuth and its Jacobian have no limit straight above the array: the
horizontal part of the offset to a VT, in the body frame, counts as LEAST_FLAT_M at least. `measurement_kernel` has the
same, compiled. Source: paper, eq. 22 to 27, with azimuth atan2(y, x) and elevation atan2(z, sqrt(x^2 + y^2)).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.frames import rotation, world_to_body
from cellslam.sim.recording import Floats

LEAST_FLAT_M = 1e-3


def predict(pose: ArrayLike, vt: ArrayLike) -> Floats:
    """Return h (..., 3): distance in m, azimuth and elevation in rad (body frame) of VTs (..., 3) from poses (...,
    6)."""
    p, v = np.asarray(pose, np.float64), np.asarray(vt, np.float64)
    x, y, z = np.moveaxis(world_to_body(p, v - p[..., :3]), -1, 0)
    flat = np.maximum(np.hypot(x, y), LEAST_FLAT_M)
    full = np.sqrt(np.maximum(x * x + y * y, LEAST_FLAT_M**2) + z * z)
    return np.stack([full, np.arctan2(y, x), np.arctan2(z, flat)], axis=-1)


def jacobians(pose: ArrayLike, vt: ArrayLike) -> tuple[Floats, Floats]:
    """Return dh/dv (..., 3, 3) and dh/dr (..., 3, 6) for poses (..., 6) and VTs (..., 3).

    Units: m/m, rad/m for the position columns; m/rad, rad/rad for yaw, pitch and roll.
    """
    p, v = np.broadcast_arrays(np.asarray(pose, np.float64)[..., :, None], np.asarray(vt, np.float64)[..., None, :])
    pose_b, vt_b = p[..., 0], v[..., 0, :]
    psi, zero = pose_b[..., 3], np.zeros_like(pose_b[..., 3])
    r = rotation(psi, pose_b[..., 4], pose_b[..., 5])
    body = np.einsum("...ji,...j->...i", r, vt_b - pose_b[..., :3])
    to_spherical = _spherical_jacobian(body)
    d_vt = to_spherical @ np.swapaxes(r, -1, -2)
    # R = Rz Ry Rx: the axes of yaw, of pitch once it is yawed, and of roll, as the body sees them, turn the VT back.
    pitched = np.stack([-np.sin(psi), np.cos(psi), zero], axis=-1)
    axes = [r[..., 2, :], np.einsum("...ji,...j->...i", r, pitched), np.broadcast_to([1.0, 0.0, 0.0], body.shape)]
    d_angles = to_spherical @ np.stack([np.cross(body, axis) for axis in axes], axis=-1)
    return d_vt, np.concatenate([-d_vt, d_angles], axis=-1)


def _spherical_jacobian(body: Floats) -> Floats:
    """Return d(distance, azimuth, elevation)/d(x, y, z), (..., 3, 3)."""
    x, y, z = body[..., 0], body[..., 1], body[..., 2]
    flat2 = np.maximum(x * x + y * y, LEAST_FLAT_M**2)
    flat, full2 = np.sqrt(flat2), flat2 + z * z
    full = np.sqrt(full2)
    zero = np.zeros_like(x)
    rows = (
        (x / full, y / full, z / full),
        (-y / flat2, x / flat2, zero),
        (-x * z / (flat * full2), -y * z / (flat * full2), flat / full2),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
