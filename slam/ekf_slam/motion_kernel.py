"""Compiled: motion of pose and covariance by mean body velocities, with odometry biases and scales in the state."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True)
def rotations(rot, psi, theta, phi):
    """Write R(psi, theta, phi) and its derivatives by psi, theta and phi into rot (36,), row by row."""
    cp, sp, ct, st = math.cos(psi), math.sin(psi), math.cos(theta), math.sin(theta)
    cr, sr = math.cos(phi), math.sin(phi)
    rot[0], rot[1], rot[2] = cp * ct, cp * st * sr - sp * cr, cp * st * cr + sp * sr
    rot[3], rot[4], rot[5] = sp * ct, sp * st * sr + cp * cr, sp * st * cr - cp * sr
    rot[6], rot[7], rot[8] = -st, ct * sr, ct * cr
    for c in range(3):
        rot[9 + c], rot[12 + c], rot[15 + c] = -rot[3 + c], rot[c], 0.0
    rot[18], rot[19], rot[20] = -cp * st, cp * ct * sr, cp * ct * cr
    rot[21], rot[22], rot[23] = -sp * st, sp * ct * sr, sp * ct * cr
    rot[24], rot[25], rot[26] = -ct, -st * sr, -st * cr
    for r in range(3):
        rot[27 + 3 * r], rot[28 + 3 * r], rot[29 + 3 * r] = 0.0, rot[3 * r + 2], -rot[3 * r + 1]


@njit(cache=True)
def _move(x, p, size, odometry, dt, noise, walk, bias_of, scale_of, first_offset, rate_of, core, rot, step, rows):
    for c in range(6):
        rows[c, 0] = odometry[c] - (x[bias_of[c]] if bias_of[c] >= 0 else 0.0)
        rows[c, 1] = 1.0 / (1.0 + (x[scale_of[c]] if scale_of[c] >= 0 else 0.0))
        rows[c, 2] = rows[c, 0] * rows[c, 1]
    rotations(rot, x[3] + 0.5 * dt * rows[3, 2], x[4] + 0.5 * dt * rows[4, 2], x[5] + 0.5 * dt * rows[5, 2])
    # step (6, core) = d(next pose)/d(core); columns 0-5 of by_velocity follow in step[:, core:core + 6]
    for r in range(6):
        for c in range(core + 6):
            step[r, c] = 0.0
        step[r, r] = 1.0
    for r in range(3):
        for a in range(3):
            turned = 0.0
            for c in range(3):
                turned += rot[9 + 9 * a + 3 * r + c] * rows[c, 2] * dt
            step[r, 3 + a] = turned
            step[r, core + 3 + a] = 0.5 * dt * turned
            step[r, core + a] = rot[3 * r + a] * dt
        step[3 + r, core + 3 + r] = dt
    for c in range(6):
        for r in range(6):
            by_velocity = step[r, core + c] * rows[c, 1]
            step[r, core + c] = by_velocity
            if bias_of[c] >= 0:
                step[r, bias_of[c]] = -by_velocity
            if scale_of[c] >= 0:
                step[r, scale_of[c]] = -by_velocity * rows[c, 2]
    for r in range(3):
        moved = 0.0
        for c in range(3):
            moved += rot[3 * r + c] * rows[c, 2] * dt
        x[r] += moved
        x[3 + r] += rows[3 + r, 2] * dt
    # P = F P F^T: the six rows of the pose, then its columns
    for j in range(size):
        for r in range(6):
            total = 0.0
            for c in range(core):
                total += step[r, c] * p[c, j]
            rows[r, 3 + j] = total
    for r in range(6):
        for j in range(size):
            p[r, j] = rows[r, 3 + j]
    for i in range(size):
        for r in range(6):
            total = 0.0
            for c in range(core):
                total += step[r, c] * p[i, c]
            rows[r, 3] = total
        for r in range(6):
            p[i, r] = rows[r, 3]
    for r in range(6):
        for s in range(6):
            for c in range(6):
                p[r, s] += step[r, core + c] * step[s, core + c] * noise[c] * noise[c] / dt
    for c in range(6):
        if bias_of[c] >= 0:
            p[bias_of[c], bias_of[c]] += walk[c] * walk[c] * dt
    for s in range(len(rate_of)):
        offset, rate = first_offset + s, rate_of[s]
        if rate >= 0:
            x[offset] += x[rate] * dt
            for j in range(size):
                p[offset, j] += dt * p[rate, j]
            for i in range(size):
                p[i, offset] += dt * p[i, rate]


@njit(cache=True)
def move(x, p, count, odometry, dt, noise, walk, bias_of, scale_of, first_offset, rate_of, core, geometry, step, rows):
    """Advance filters x (K, N), p (K, N, N) by `dt` > 0 with mean body velocities odometry (6,).

    noise, walk (6,): densities of the data sheet; bias_of, scale_of (6,): state of each component's error, -1 none;
    first_offset, rate_of (S,): states of the clock offsets, and of the rate of each, -1 none; core: number of states
    before the VTs; count (K,): VTs. geometry (K, 36), step (K, 6, core + 6), rows (K, 6, 3 + N): scratch.
    """
    for f in range(len(x)):
        size = core + 3 * count[f]
        _move(
            x[f], p[f], size, odometry, dt, noise, walk, bias_of, scale_of, first_offset, rate_of, core, geometry[f],
            step[f], rows[f],
        )  # fmt: skip
