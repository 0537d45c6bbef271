"""Compiled: motion of a joint filter by mean body velocities, and what time and distance do to errors that persist."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.state.layout import DIFFUSE, OF_VT, POSE, ArrayErrors, Filter
from cellslam.slam.joint.state.states_kernel import fade
from cellslam.slam.model.matrices_kernel import Vec3, columns, mat_vec, put_mat, scaled, vec_minus, vec_scaled
from cellslam.slam.model.measurement_kernel import Rotations, rotations

NOTHING_DRAWN = np.full(POSE, -1, np.int64)
AREA = math.sqrt(math.pi / 2.0)  # exp(-x / (AREA l)) has the area of exp(-x^2 / (2 l^2))


class Interval(NamedTuple):
    """What the odometry says of `dt` (s): mean body velocities `measured` (6,), and the densities (6,) of its white
    `noise` and of its biases' `walk`; `drawn` (6,): indices of the states that the noise is summed up in because it
    will be drawn, -1 for none."""

    dt: float
    measured: Floats
    noise: Floats
    walk: Floats
    drawn: Ints = NOTHING_DRAWN


class Step(NamedTuple):
    """Memory for one step: `by` (6, core + 6): d(next pose)/d(core), and behind it d(next pose)/d(velocity); `rows`
    (6, n)."""

    by: Floats
    rows: Floats


@njit(cache=True, _nrt=False)  # dead reckoning's, too
def move(f: Filter, interval: Interval, w: Step) -> None:
    """Advance by an interval of dt > 0.

    The true velocity is (measured - bias - noise) / (1 + scale); the pose moves as in `frames.integrate_pose`.
    """
    _move_particles(f, interval)
    _move_pose(f, interval, w.by)
    _spread(f, interval, w)
    _drift(f, interval.dt)


@lean
def _velocity(f: Filter, interval: Interval, c: int, particle: int) -> float:
    """Return component c of the velocity, corrected by what a particle, or the mean (-1), knows of bias and scale."""
    bias, scale, d = f.core.bias[c], f.core.scale[c], f.particles.deviation
    given, factor = interval.measured[c], 1.0
    if bias >= 0:
        given -= f.x[bias] + (d[bias, particle] if particle >= 0 else 0.0)
    if scale >= 0:
        factor += f.x[scale] + (d[scale, particle] if particle >= 0 else 0.0)
    return float(given / factor)


@lean
def _course(f: Filter, interval: Interval, particle: int) -> tuple[Vec3, Vec3, Rotations]:
    """Return velocity, turn rate, and rotation in the middle of an interval, of a particle or the mean (-1)."""
    x, d, c, half = f.x, f.particles.deviation, particle, 0.5 * interval.dt
    ahead = Vec3(_velocity(f, interval, 0, c), _velocity(f, interval, 1, c), _velocity(f, interval, 2, c))
    turn = Vec3(_velocity(f, interval, 3, c), _velocity(f, interval, 4, c), _velocity(f, interval, 5, c))
    yaw, pitch, roll = x[3], x[4], x[5]
    if particle >= 0:
        yaw, pitch, roll = yaw + d[3, c], pitch + d[4, c], roll + d[5, c]
    return ahead, turn, rotations(yaw + half * turn.x, pitch + half * turn.y, roll + half * turn.z)


@lean
def _move_particles(f: Filter, interval: Interval) -> None:
    """Move the pose of each particle with its own biases and scales; what is left is how it differs from the mean's.

    Called before the mean's pose moves, whose next value is computed here, too.
    """
    d, dt = f.particles.deviation, interval.dt
    if len(f.particles.weight) == 0:
        return
    ahead, mean_turn, middle = _course(f, interval, -1)
    mean = mat_vec(middle.r, ahead)
    for c in range(len(f.particles.weight)):
        ahead, turn, middle = _course(f, interval, c)
        off, turned = vec_minus(mat_vec(middle.r, ahead), mean), vec_minus(turn, mean_turn)
        d[0, c], d[1, c], d[2, c] = d[0, c] + dt * off.x, d[1, c] + dt * off.y, d[2, c] + dt * off.z
        d[3, c], d[4, c], d[5, c] = d[3, c] + dt * turned.x, d[4, c] + dt * turned.y, d[5, c] + dt * turned.z


@lean
def _move_pose(f: Filter, interval: Interval, by: Floats) -> None:
    """Move the pose, and write the Jacobians of where it gets to."""
    x, core, dt, half = f.x, f.core, interval.dt, 0.5 * interval.dt
    ahead, turn, middle = _course(f, interval, -1)
    displacement = vec_scaled(mat_vec(middle.r, ahead), dt)
    turned = scaled(
        columns(mat_vec(middle.by_psi, ahead), mat_vec(middle.by_theta, ahead), mat_vec(middle.by_phi, ahead)), dt
    )
    by[:] = 0.0
    by_velocity = by[:, core.size :]
    put_mat(by[:, 3:], turned)
    put_mat(by_velocity, scaled(middle.r, dt))
    put_mat(by_velocity[:, 3:], scaled(turned, half))
    for c in range(POSE):
        by[c, c] = 1.0
        if c >= 3:
            by_velocity[c, c] = dt
        share = 1.0 / (1.0 + (x[core.scale[c]] if core.scale[c] >= 0 else 0.0))
        velocity = _velocity(f, interval, c, -1)
        for r in range(POSE):
            by_velocity[r, c] *= share
            if core.bias[c] >= 0:
                by[r, core.bias[c]] = -by_velocity[r, c]
            if core.scale[c] >= 0:
                by[r, core.scale[c]] = -by_velocity[r, c] * velocity
    x[0] += displacement.x
    x[1] += displacement.y
    x[2] += displacement.z
    x[3] += turn.x * dt
    x[4] += turn.y * dt
    x[5] += turn.z * dt


@lean
def _spread(f: Filter, interval: Interval, w: Step) -> None:
    """P <- F P F^T + Q: F changes the pose only, and most of its entries are zero."""
    p, core, n, by, rows = f.p, f.core, f.size[0], w.by, w.rows
    for r in range(POSE):
        rows[r, :n] = 0.0
        for c in range(core.size):
            factor = by[r, c]
            if factor != 0.0 and p[c, c] > 0.0:
                row, other = rows[r], p[c]
                for i in range(n):
                    row[i] += factor * other[i]
    for r in range(POSE):
        for i in range(POSE, n):
            p[r, i] = rows[r, i]
            p[i, r] = rows[r, i]
    noise, drawn, dt = interval.noise, interval.drawn, interval.dt
    for r in range(POSE):
        for s in range(r, POSE):
            total = 0.0
            for c in range(core.size):
                total += rows[r, c] * by[s, c]
            for c in range(POSE):
                total += by[r, core.size + c] * by[s, core.size + c] * noise[c] * noise[c] / dt
            p[r, s] = total
            p[s, r] = total
    for c in range(POSE):
        index, variance = core.noise[c], noise[c] * noise[c]
        if index >= 0:
            p[index, index] += variance * dt
            for r in range(POSE):
                p[r, index] -= by[r, core.size + c] * variance
                p[index, r] = p[r, index]
        if drawn[c] >= 0:
            _sum_up(f, w, interval, c)
        if core.bias[c] >= 0:
            p[core.bias[c], core.bias[c]] += interval.walk[c] * interval.walk[c] * dt


@lean
def _sum_up(f: Filter, w: Step, interval: Interval, c: int) -> None:
    """Add the interval's white noise of component c to the state that will be drawn, and to what goes with it."""
    p, index, other = f.p, interval.drawn[c], f.core.noise[c]
    variance = interval.noise[c] * interval.noise[c]
    p[index, index] += variance * interval.dt
    if other >= 0:
        p[index, other] += variance * interval.dt
        p[other, index] = p[index, other]
    for r in range(POSE):
        p[r, index] -= w.by[r, f.core.size + c] * variance
        p[index, r] = p[r, index]


@lean
def _drift(f: Filter, dt: float) -> None:
    """Let the clock offsets run on at their rates, and both walk."""
    x, p, n = f.x, f.p, f.size[0]
    for s in range(len(f.core.rate)):
        offset, rate = f.core.first_offset + s, f.core.rate[s]
        if rate >= 0:
            x[offset] += x[rate] * dt
            for c in range(len(f.particles.weight)):
                f.particles.deviation[offset, c] += dt * f.particles.deviation[rate, c]
            for j in range(n):
                p[offset, j] += dt * p[rate, j]
            for i in range(n):
                p[i, offset] += dt * p[i, rate]
        walk, rate_walk = f.core.wander[0, s] ** 2 * dt, f.core.wander[1, s] ** 2 * dt
        p[offset, offset] += walk + rate_walk * dt * dt / 3.0
        if rate >= 0:
            p[rate, rate] += rate_walk
            p[offset, rate] += 0.5 * rate_walk * dt
            p[rate, offset] = p[offset, rate]


@lean
def forget(f: Filter, a: ArrayErrors, moved: float, dt: float) -> None:
    """Let what persists be redrawn after a distance (m) and a time (s): diffuse errors, turns, pitch and roll."""
    kept = math.exp(-moved / (AREA * a.diffuse_m)) if a.diffuse_m > 0.0 else 0.0
    width = f.vts.state.shape[1]
    for index in range(f.core.size, f.size[0]):
        owner = f.owner[index]
        if kept < 1.0 and owner <= OF_VT and (OF_VT - owner) % width >= DIFFUSE:
            fade(f, index, kept, 1.0)
    if f.core.sway[0] >= 0 and dt > 0.0:
        kept = math.exp(-dt / (AREA * a.sway_s))
        for c in range(3):
            fade(f, f.core.sway[c], kept, a.sway[c] ** 2)
    for c in range(2):
        if a.tilt[c] > 0.0 and dt > 0.0:
            fade(f, 4 + c, math.exp(-dt / (AREA * a.tilt_s)), a.tilt[c] ** 2)
