"""What the estimator of paths is measured against: the channel of given paths, and their joint Cramér-Rao bound.

Set of paths, seven real parameters each (distance, azimuth, elevation, Re and Im of the H weight and of the V weight):
information (2 / sigma^2) Re(J^H J). Every column of J is an array vector times a delay vector (Kronecker), so J^H J is
the product, element by element, of two small Gram matrices.

Source: channel, the extended FastSLAM paper, equation 2; bound, Kay, "Fundamentals of statistical signal processing:
estimation theory", 1993, chapter 15 (complex Gaussian data); products of small matrices: Richter, "Estimation of radio
channel parameters: models and algorithms", 2005.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, unit_vector
from cellslam.sim.lte.array import AntennaArray, Complex, Floats, PathSet

PARAMETERS = 7  # of a path in the joint bound


def frequency_response(
    array: AntennaArray, tones_hz: Floats, times_s: Floats, velocity_mps: ArrayLike, paths: PathSet, carrier_hz: float
) -> Complex:
    """Return the channel (ports, tones) of one transmit port (equation 2), in the unit of the paths' weights.

    `tones_hz` (tones,) in Hz; `times_s` (ports,) from `switching_times_s`: Doppler over the switched aperture is
    included; `velocity_mps` (3,) in m/s of the array in the body frame.
    """
    steering = array.steer(paths.azimuth_rad, paths.elevation_rad).value
    moving = doppler_phasors(times_s, velocity_mps, paths.azimuth_rad, paths.elevation_rad, carrier_hz)
    on_array = np.einsum("npq,nq->np", steering, paths.weights) * moving
    delay = np.exp(-2j * np.pi * np.outer(paths.distance_m, tones_hz) / SPEED_OF_LIGHT_MPS)
    return np.asarray(on_array.T @ delay, np.complex128)


def doppler_phasors(
    times_s: Floats, velocity_mps: ArrayLike, azimuth_rad: ArrayLike, elevation_rad: ArrayLike, carrier_hz: float
) -> Complex:
    """Return exp(j 2 pi nu t) (n, ports) of n directions for a receiver moving with body velocity (3,).

    nu = v . n / wavelength, n pointing to where the wave comes from; the phase is zero at the mean sampling time.
    """
    towards = np.atleast_2d(unit_vector(azimuth_rad, elevation_rad))
    shift_hz = towards @ np.asarray(velocity_mps, np.float64) * carrier_hz / SPEED_OF_LIGHT_MPS
    return np.asarray(np.exp(2j * np.pi * np.outer(shift_hz, times_s - times_s.mean())), np.complex128)


def fisher_information(array: AntennaArray, tones_hz: Floats, paths: PathSet, noise_variance: float) -> Floats:
    """Return (2 / sigma^2) Re(J^H J), (7 n, 7 n), a path's seven parameters in a row: m, rad, rad, weights."""
    steering = array.steer(paths.azimuth_rad, paths.elevation_rad)
    signal, by_azimuth, by_elevation = (np.einsum("npq,nq->np", s, paths.weights) for s in steering)
    h, v = steering.value[:, :, 0], steering.value[:, :, 1]
    on_array = np.stack([signal, by_azimuth, by_elevation, h, 1j * h, v, 1j * v], axis=1)
    delay = np.exp(-2j * np.pi * np.outer(paths.distance_m, tones_hz) / SPEED_OF_LIGHT_MPS)
    slope = -2j * np.pi * tones_hz / SPEED_OF_LIGHT_MPS * delay
    on_tones = np.stack([slope] + [delay] * (PARAMETERS - 1), axis=1)
    left, right = (factor.reshape(PARAMETERS * len(paths), -1).T for factor in (on_array, on_tones))
    gram = (left.conj().T @ left) * (right.conj().T @ right)
    return np.asarray(2.0 / noise_variance * gram.real, np.float64)


def joint_std(array: AntennaArray, tones_hz: Floats, paths: PathSet, noise_variance: float) -> Floats:
    """Return the joint bound's deviations (n, 3) of distance, azimuth and elevation, in m, rad, rad."""
    information = fisher_information(array, tones_hz, paths, noise_variance)
    scale = 1.0 / np.sqrt(np.diag(information))
    # Scaled to a unit diagonal: metres and radians differ by orders of magnitude.
    variance = np.diag(np.linalg.inv(information * np.outer(scale, scale))) * scale**2
    return np.asarray(np.sqrt(variance.reshape(len(paths), PARAMETERS)[:, :3]), np.float64)
