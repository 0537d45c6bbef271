"""Odometry for campaigns that have none: the reference's motion with noise, of a fixed seed. Who uses it says so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellslam.recordings.importing.campaign import OdometryTable
from cellslam.sim.frames import mean_velocity
from cellslam.sim.recording import Floats


def simulated(time_s: Floats, place_m: Floats, yaw_rad: Floats, noise_density: Sequence[float]) -> OdometryTable:
    """Return velocities in the plane between poses at times (T,): places (T, 2), yaws (T,), and white noise.

    `noise_density` (6,) in m/s and rad/s times root second, as of a data sheet.
    """
    nothing = np.zeros(len(yaw_rad))
    poses = np.column_stack([place_m, nothing, yaw_rad, nothing, nothing])
    lasts = np.diff(time_s)
    u = mean_velocity(poses[:-1], poses[1:], lasts)
    u += np.asarray(noise_density) / np.sqrt(lasts)[:, None] * np.random.default_rng(0).standard_normal(u.shape)
    u = np.vstack([np.zeros(6), u])
    return OdometryTable(time_s, {"u_x": u[:, 0], "u_y": u[:, 1], "u_psi": u[:, 3]}, hold="before")
