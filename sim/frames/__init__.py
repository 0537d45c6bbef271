"""Rotations, angle wrapping, and directions in the world and body frames.

World frame: east, north, up. Body frame: x forward, y left, z up. A pose is
[x, y, z, psi, theta, phi] (metres, radians); R(psi, theta, phi) = Rz(psi) Ry(theta) Rx(phi) takes body to world, so
positive theta is nose down. Azimuth is counter-clockwise from x in (-pi, pi]; elevation is from the xy-plane,
positive up, in [-pi/2, pi/2]. All functions broadcast over leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

SPEED_OF_LIGHT_MPS = 299_792_458.0
TURN = 2.0 * np.pi


def wrap_angle(angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Return angles (...,) in radians wrapped to (-pi, pi]: exact, however many turns away."""
    rest = np.fmod(np.asarray(angle_rad, dtype=np.float64), TURN)
    return np.asarray(rest - TURN * (rest > np.pi) + TURN * (rest <= -np.pi))


def held(odometry: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return odometry (T, 6), of any unit, in which the last value holds where a component is NaN, 0 before the first
    one."""
    out = odometry.copy()
    for index in np.flatnonzero(np.isnan(out).any(axis=0)):
        column = out[:, index]
        last = np.maximum.accumulate(np.where(np.isnan(column), 0, np.arange(len(column))))
        column[:] = np.nan_to_num(column[last])
    return out


def followed(
    commands: NDArray[np.float64], dt_s: NDArray[np.float64], time_constant_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean velocities (T, 6) of a vehicle that follows commands (T, 6), each held for an interval (T,) in s; and
    by how much it is faster (T, 6) than commanded as each interval begins.

    It follows as a system of the first order, tau dv/dt = u - v; before the first interval it moves as commanded then.
    Row 0 is no interval, and is copied.
    """
    out, ahead, now = commands.copy(), np.zeros_like(commands), commands[min(1, len(commands) - 1)]
    for t in range(1, len(commands)):
        ahead[t], share = now - commands[t], dt_s[t] / time_constant_s
        left = np.exp(-share)
        out[t] += ahead[t] * (1.0 - left) / share
        now = commands[t] + ahead[t] * left
    return out, ahead


def rotation(psi_rad: ArrayLike, theta_rad: ArrayLike, phi_rad: ArrayLike) -> NDArray[np.float64]:
    """Return R = Rz(psi) Ry(theta) Rx(phi), (..., 3, 3), which takes body to world vectors; angles (...,) in rad."""
    psi, theta, phi = (np.asarray(a, np.float64) for a in (psi_rad, theta_rad, phi_rad))
    cp, sp, ct, st, cr, sr = np.cos(psi), np.sin(psi), np.cos(theta), np.sin(theta), np.cos(phi), np.sin(phi)
    out = np.empty((*np.broadcast(psi, theta, phi).shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = cp * ct, cp * st * sr - sp * cr, cp * st * cr + sp * sr
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = sp * ct, sp * st * sr + cp * cr, sp * st * cr - cp * sr
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = -st, ct * sr, ct * cr
    return out


def rotation_angles(matrix: ArrayLike) -> NDArray[np.float64]:
    """Return (psi, theta, phi) in rad, shape (..., 3), of rotation matrices (..., 3, 3); inverse of `rotation`."""
    m = np.asarray(matrix, np.float64)
    psi = np.arctan2(m[..., 1, 0], m[..., 0, 0])
    theta = np.arctan2(-m[..., 2, 0], np.hypot(m[..., 0, 0], m[..., 1, 0]))
    phi = np.arctan2(m[..., 2, 1], m[..., 2, 2])
    return np.stack([psi, theta, phi], axis=-1)


def unit_vector(azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the unit vectors (..., 3) that point to the given azimuths and elevations (...,) in rad."""
    az, el = np.broadcast_arrays(np.asarray(azimuth_rad, np.float64), np.asarray(elevation_rad, np.float64))
    return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)


def azimuth_elevation(vector: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return azimuth and elevation, (...,) in rad, of vectors (..., 3) of any length: atan2 in both."""
    v = np.asarray(vector, np.float64)
    return np.arctan2(v[..., 1], v[..., 0]), np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1]))


def world_to_body(pose: ArrayLike, vector: ArrayLike) -> NDArray[np.float64]:
    """Return world vectors (..., 3), of any unit, in the body frame of `pose` (..., 6): R^T v; no points."""
    p = np.asarray(pose, np.float64)
    r = rotation(p[..., 3], p[..., 4], p[..., 5])
    turned: NDArray[np.float64] = np.einsum("...ji,...j->...i", r, np.asarray(vector, np.float64))
    return turned


def integrate_pose(pose: ArrayLike, velocity: ArrayLike, dt_s: ArrayLike) -> NDArray[np.float64]:
    """Return the pose (..., 6) after `dt_s` (...,) at mean body velocities (..., 6) in m/s and rad/s: [u_x, u_y, u_z,
    u_psi, u_theta, u_phi].

    Yaw, pitch and roll advance at their rates; the translation is rotated with the attitude at mid-interval, which
    is exact to third order in the turn of one interval.
    """
    p, u, dt = np.asarray(pose, np.float64), np.asarray(velocity, np.float64), np.asarray(dt_s, np.float64)[..., None]
    turn = u[..., 3:] * dt
    middle = p[..., 3:] + 0.5 * turn
    moved = np.einsum("...ij,...j->...i", rotation(middle[..., 0], middle[..., 1], middle[..., 2]), u[..., :3] * dt)
    return np.concatenate([p[..., :3] + moved, wrap_angle(p[..., 3:] + turn)], axis=-1)


def pose_jacobians(
    pose: NDArray[np.float64], velocity: NDArray[np.float64], dt_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return d(pose')/d(pose) and d(pose')/d(velocity), each (n, 6, 6), of `integrate_pose`.

    At poses (n, 6) in m and rad, body velocities (n, 6) in m/s and rad/s and intervals (n,) in s.
    """
    middle = pose[:, 3:] + 0.5 * velocity[:, 3:] * dt_s[:, None]
    r = rotation(middle[:, 0], middle[:, 1], middle[:, 2])
    moved = np.einsum("nij,nj->ni", r, velocity[:, :3]) * dt_s[:, None]
    zero = np.zeros(len(pose))
    # An angle turns the vector about its axis: yaw about z, pitch about the yawed y, roll about the body's x.
    up = np.stack([zero, zero, zero + 1.0], axis=-1)
    axes = np.stack([up, rotation(middle[:, 0], zero, zero)[:, :, 1], r[:, :, 0]], axis=1)
    turned = np.swapaxes(np.cross(axes, moved[:, None, :]), 1, 2)
    by_pose, by_velocity = np.tile(np.eye(6), (len(pose), 1, 1)), np.zeros((len(pose), 6, 6))
    by_pose[:, :3, 3:] = turned
    by_velocity[:, :3, :3] = r * dt_s[:, None, None]
    by_velocity[:, :3, 3:] = turned * 0.5 * dt_s[:, None, None]
    by_velocity[:, 3:, 3:] = np.eye(3) * dt_s[:, None, None]
    return by_pose, by_velocity


def mean_velocity(before: ArrayLike, after: ArrayLike, dt_s: ArrayLike) -> NDArray[np.float64]:
    """Return the mean body velocities (..., 6), m/s and rad/s, that take pose `before` to `after` in `dt_s` (...,).

    Exact inverse of `integrate_pose`.
    """
    a, b = np.asarray(before, np.float64), np.asarray(after, np.float64)
    dt = np.asarray(dt_s, np.float64)[..., None]
    turn = wrap_angle(b[..., 3:] - a[..., 3:])
    middle = a[..., 3:] + 0.5 * turn
    r = rotation(middle[..., 0], middle[..., 1], middle[..., 2])
    moved = np.einsum("...ji,...j->...i", r, b[..., :3] - a[..., :3])
    return np.concatenate([moved, turn], axis=-1) / dt
