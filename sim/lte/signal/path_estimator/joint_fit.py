"""Joint maximum-likelihood fit of several paths: Levenberg-Marquardt over distances and angles, weights eliminated.

Source: RIMAX, Richter, "Estimation of radio channel parameters: models and algorithms", 2005; weights eliminated by
variable projection, Golub and Pereyra 1973, in the form of Kaufman 1975.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.array import Complex, Floats
from cellslam.sim.lte.signal.path_estimator.climb_kernel import Steps, climb
from cellslam.sim.lte.signal.path_estimator.joint_fit_kernel import Normal, inverse_information, normal_equations
from cellslam.sim.lte.signal.receiver import Motion, Receiver

FINE_GAIN = 0.01  # noise variances: a hundredth of a nat
MOST_STEPS = 12
LONGEST_STEP = np.array([6.0, np.radians(9.0), np.radians(9.0)])
STEEPEST_RAD = np.radians(85.0)


@dataclass(frozen=True)
class Fit:
    """Paths (n,): `geometry` (n, 3) distance, azimuth, elevation; the normal equations there; who receives them."""

    geometry: Floats
    normal: Normal
    motion: Motion

    def __len__(self) -> int:
        return len(self.geometry)

    @cached_property
    def factors(self) -> tuple[Complex, Complex]:
        """What each path gives the ports (n, ports) and the tones (n, tones)."""
        distance, azimuth, elevation = (np.ascontiguousarray(column) for column in self.geometry.T)
        value = self.motion.steer(azimuth, elevation).value
        ports = value[:, :, 0] * self.normal.weights[:, :1] + value[:, :, 1] * self.normal.weights[:, 1:]
        return ports, np.asarray(np.exp(-1j * np.outer(distance, self.motion.receiver.rate)), np.complex128)

    @property
    def samples(self) -> Complex:
        """The samples (ports, tones) that the paths explain."""
        ports, delays = self.factors
        return np.asarray(ports.T @ delays, np.complex128)


def evaluate(y: Complex, motion: Motion, geometry: Floats) -> Fit:
    """Return the least-squares weights, information and gradient at a geometry (n, 3), m, rad, rad, of `y` (ports,
    tones).
    """
    distance, azimuth, elevation = (np.ascontiguousarray(column) for column in geometry.T)
    steering = motion.steer(azimuth, elevation)
    return Fit(geometry, normal_equations(y, *steering, motion.receiver.rate, distance), motion)


def refine(
    y: Complex, motion: Motion, geometry: Floats, noise_variance: float, least_gain: float = FINE_GAIN,
    promising: float = 0.0,
) -> Fit:  # fmt: skip
    """Return the joint fit of `y` (ports, tones) that starts at `geometry` (n, 3), m, rad, rad; done when a step gains
    less than `least_gain` noise variances.

    It ends at once where neither the start nor what the first step promises reaches `promising` noise variances.
    """
    if motion.model is not None:
        climbed = climb(
            y, np.ascontiguousarray(geometry, np.float64), least_gain * noise_variance, promising * noise_variance,
            steps_of(motion.receiver), motion.model,
        )  # fmt: skip
        return Fit(*climbed, motion)
    return refine_any(y, motion, geometry, noise_variance, least_gain, promising)


def refine_any(
    y: Complex, motion: Motion, geometry: Floats, noise_variance: float, least_gain: float = FINE_GAIN,
    promising: float = 0.0,
) -> Fit:  # fmt: skip
    """Return the same as `refine` of `y` (ports, tones) at `geometry` (n, 3), m, rad, rad, in NumPy, for any array."""
    fit, damping = evaluate(y, motion, geometry), 1e-3
    for iteration in range(MOST_STEPS):
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


def covariance(fit: Fit, level: Floats) -> Floats:
    """Return the covariances (n, 3, 3) of each path's geometry (m, rad, rad) at its disturbance per sample `level`
    (n,).
    """
    n = len(fit)
    own = inverse_information(fit.normal.information).reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n), :]
    return np.asarray(own * level[:, None, None], np.float64)


def steps_of(receiver: Receiver) -> Steps:
    """Return the limits of a climb at the receiver's bandwidth."""
    return Steps(most=MOST_STEPS, longest=LONGEST_STEP * receiver.coarser, steepest=float(STEEPEST_RAD))


def _step(normal: Normal, damping: float) -> tuple[Floats, float]:
    """Return the damped Gauss-Newton step (n, 3) and the energy that it promises."""
    matrix = normal.information + np.diag(damping * np.diag(normal.information) + 1e-30)
    step = np.linalg.solve(matrix, normal.gradient)
    return step.reshape(-1, 3), float(step @ normal.gradient)


def _moved(geometry: Floats, step: Floats, coarser: Floats) -> Floats:
    """Return the geometry after a step, no component moving further than its limit."""
    moved = geometry + np.clip(step, -LONGEST_STEP * coarser, LONGEST_STEP * coarser)
    moved[:, 1] = wrap_angle(moved[:, 1])
    moved[:, 2] = np.clip(moved[:, 2], -STEEPEST_RAD, STEEPEST_RAD)
    return np.asarray(moved, np.float64)
