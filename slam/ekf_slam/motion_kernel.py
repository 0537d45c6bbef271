"""Compiled: motion of pose and covariance by mean body velocities, with odometry biases and scales in the state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats
from cellslam.slam.ekf_slam.state_layout import POSE, Core, Filter, one_of, states
from cellslam.slam.model.matrices_kernel import Mat3, Vec3, columns, put_mat, scaled, vec_of
from cellslam.slam.model.measurement_kernel import rotations


class Interval(NamedTuple):
    """What the odometry says of `dt` (s): mean body velocities `measured` (6,), and the densities (6,) of its white
    `noise` and of its biases' `walk`."""

    dt: float
    measured: Floats
    noise: Floats
    walk: Floats


@njit(cache=True)
def move(filters: Filter, interval: Interval) -> None:
    """Advance the filters of a bank by an interval of dt > 0.

    The true velocity is (measured - bias - noise) / (1 + scale); the pose moves as in `frames.integrate_pose`.
    """
    core = filters.core
    step = np.empty((POSE, core.size + POSE))  # d(next pose)/d(core), and behind it d(next pose)/d(velocity)
    rows = np.empty((POSE, filters.p.shape[1]))
    for k in range(len(filters.x)):
        f = one_of(filters, k)
        _move_pose(f.x, core, interval, step)
        _spread(f, interval, step, rows)
        _drift(f, interval.dt)


@njit
def _way(m: Mat3, v: Vec3, dt: float) -> Vec3:
    """Return m v dt."""
    return Vec3(
        m.xx * v.x * dt + m.xy * v.y * dt + m.xz * v.z * dt,
        m.yx * v.x * dt + m.yy * v.y * dt + m.yz * v.z * dt,
        m.zx * v.x * dt + m.zy * v.y * dt + m.zz * v.z * dt,
    )


@njit(cache=True)
def _move_pose(x: Floats, core: Core, interval: Interval, step: Floats) -> None:
    """Move the pose of a mean x, and write the Jacobians of where it gets to."""
    dt, velocity, share = interval.dt, np.empty(POSE), np.empty(POSE)
    for c in range(POSE):
        share[c] = 1.0 / (1.0 + (x[core.scale[c]] if core.scale[c] >= 0 else 0.0))
        velocity[c] = (interval.measured[c] - (x[core.bias[c]] if core.bias[c] >= 0 else 0.0)) * share[c]
    ahead, half = vec_of(velocity), 0.5 * dt
    middle = rotations(x[3] + half * velocity[3], x[4] + half * velocity[4], x[5] + half * velocity[5])
    way = _way(middle.r, ahead, dt)
    turned = columns(_way(middle.by_psi, ahead, dt), _way(middle.by_theta, ahead, dt), _way(middle.by_phi, ahead, dt))
    step[:] = 0.0
    by_velocity = step[:, core.size :]
    put_mat(step[:, 3:], turned)
    put_mat(by_velocity, scaled(middle.r, dt))
    put_mat(by_velocity[:, 3:], scaled(turned, half))
    for c in range(POSE):
        step[c, c] = 1.0
        if c >= 3:
            by_velocity[c, c] = dt
        for r in range(POSE):
            by_velocity[r, c] *= share[c]
            if core.bias[c] >= 0:
                step[r, core.bias[c]] = -by_velocity[r, c]
            if core.scale[c] >= 0:
                step[r, core.scale[c]] = -by_velocity[r, c] * velocity[c]
    x[0] += way.x
    x[1] += way.y
    x[2] += way.z
    for c in range(3, POSE):
        x[c] += velocity[c] * dt


@njit(cache=True)
def _spread(f: Filter, interval: Interval, step: Floats, rows: Floats) -> None:
    """P <- F P F^T + Q: F changes the pose only; its six rows, then its columns."""
    p, core, size = f.p, f.core, states(f)
    for j in range(size):
        for r in range(POSE):
            total = 0.0
            for c in range(core.size):
                total += step[r, c] * p[c, j]
            rows[r, j] = total
    p[:POSE, :size] = rows[:, :size]
    for i in range(size):
        for r in range(POSE):
            total = 0.0
            for c in range(core.size):
                total += step[r, c] * p[i, c]
            rows[r, 0] = total
        for r in range(POSE):
            p[i, r] = rows[r, 0]
    noise, dt = interval.noise, interval.dt
    for r in range(POSE):
        for s in range(POSE):
            for c in range(POSE):
                p[r, s] += step[r, core.size + c] * step[s, core.size + c] * noise[c] * noise[c] / dt
    for c in range(POSE):
        if core.bias[c] >= 0:
            p[core.bias[c], core.bias[c]] += interval.walk[c] * interval.walk[c] * dt


@njit(cache=True)
def _drift(f: Filter, dt: float) -> None:
    """Let the clock offsets run on at their rates."""
    x, p, size = f.x, f.p, states(f)
    for s in range(len(f.core.rate)):
        offset, rate = f.core.first_offset + s, f.core.rate[s]
        if rate >= 0:
            x[offset] += x[rate] * dt
            for j in range(size):
                p[offset, j] += dt * p[rate, j]
            for i in range(size):
                p[i, offset] += dt * p[i, rate]
