"""Compiled: particles move, and what depends on their poses alone is worked out.

Sources: paper, eq. 14, 17 and 19; Thrun, Burgard and Fox, "Probabilistic robotics", 2005, section 5.3 (velocity motion
model).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats
from cellslam.slam.fastslam.snapshot.candidates_kernel import STEEP
from cellslam.slam.fastslam.state.lanes_kernel import covariance_at, put, theta_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    BIAS,
    LANES,
    POSE,
    POSE_G,
    SCALE,
    W_P,
    W_POSE,
    W_ROT,
    W_THETA,
    Rows,
)
from cellslam.slam.model.matrices_kernel import Vec3, mat_vec, rotation, vec_plus, vec_scaled

B = LANES


@njit(cache=True, error_model="numpy")
def driven(state: Floats, odometry: Floats, noise: Floats, drawn: Floats) -> Floats:
    """Return what each particle takes for its velocity (G, 6, LANES), in m/s and rad/s: odometry (6,), less its biases
    and drawn white noise of deviations `noise` (6,), over 1 + scale.

    drawn (n, G, LANES): standard normal, for the n components with noise, in turn.
    """
    velocity = np.empty((state.shape[0], 6, B))
    turn = 0
    for c in range(6):
        mine = turn if noise[c] != 0.0 else -1
        turn += 1 if noise[c] != 0.0 else 0
        bias, scale = (BIAS + c) * B, (SCALE + c) * B
        for g in range(state.shape[0]):
            s, v = state[g], velocity[g, c]
            for l in range(B):
                v[l] = (odometry[c] - s[bias + l]) / (1.0 + s[scale + l])
            if mine >= 0:
                for l in range(B):
                    v[l] += noise[c] * drawn[mine, g, l] / (1.0 + s[scale + l])
    return velocity


@njit(cache=True, error_model="numpy")
def advance(s: Rows, travelled: Floats, u: Floats, dt: float, size: int) -> None:
    """Advance the poses of a block by sampled body velocities u (6, LANES) in m/s and rad/s, corrected by the nuisance
    mean; carry the sensitivities.

    The attitude is taken at mid-interval. u: measured, less what was sampled of its errors; dt in s. travelled (size,):
    how far particles have moved at most (m) and turned (rad), added to.
    """
    farthest, widest = 0.0, 0.0
    for l in range(B):
        _, bias, scale = theta_at(s, 0, size, l)
        _, _, _, variance_of_bias, _, variance_of_scale = covariance_at(s, 0, size, l)
        stretch = 1.0 / (1.0 + scale)
        turn = Vec3((u[3, l] - bias) * dt, u[4, l] * dt, u[5, l] * dt)
        attitude = vec_at(s, POSE + 3, l)
        middle = vec_plus(attitude, vec_scaled(turn, 0.5))
        r, step = rotation(middle.x, middle.y, middle.z), Vec3(u[0, l] * stretch * dt, u[1, l] * dt, u[2, l] * dt)
        way = mat_vec(r, step)
        put(s, POSE, l, vec_plus(vec_at(s, POSE, l), way))
        put(s, POSE + 3, l, vec_plus(attitude, turn))
        # d(x, y)/d(bias, scale): through the heading at mid-interval, and through the stretch
        by_bias, by_scale = s[(POSE_G + 4) * B + l] - 0.5 * dt, s[(POSE_G + 5) * B + l]
        s[POSE_G * B + l] -= way.y * by_bias
        s[(POSE_G + 1) * B + l] -= way.y * by_scale + r.xx * step.x * stretch
        s[(POSE_G + 2) * B + l] += way.x * by_bias
        s[(POSE_G + 3) * B + l] += way.x * by_scale - r.yx * step.x * stretch
        s[(POSE_G + 4) * B + l] -= dt
        # three sigma of what bias and scale may still change
        spread, stretched = 3.0 * math.sqrt(max(variance_of_bias, 0.0)), 3.0 * math.sqrt(max(variance_of_scale, 0.0))
        moved = abs(way.x) + abs(way.y) + abs(way.z)
        farthest = max(farthest, moved * (1.0 + abs(s[(POSE_G + 4) * B + l]) * spread + stretched))
        widest = max(widest, spread * dt + STEEP * (abs(u[4, l]) + abs(u[5, l])) * dt)
    travelled[: size - 2] += farthest
    travelled[size - 2] += widest


@njit(cache=True, error_model="numpy")
def prepare(w: Rows, state: Rows) -> None:
    """Copy pose and sensitivities, write the rotation from body to world."""
    for i in range((W_ROT - W_POSE) * B):
        w[W_POSE * B + i] = state[POSE * B + i]
    for l in range(B):
        attitude = vec_at(w, W_POSE + 3, l)
        put(w, W_ROT, l, rotation(attitude.x, attitude.y, attitude.z))


@njit(cache=True, error_model="numpy")
def load_site(w: Rows, state: Rows, site: int, size: int) -> None:
    """Copy mean and covariance P of the nuisances that concern one site: its offset, bias and scale."""
    for l in range(B):
        put(w, W_THETA, l, theta_at(state, site, size, l))
        put(w, W_P, l, covariance_at(state, site, size, l))
