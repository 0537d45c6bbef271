"""Joint maximum-likelihood fit of several paths: Levenberg-Marquardt over distances and angles, weights eliminated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.array import Complex, Floats
from cellslam.sim.lte.climb_kernel import climb
from cellslam.sim.lte.receiver import Motion
from cellslam.sim.lte.refine_kernel import Normal, normal_equations

FINE_GAIN = 0.01  # noise variances: a hundredth of a nat
_ITERATIONS = 12
_LONGEST_STEP = np.array([6.0, np.radians(9.0), np.radians(9.0)])
_STEEPEST_RAD = np.radians(85.0)


@dataclass(frozen=True)
class Fit:
    """Paths (n,): `geometry` (n, 3) distance, azimuth, elevation; and the normal equations there."""

    geometry: Floats
    normal: Normal

    def __len__(self) -> int:
        return len(self.geometry)


def evaluate(y: Complex, motion: Motion, geometry: Floats) -> Fit:
    """Return the least-squares weights, information and gradient at a geometry (n, 3) of the samples (ports, tones)."""
    distance, azimuth, elevation = (np.ascontiguousarray(column) for column in geometry.T)
    steering = motion.steer(azimuth, elevation)
    return Fit(geometry, normal_equations(y, *steering, motion.receiver.rate, distance))


def refine(
    y: Complex, motion: Motion, geometry: Floats, noise_variance: float, least_gain: float = FINE_GAIN,
    promising: float = 0.0,
) -> Fit:  # fmt: skip
    """Return the joint fit that starts at `geometry` (n, 3); done when a step gains less than `least_gain` noise
    variances.

    It ends at once where neither the start nor what the first step promises reaches `promising` noise variances.
    """
    if motion.model is not None:
        climbed = climb(
            y, np.ascontiguousarray(geometry, np.float64), least_gain * noise_variance, _ITERATIONS,
            promising * noise_variance, _LONGEST_STEP * motion.receiver.coarser, float(_STEEPEST_RAD), motion.model,
        )  # fmt: skip
        return Fit(*climbed)
    return refine_any(y, motion, geometry, noise_variance, least_gain, promising)


def refine_any(
    y: Complex, motion: Motion, geometry: Floats, noise_variance: float, least_gain: float = FINE_GAIN,
    promising: float = 0.0,
) -> Fit:  # fmt: skip
    """Return the same as `refine`, step by step in NumPy, for any array."""
    fit, damping = evaluate(y, motion, geometry), 1e-3
    for iteration in range(_ITERATIONS):
        step, gain = _step(fit.normal, damping)
        hopeless = iteration == 0 and fit.normal.explained + gain < promising * noise_variance
        if gain < least_gain * noise_variance or hopeless:
            break
        trial = evaluate(y, motion, _moved(fit.geometry, step, motion.receiver.coarser))
        if trial.normal.explained > fit.normal.explained:
            fit, damping = trial, 0.1 * damping
        else:
            damping = max(10.0 * damping, 1e-3)
    return fit


def synthesise(motion: Motion, fit: Fit) -> Complex:
    """Return the samples (ports, tones) that the fitted paths explain."""
    ports, delays = factors(motion, fit)
    return np.asarray(ports.T @ delays, np.complex128)


def factors(motion: Motion, fit: Fit) -> tuple[Complex, Complex]:
    """Return what each fitted path gives the ports (n, ports) and the tones (n, tones)."""
    distance, azimuth, elevation = (np.ascontiguousarray(column) for column in fit.geometry.T)
    value = motion.steer(azimuth, elevation).value
    ports = value[:, :, 0] * fit.normal.weights[:, :1] + value[:, :, 1] * fit.normal.weights[:, 1:]
    return ports, np.asarray(np.exp(-1j * np.outer(distance, motion.receiver.rate)), np.complex128)


def covariance(fit: Fit, level: Floats) -> Floats:
    """Return the covariances (n, 3, 3) of each path's geometry at its disturbance per sample `level` (n,)."""
    information = 2.0 * fit.normal.information
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
    scaled = information * np.outer(scale, scale) + 1e-9 * np.eye(len(scale))
    n = len(fit)
    inverse = (np.linalg.inv(scaled) * np.outer(scale, scale)).reshape(n, 3, n, 3)
    own = inverse[np.arange(n), :, np.arange(n), :]
    return np.asarray(own * level[:, None, None], np.float64)


def _step(normal: Normal, damping: float) -> tuple[Floats, float]:
    """Return the damped Gauss-Newton step (n, 3) and the energy that it promises."""
    matrix = normal.information + np.diag(damping * np.diag(normal.information) + 1e-30)
    step = np.linalg.solve(matrix, normal.gradient)
    return step.reshape(-1, 3), float(step @ normal.gradient)


def _moved(geometry: Floats, step: Floats, coarser: Floats) -> Floats:
    """Return the geometry after a step, no component moving further than its limit."""
    moved = geometry + np.clip(step, -_LONGEST_STEP * coarser, _LONGEST_STEP * coarser)
    moved[:, 1] = wrap_angle(moved[:, 1])
    moved[:, 2] = np.clip(moved[:, 2], -_STEEPEST_RAD, _STEEPEST_RAD)
    return np.asarray(moved, np.float64)
