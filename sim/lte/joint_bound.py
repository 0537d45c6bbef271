"""Joint Cramer-Rao bound of any set of paths: delay, angles and two complex weights each.

Source: Kay, "Fundamentals of statistical signal processing: estimation theory", 1993, chapter 15 (complex Gaussian
data); products of small matrices: Richter, "Estimation of radio channel parameters: models and algorithms", 2005.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.array import AntennaArray, Complex, Floats

PARAMETERS = 7  # distance, azimuth, elevation, Re and Im of the H weight, Re and Im of the V weight


@dataclass(frozen=True)
class PathSet:
    """Paths (n,) at the array: length in m, direction in the body frame, weights (n, 2) of the received (H,
    V) field.
    """

    distance_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    weights: Complex

    def __len__(self) -> int:
        return len(self.distance_m)


def fisher_information(array: AntennaArray, tones_hz: Floats, paths: PathSet, noise_variance: float) -> Floats:
    """Return (2 / sigma^2) Re(J^H J), (7 n, 7 n), a path's seven parameters in a row: m, rad, rad, weights.

    Every column of J is an array vector times a delay vector (Kronecker), so J^H J is the product of two
    small Gram matrices.
    """
    on_array, on_tones = _factors(array, tones_hz, paths)
    gram = (on_array.conj().T @ on_array) * (on_tones.conj().T @ on_tones)
    return np.asarray(2.0 / noise_variance * gram.real, np.float64)


def joint_covariance(array: AntennaArray, tones_hz: Floats, paths: PathSet, noise_variance: float) -> Floats:
    """Return the bound on the covariance of distance, azimuth and elevation of all paths, (n, 3, n, 3) in m
    and rad.
    """
    information = fisher_information(array, tones_hz, paths, noise_variance)
    scale = 1.0 / np.sqrt(np.diag(information))
    # Scaled to a unit diagonal: metres and radians differ by orders of magnitude.
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    n = len(paths)
    return np.asarray(covariance.reshape(n, PARAMETERS, n, PARAMETERS)[:, :3, :, :3], np.float64)


def joint_std(array: AntennaArray, tones_hz: Floats, paths: PathSet, noise_variance: float) -> Floats:
    """Return the joint bound's deviations (n, 3) of distance, azimuth and elevation, in m, rad, rad."""
    covariance = joint_covariance(array, tones_hz, paths, noise_variance)
    return np.asarray(np.sqrt(np.einsum("iaia->ia", covariance)), np.float64)


def leftover(array: AntennaArray, tones_hz: Floats, path: PathSet, others: PathSet) -> float:
    """Return the share, a scalar, of one path's energy outside the tangent spaces of `others` (weights, delay, angles
    of each).
    """
    signal_array, signal_tones = _factors(array, tones_hz, path)
    weight = path.weights[0]
    own_array = signal_array[:, 3] * weight[0] + signal_array[:, 5] * weight[1]
    own_tones = signal_tones[:, 3]
    on_array, on_tones = _factors(array, tones_hz, others)
    complex_columns = np.array([PARAMETERS * p + c for p in range(len(others)) for c in (0, 1, 2, 3, 5)])
    on_array, on_tones = on_array[:, complex_columns], on_tones[:, complex_columns]
    gram = (on_array.conj().T @ on_array) * (on_tones.conj().T @ on_tones)
    scale = 1.0 / np.sqrt(np.diag(gram).real)
    cross = scale * (on_array.conj().T @ own_array) * (on_tones.conj().T @ own_tones)
    solved = np.linalg.lstsq(gram * np.outer(scale, scale), cross, rcond=1e-10)[0]
    energy = np.vdot(own_array, own_array).real * np.vdot(own_tones, own_tones).real
    return float(np.clip(1.0 - np.vdot(cross, solved).real / energy, 0.0, 1.0))


def _factors(array: AntennaArray, tones_hz: Floats, paths: PathSet) -> tuple[Complex, Complex]:
    """Return the array factors (ports, 7 n) and delay factors (tones, 7 n) of the Jacobian's columns."""
    steering = array.steer(paths.azimuth_rad, paths.elevation_rad)
    signal, by_azimuth, by_elevation = (np.einsum("npq,nq->np", s, paths.weights) for s in steering)
    h, v = steering.value[:, :, 0], steering.value[:, :, 1]
    on_array = np.stack([signal, by_azimuth, by_elevation, h, 1j * h, v, 1j * v], axis=1)
    delay = np.exp(-2j * np.pi * np.outer(paths.distance_m, tones_hz) / SPEED_OF_LIGHT_MPS)
    slope = -2j * np.pi * tones_hz / SPEED_OF_LIGHT_MPS * delay
    on_tones = np.stack([slope] + [delay] * (PARAMETERS - 1), axis=1)
    n = PARAMETERS * len(paths)
    return on_array.reshape(n, -1).T, on_tones.reshape(n, -1).T
