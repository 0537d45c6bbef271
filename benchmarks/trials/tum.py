"""Trajectories in the TUM format, which evo and most SLAM tools read: `timestamp tx ty tz qx qy qz qw`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cellslam.sim.recording import Floats


def write_tum(path: str | Path, time_s: Floats, poses: Floats) -> None:
    """Write poses (T, 6) at `time_s` (T,) in seconds: positions in metres, quaternions body to world."""
    table = np.column_stack([time_s, poses[:, :3], quaternions(poses)])
    np.savetxt(path, table, fmt=["%.6f", *["%.6f"] * 3, *["%.9f"] * 4], header="timestamp tx ty tz qx qy qz qw")


def quaternions(poses: Floats) -> Floats:
    """Return the unit quaternions (T, 4) = [qx, qy, qz, qw], qw >= 0, of poses (T, 6) in m and rad, body to world."""
    return np.asarray(Rotation.from_euler("ZYX", poses[:, 3:]).as_quat(canonical=True))
