"""Compiled: particles move, and what depends on their poses alone is worked out."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.fastslam.snapshot.candidates_kernel import STEEP
from cellslam.slam.fastslam.state.layout import (
    BIAS,
    LANES,
    POSE,
    POSE_G,
    SCALE,
    THETA,
    W_B,
    W_BIAS,
    W_DROT,
    W_OFFSET_PRIOR,
    W_P,
    W_POSE,
    W_ROT,
    W_SCALE,
)

B = LANES


@njit(cache=True, error_model="numpy")
def driven(state, odometry, noise, drawn):
    """Return what each particle (G, 6, LANES) takes for its velocity: odometry (6,), less its biases and drawn white
    noise of deviations `noise` (6,), over 1 + scale.

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
def advance(s, travelled, u, dt, size):
    """Advance the poses of a block by sampled body velocities u (6, LANES), corrected by the nuisance mean; carry the
    sensitivities.

    The paper's motion model, with the attitude taken at mid-interval. u: measured, less what was sampled of its errors.
    """
    farthest, widest = 0.0, 0.0
    by_size = (THETA + size) * B
    for l in range(B):
        bias, scale = s[(THETA + size - 2) * B + l], s[(THETA + size - 1) * B + l]
        stretch = 1.0 / (1.0 + scale)
        turn = (u[3, l] - bias) * dt
        psi = s[(POSE + 3) * B + l] + 0.5 * turn
        theta, phi = s[(POSE + 4) * B + l] + 0.5 * u[4, l] * dt, s[(POSE + 5) * B + l] + 0.5 * u[5, l] * dt
        cp, sp, ct, st, cr, sr = math.cos(psi), math.sin(psi), 1.0, 0.0, 1.0, 0.0
        if theta != 0.0 or phi != 0.0:
            ct, st, cr, sr = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
        ux, uy, uz = u[0, l] * stretch * dt, u[1, l] * dt, u[2, l] * dt
        mx = cp * ct * ux + (cp * st * sr - sp * cr) * uy + (cp * st * cr + sp * sr) * uz
        my = sp * ct * ux + (sp * st * sr + cp * cr) * uy + (sp * st * cr - cp * sr) * uz
        mz = -st * ux + ct * sr * uy + ct * cr * uz
        s[POSE * B + l] += mx
        s[(POSE + 1) * B + l] += my
        s[(POSE + 2) * B + l] += mz
        s[(POSE + 3) * B + l] += turn
        s[(POSE + 4) * B + l] += u[4, l] * dt
        s[(POSE + 5) * B + l] += u[5, l] * dt
        # d(x, y)/d(bias, scale): through the heading at mid-interval, and through the stretch
        by_bias, by_scale = s[(POSE_G + 4) * B + l] - 0.5 * dt, s[(POSE_G + 5) * B + l]
        s[POSE_G * B + l] -= my * by_bias
        s[(POSE_G + 1) * B + l] -= my * by_scale + cp * ct * ux * stretch
        s[(POSE_G + 2) * B + l] += mx * by_bias
        s[(POSE_G + 3) * B + l] += mx * by_scale - sp * ct * ux * stretch
        s[(POSE_G + 4) * B + l] -= dt
        # three sigma of what bias and scale may still change
        spread = 3.0 * math.sqrt(max(s[by_size + (size * size - size - 2) * B + l], 0.0))
        stretched = 3.0 * math.sqrt(max(s[by_size + (size * size - 1) * B + l], 0.0))
        moved = abs(mx) + abs(my) + abs(mz)
        farthest = max(farthest, moved * (1.0 + abs(s[(POSE_G + 4) * B + l]) * spread + stretched))
        widest = max(widest, spread * dt + STEEP * (abs(u[4, l]) + abs(u[5, l])) * dt)
    for site in range(travelled.shape[0] - 1):
        travelled[site] += farthest
    travelled[size - 2] += widest


@njit(cache=True, error_model="numpy")
def prepare(w, state):
    """Copy pose and sensitivities, write the rotation and its derivative by yaw, clear the sums."""
    for i in range(12 * B):
        w[W_POSE * B + i] = state[POSE * B + i]
    for l in range(B):
        psi, theta, phi = w[(W_POSE + 3) * B + l], w[(W_POSE + 4) * B + l], w[(W_POSE + 5) * B + l]
        cp, sp, ct, st, cr, sr = math.cos(psi), math.sin(psi), 1.0, 0.0, 1.0, 0.0
        if theta != 0.0 or phi != 0.0:
            ct, st, cr, sr = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
        r0, r1, r2 = cp * ct, cp * st * sr - sp * cr, cp * st * cr + sp * sr
        r3, r4, r5 = sp * ct, sp * st * sr + cp * cr, sp * st * cr - cp * sr
        w[W_ROT * B + l], w[(W_ROT + 1) * B + l], w[(W_ROT + 2) * B + l] = r0, r1, r2
        w[(W_ROT + 3) * B + l], w[(W_ROT + 4) * B + l], w[(W_ROT + 5) * B + l] = r3, r4, r5
        w[(W_ROT + 6) * B + l], w[(W_ROT + 7) * B + l], w[(W_ROT + 8) * B + l] = -st, ct * sr, ct * cr
        w[W_DROT * B + l], w[(W_DROT + 1) * B + l], w[(W_DROT + 2) * B + l] = -r3, -r4, -r5
        w[(W_DROT + 3) * B + l], w[(W_DROT + 4) * B + l], w[(W_DROT + 5) * B + l] = r0, r1, r2


@njit(cache=True, error_model="numpy")
def load_site(w, state, site, size):
    """Copy the nuisance mean and covariance that concern one site."""
    cov = THETA + size
    last = size - 2
    for l in range(B):
        w[W_B * B + l] = state[(THETA + site) * B + l]
        w[W_BIAS * B + l] = state[(THETA + last) * B + l]
        w[W_SCALE * B + l] = state[(THETA + last + 1) * B + l]
        w[W_P * B + l] = state[(cov + site * size + site) * B + l]
        w[W_OFFSET_PRIOR * B + l] = w[W_P * B + l]
        w[(W_P + 1) * B + l] = state[(cov + site * size + last) * B + l]
        w[(W_P + 2) * B + l] = state[(cov + site * size + last + 1) * B + l]
        w[(W_P + 3) * B + l] = state[(cov + last * size + last) * B + l]
        w[(W_P + 4) * B + l] = state[(cov + last * size + last + 1) * B + l]
        w[(W_P + 5) * B + l] = state[(cov + (last + 1) * size + last + 1) * B + l]
