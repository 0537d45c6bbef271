"""Compiled: a kinematic bicycle, referred to its rear axle, that follows a path by pure pursuit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import njit

Floats = NDArray[np.float64]
LOOKAHEAD_M, LOOKAHEAD_S = 2.0, 0.8
STEERING_LIMIT_RAD, STEERING_RATE_RADPS = 0.65, 0.5


@njit(cache=True)
def follow(
    path_m: Floats, arc_m: Floats, start: Floats, speed_mps: Floats, step_s: float, wheelbase_m: float
) -> tuple[Floats, Floats]:
    """Return rear-axle poses [x, y, yaw] (N + 1, 3), yaw unwrapped, and curvatures (N,) of the substeps.

    `path_m` (n, 2) with `arc_m` (n,); `start` [x, y, yaw]; `speed_mps` (N,). Pure pursuit (Coulter 1992): the
    arc through the point of the path `LOOKAHEAD_M + LOOKAHEAD_S * speed` ahead of the nearest one. The foot
    point moves continuously along the path and the steering has a limited rate, so nothing chatters at
    walking pace; a standing vehicle keeps its wheels where they are.
    """
    steps = len(speed_mps)
    last = len(path_m) - 1
    poses = np.empty((steps + 1, 3))
    curvatures = np.empty(steps)
    x, y, yaw = start[0], start[1], start[2]
    poses[0, 0], poses[0, 1], poses[0, 2] = x, y, yaw
    steering, near, far = 0.0, 0, 0
    for t in range(steps):
        v = speed_mps[t]
        if v > 0.0:
            # Foot point: the segment whose projection of the axle falls inside it.
            while near < last - 1:
                ex, ey = path_m[near + 1, 0] - path_m[near, 0], path_m[near + 1, 1] - path_m[near, 1]
                if (x - path_m[near + 1, 0]) * ex + (y - path_m[near + 1, 1]) * ey < 0.0:
                    break
                near += 1
            ex, ey = path_m[near + 1, 0] - path_m[near, 0], path_m[near + 1, 1] - path_m[near, 1]
            part = ((x - path_m[near, 0]) * ex + (y - path_m[near, 1]) * ey) / (ex * ex + ey * ey)
            target = arc_m[near] + part * (arc_m[near + 1] - arc_m[near]) + LOOKAHEAD_M + LOOKAHEAD_S * v
            while far < last - 1 and arc_m[far + 1] < target:
                far += 1
            # Beyond its end the path goes straight on.
            part = (target - arc_m[far]) / (arc_m[far + 1] - arc_m[far])
            dx = path_m[far, 0] + part * (path_m[far + 1, 0] - path_m[far, 0]) - x
            dy = path_m[far, 1] + part * (path_m[far + 1, 1] - path_m[far, 1]) - y
            left = -np.sin(yaw) * dx + np.cos(yaw) * dy
            wanted = np.arctan(wheelbase_m * 2.0 * left / (dx * dx + dy * dy))
            wanted = min(max(wanted, -STEERING_LIMIT_RAD), STEERING_LIMIT_RAD)
            most = STEERING_RATE_RADPS * step_s
            steering += min(max(wanted - steering, -most), most)
        curvature = np.tan(steering) / wheelbase_m
        turn = curvature * v * step_s
        # Chord of the arc that is driven in one substep.
        chord = v * step_s * (1.0 - turn * turn / 24.0)
        x += chord * np.cos(yaw + 0.5 * turn)
        y += chord * np.sin(yaw + 0.5 * turn)
        yaw += turn
        poses[t + 1, 0], poses[t + 1, 1], poses[t + 1, 2] = x, y, yaw
        curvatures[t] = curvature
    return poses, curvatures
