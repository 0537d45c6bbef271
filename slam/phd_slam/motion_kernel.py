"""Compiled: the density of a particle's next velocity, what a snapshot adds to it, a draw, and what the draw teaches.

Biases and scales of the odometry are Gaussian given the path, so that they are marginalised: one Kalman filter of two
states for each component. The measurements of a snapshot make the importance density (PHD-SLAM 2.0 and 3.0).

Sources: Schön, Gustafsson and Nordlund, "Marginalized particle filters for mixed linear/nonlinear state-space models",
IEEE Trans. Signal Processing 53(7), 2005; Kaltiokallio et al., "A multihypotheses importance density for SLAM in
cluttered scenarios", IEEE Trans. Robotics 40, 2024.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import lean
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats
from cellslam.slam.model import matrices_kernel as algebra
from cellslam.slam.model.matrices_kernel import Mat3, Sym3, Vec3, dot, mat_mat, mat_vec, vec_of
from cellslam.slam.model.measurement_kernel import Rotations, rotations
from cellslam.slam.phd_slam.map_kernel import Seen

BIAS, SCALE = 0, 1
LEAST = 1e-12


class Interval(NamedTuple):
    """What the odometry says of `dt` (s): mean body velocities `measured` (6,), and the densities (6,) of its white
    `noise` and of its biases' `walk`."""

    dt: float
    measured: Floats
    noise: Floats
    walk: Floats


class Moved(NamedTuple):
    """Where a velocity takes a pose: place, rotation with derivatives, d(place)/d(velocity), d(place)/d(rates); angles
    turn by `dt` times their rates."""

    place: Vec3
    turned: Rotations
    by_velocity: Mat3
    by_rates: Mat3
    dt: float


class Slopes(NamedTuple):
    """dh/d(velocity) and dh/d(rates), columns in units of their standard deviations."""

    velocity: Mat3
    rates: Mat3


@lean
def predict_velocity(error: Floats, error_variance: Floats, interval: Interval, mean: Floats, std: Floats) -> None:
    """Write mean and deviations (6,), in m/s and rad/s, of the true velocity: (measured - bias - noise) / (1 + scale).

    error (6, 2): means of bias and scale, error_variance (6, 3): their variances and, between, covariance; the biases
    walk.
    """
    for c in range(6):
        error_variance[c, 0] += interval.walk[c] ** 2 * interval.dt
        share = 1.0 / (1.0 + error[c, SCALE])
        mean[c] = v = (interval.measured[c] - error[c, BIAS]) * share
        known = error_variance[c, 0] + 2.0 * v * error_variance[c, 1] + v * v * error_variance[c, 2]
        std[c] = math.sqrt(max(known + interval.noise[c] ** 2 / interval.dt, 0.0)) * abs(share)


@lean
def learn(error: Floats, error_variance: Floats, interval: Interval, velocity: Floats) -> None:
    """Condition bias and scale of each component, error (6, 2) and error_variance (6, 3), on the velocity (6,) that was
    drawn, in m/s and rad/s."""
    for c in range(6):
        v = velocity[c]
        to_bias = error_variance[c, 0] + v * error_variance[c, 1]
        to_scale = error_variance[c, 1] + v * error_variance[c, 2]
        s = to_bias + v * to_scale + interval.noise[c] ** 2 / interval.dt
        if s > LEAST:
            e = (interval.measured[c] - v * (1.0 + error[c, SCALE]) - error[c, BIAS]) / s
            error[c, BIAS] += to_bias * e
            error[c, SCALE] += to_scale * e
            error_variance[c, 0] -= to_bias * to_bias / s
            error_variance[c, 1] -= to_bias * to_scale / s
            error_variance[c, 2] -= to_scale * to_scale / s


@lean
def moved(pose: Floats, velocity: Floats, dt: float) -> Moved:
    """Return where a pose (6,), in m and rad, is after `dt` (s) at body velocities (6,): the attitude at
    mid-interval turns them."""
    half, v = 0.5 * dt, vec_of(velocity)
    psi, theta, phi = pose[3], pose[4], pose[5]
    middle = rotations(psi + half * velocity[3], theta + half * velocity[4], phi + half * velocity[5])
    moving = mat_vec(middle.r, v)
    after = rotations(psi + dt * velocity[3], theta + dt * velocity[4], phi + dt * velocity[5])
    turning = algebra.columns(mat_vec(middle.by_psi, v), mat_vec(middle.by_theta, v), mat_vec(middle.by_phi, v))
    place = Vec3(pose[0] + dt * moving.x, pose[1] + dt * moving.y, pose[2] + dt * moving.z)
    return Moved(place, after, algebra.scaled(middle.r, dt), algebra.scaled(turning, half * dt), dt)


@lean
def put_pose(pose: Floats, velocity: Floats, at: Moved) -> None:
    """Write the pose (6,), in m and rad, that a velocity (6,) has led to."""
    pose[0], pose[1], pose[2] = at.place.x, at.place.y, at.place.z
    for c in range(3, 6):
        pose[c] = wrap(pose[c] + at.dt * velocity[c])


@lean
def _by_std(m: Mat3, std: Vec3) -> Mat3:
    """Return m diag(std)."""
    return Mat3(
        m.xx * std.x, m.xy * std.y, m.xz * std.z,
        m.yx * std.x, m.yy * std.y, m.yz * std.z,
        m.zx * std.x, m.zy * std.y, m.zz * std.z,
    )  # fmt: skip


@lean
def slopes(seen: Seen, mean: Vec3, at: Moved, std: Floats) -> Slopes:
    """Return how h changes with the velocity that has led here, whose deviations are `std` (6,) in m/s and rad/s."""
    w, r = algebra.vec_minus(mean, at.place), at.turned
    turned = algebra.columns(
        algebra.transposed_vec(r.by_psi, w), algebra.transposed_vec(r.by_theta, w), algebra.transposed_vec(r.by_phi, w)
    )
    by_angles = mat_mat(mat_mat(seen.by_place, r.r), turned)
    by_velocity = algebra.scaled(mat_mat(seen.by_place, at.by_velocity), -1.0)
    by_rates = algebra.mat_minus(algebra.scaled(by_angles, at.dt), mat_mat(seen.by_place, at.by_rates))
    return Slopes(_by_std(by_velocity, vec_of(std)), _by_std(by_rates, Vec3(std[3], std[4], std[5])))


@lean
def times(by: Slopes, x: Floats) -> Vec3:
    """Return the change of h, in m and rad, with a change x (6,) of the velocity in units of its deviations."""
    a, b = mat_vec(by.velocity, vec_of(x)), mat_vec(by.rates, Vec3(x[3], x[4], x[5]))
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@lean
def inform(by: Slopes, inverse: Sym3, e: Vec3, share: float, information: Floats, y: Floats) -> None:
    """Add share J^T S^-1 J to the lower triangle of the information (6, 6), and share J^T S^-1 e to y (6,); velocities
    in units of their deviations."""
    v, w = by
    j = (
        Vec3(v.xx, v.yx, v.zx), Vec3(v.xy, v.yy, v.zy), Vec3(v.xz, v.yz, v.zz),
        Vec3(w.xx, w.yx, w.zx), Vec3(w.xy, w.yy, w.zy), Vec3(w.xz, w.yz, w.zz),
    )  # fmt: skip
    for a in range(6):
        s = algebra.vec_scaled(algebra.sym_vec(inverse, j[a]), share)
        y[a] += dot(s, e)
        for b in range(a + 1):
            information[a, b] += dot(s, j[b])


@lean
def factorise(information: Floats, y: Floats, mean: Floats) -> None:
    """Turn the lower triangle of I + information (6, 6) into its Cholesky factor L, and write L^-T L^-1 y (6,) as mean
    (6,), in units of deviations."""
    for i in range(6):
        information[i, i] += 1.0
        for j in range(i + 1):
            total = information[i, j]
            for c in range(j):
                total -= information[i, c] * information[j, c]
            information[i, j] = math.sqrt(total) if i == j else total / information[j, j]
    for i in range(6):
        total = y[i]
        for c in range(i):
            total -= information[i, c] * mean[c]
        mean[i] = total / information[i, i]
    back(information, mean)


@lean
def back(factor: Floats, x: Floats) -> None:
    """Solve L^T x = x (6,) in place, in units of deviations; the lower triangle of `factor` (6, 6) is L."""
    for i in range(5, -1, -1):
        total = x[i]
        for c in range(i + 1, 6):
            total -= factor[c, i] * x[c]
        x[i] = total / factor[i, i]
