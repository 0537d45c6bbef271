"""Compiled Levenberg-Marquardt climb of a joint path fit for the circular array; its NumPy twin is `refine_any`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.signal.path_estimator.joint_fit_kernel import Normal, normal_equations
from cellslam.sim.lte.signal.path_estimator.one_path_kernel import normal_equations_of_one
from cellslam.sim.lte.statistical.detector_layout import Array
from cellslam.sim.lte.steering_kernel import SteeringModel, steer_circular


class Steps(NamedTuple):
    """Limits of the climb: number of steps, the longest in m, rad, rad (3,), and the steepest elevation in rad."""

    most: int
    longest: Array
    steepest: float


@part
def steering(geometry: Array, m: SteeringModel) -> tuple[Array, Array, Array]:
    """Return steering vectors (n, ports, 2) of paths at `geometry` (n, 3), and their derivatives per rad."""
    shape = (len(geometry), len(m.factor), 2)
    value = np.empty(shape, np.complex128)
    by_azimuth, by_elevation = np.empty(shape, np.complex128), np.empty(shape, np.complex128)
    steer_circular(geometry[:, 1].copy(), geometry[:, 2].copy(), m, value, by_azimuth, by_elevation)
    return value, by_azimuth, by_elevation


@part
def evaluate_circular(y: Array, geometry: Array, m: SteeringModel) -> Normal:
    """Return the normal equations of a fit at `geometry` (n, 3) to `y` (ports, tones)."""
    value, by_azimuth, by_elevation = steering(geometry, m)
    if len(geometry) == 1:
        return normal_equations_of_one(y, value[0], by_azimuth[0], by_elevation[0], m.rate, geometry[0, 0])
    return normal_equations(y, value, by_azimuth, by_elevation, m.rate, geometry[:, 0].copy())


@njit(cache=True, nogil=True)
def climb(
    y: Array, start: Array, least_gain: float, promising: float, steps: Steps, m: SteeringModel
) -> tuple[Array, Normal]:
    """Return geometry (n, 3) in m, rad, rad and normal equations after the climb from `start` (n, 3) in the samples
    `y` (ports, tones); see `joint_fit.refine`. Energies as in `y`.
    """
    geometry = start.copy()
    normal = evaluate_circular(y, geometry, m)
    damping = 1e-3
    for iteration in range(steps.most):
        matrix = normal.information.copy()
        for i in range(len(matrix)):
            matrix[i, i] += damping * matrix[i, i] + 1e-30
        step = np.linalg.solve(matrix, normal.gradient)
        gain = 0.0
        for i in range(len(step)):
            gain += step[i] * normal.gradient[i]
        if gain < least_gain or (iteration == 0 and normal.explained + gain < promising):
            break
        moved = geometry.copy()
        for p in range(len(moved)):
            for c in range(3):
                moved[p, c] += min(max(step[3 * p + c], -steps.longest[c]), steps.longest[c])
            moved[p, 1] = wrap(moved[p, 1])
            moved[p, 2] = min(max(moved[p, 2], -steps.steepest), steps.steepest)
        trial = evaluate_circular(y, moved, m)
        if trial.explained > normal.explained:
            geometry, normal, damping = moved, trial, 0.1 * damping
        else:
            damping = max(10.0 * damping, 1e-3)
    return geometry, normal


@njit(cache=True, nogil=True)
def orthonormal_beams(steering: Array, weight: Array, apart: bool, out: Array) -> None:
    """Write the beams (2, K, P): conjugate orthonormal bases of what `steering` (2, K, P), its ports weighed by
    `weight` (2, P), does in each direction; `apart`: the two sets belong to different ports, thus orthogonal as they
    are.
    """
    for k in range(steering.shape[1]):
        h, v = steering[0, k] * weight[0], steering[1, k] * weight[1]
        h /= max(np.linalg.norm(h), 1e-30)
        if not apart:
            v -= np.vdot(h, v) * h
        v /= max(np.linalg.norm(v), 1e-30)
        out[0, k], out[1, k] = h.conj(), v.conj()
