"""Odometry between keyframes: relative motion, its covariance, and how biases and scales change it.

Source: Lupton and Sukkarieh, "Visual-inertial-aided navigation for high-dynamic motion in built environments without
initial conditions", IEEE Trans. Robotics 28(1), 2012 (preintegration, with derivatives by the errors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import integrate_pose, rotation
from cellslam.sim.recording import Floats, Ints, OdometryModel

LEAST_STD = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3])  # rad, m: keeps the graph regular where a model has no noise
SMALL = 1e-5


@dataclass(frozen=True)
class Leg:
    """Motion from one keyframe to the next, over n snapshots.

    `inner` (n, 6): poses of the snapshots after the first keyframe in its frame, the last one the next keyframe; `std`
    (6,): deviations of rotation vector and translation in the frame of the end; `by_error` (6, e): how these change
    with each odometry error: biases, then scales.
    """

    inner: Floats
    std: Floats
    by_error: Floats

    @property
    def relative(self) -> Floats:
        """The end in the frame of the start, (6,), in m and rad."""
        end: Floats = self.inner[-1]
        return end


def errors_of(model: OdometryModel) -> tuple[Ints, Ints]:
    """Return the components of the odometry that have a bias (b,), and those that have a scale error (s,)."""
    return np.flatnonzero((model.bias > 0) | (model.bias_walk_density > 0)), np.flatnonzero(model.scale > 0)


def leg(velocity: Floats, dt_s: Floats, model: OdometryModel) -> Leg:
    """Return the motion at mean body velocities (n, 6), in m/s and rad/s, over intervals (n,) in s."""
    biased, scaled = errors_of(model)
    inner = _inner(velocity, dt_s)
    columns = []
    for component in biased:
        changed = velocity.copy()
        changed[:, component] -= SMALL
        columns.append(local(inner[-1], _inner(changed, dt_s)[-1]) / SMALL)
    for component in scaled:
        changed = velocity.copy()
        changed[:, component] /= 1.0 + SMALL
        columns.append(local(inner[-1], _inner(changed, dt_s)[-1]) / SMALL)
    # White noise: each interval's error, seen from the end; its lever makes a turn a sideways step.
    variance, ends = np.zeros(6), rotation(*inner[-1, 3:])
    for pose, dt in zip(inner, dt_s, strict=True):
        arm = ends.T @ (inner[-1, :3] - pose[:3])
        turn = (model.noise_density[[5, 4, 3]] ** 2) * dt
        variance[:3] += turn
        variance[3:] += model.noise_density[:3] ** 2 * dt
        variance[3:] += np.array([turn[2] * arm[1] ** 2, turn[2] * arm[0] ** 2, turn[1] * arm[0] ** 2])
    by_error = np.array(columns).T if columns else np.zeros((6, 0))
    return Leg(inner, np.sqrt(variance + LEAST_STD**2), by_error)


def local(a: Floats, b: Floats) -> Floats:
    """Return pose b in the frame of pose a, nearby: rotation vector (small angles, rad) and translation (m), (6,).

    a, b (6,): poses in m and rad.
    """
    ra, rb = rotation(*a[3:]), rotation(*b[3:])
    turned = ra.T @ rb
    vector = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    return np.concatenate([vector, ra.T @ (b[:3] - a[:3])])


def _inner(velocity: Floats, dt_s: Floats) -> Floats:
    pose, out = np.zeros(6), np.empty((len(velocity), 6))
    for n, (u, dt) in enumerate(zip(velocity, dt_s, strict=True)):
        pose = integrate_pose(pose, u, float(dt))
        out[n] = pose
    return out
