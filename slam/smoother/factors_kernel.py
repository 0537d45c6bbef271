"""Compiled: mean residual and Jacobians of a VT's measurements about one keyframe.

Sources: paper, eq. 22 to 27, with the elevation corrected; Barfoot, "State estimation for robotics", 2017, chapter 7
(derivatives by a rotation vector).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats


@njit(cache=True)
def residual(
    rotation: Floats,
    position: Floats,
    vt: Floats,
    offset: float,
    relative: Floats,
    z: Floats,
    out: Floats,
    by_pose: Floats,
    by_vt: Floats,
) -> int:
    """Write the mean over measurements of h + offset - z, and its Jacobians; return the number of measurements.

    rotation (3, 3), position (3,): keyframe; vt (3,) and offset in m; relative (m, 12): rotation row by row, and place,
    of the vehicle in the keyframe's frame; z (m, 3): distance, azimuth, elevation, in m and rad. out (3,); by_pose (3,
    6): rotation vector and translation in the keyframe's frame; by_vt (3, 3). The offset's Jacobian is (1, 0, 0).
    """
    out[:] = 0.0
    by_pose[:] = 0.0
    by_vt[:] = 0.0
    q, slope = np.zeros(3), np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            q[a] += rotation[b, a] * (vt[b] - position[b])
    share = 1.0 / len(z)
    for m in range(len(z)):
        y = np.zeros(3)
        for a in range(3):
            for b in range(3):
                y[a] += relative[m, 3 * b + a] * (q[b] - relative[m, 9 + b])
        flat2 = max(y[0] * y[0] + y[1] * y[1], 1e-6)
        full2 = flat2 + y[2] * y[2]
        flat, full = math.sqrt(flat2), math.sqrt(full2)
        out[0] += share * (full + offset - z[m, 0])
        turn = math.atan2(y[1], y[0]) - z[m, 1]
        out[1] += share * (turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi)))
        out[2] += share * (math.atan2(y[2], flat) - z[m, 2])
        for r in range(3):
            if r == 0:
                s0, s1, s2 = y[0] / full, y[1] / full, y[2] / full
            elif r == 1:
                s0, s1, s2 = -y[1] / flat2, y[0] / flat2, 0.0
            else:
                s0, s1, s2 = -y[0] * y[2] / (flat * full2), -y[1] * y[2] / (flat * full2), flat / full2
            for b in range(3):
                turned = s0 * relative[m, 3 * b] + s1 * relative[m, 3 * b + 1] + s2 * relative[m, 3 * b + 2]
                slope[r, b] += share * turned
    for r in range(3):
        a, b, c = slope[r, 0], slope[r, 1], slope[r, 2]
        # dq = [q]x omega - v
        by_pose[r, 0] = b * q[2] - c * q[1]
        by_pose[r, 1] = c * q[0] - a * q[2]
        by_pose[r, 2] = a * q[1] - b * q[0]
        by_pose[r, 3], by_pose[r, 4], by_pose[r, 5] = -a, -b, -c
        for k in range(3):
            by_vt[r, k] = a * rotation[k, 0] + b * rotation[k, 1] + c * rotation[k, 2]
    return len(z)
