"""Measured array patterns as an effective aperture distribution function: a Fourier series on the sphere.

Source: Landmann, Del Galdo, "Efficient antenna description for MIMO channel modelling and estimation", 2004: patterns
sampled on a regular grid are continued over the poles, so that they are periodic in both angles; their
Fourier series interpolates them and gives exact derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.errors import InputError
from cellslam.sim.lte.array import Complex, Floats, Steering


@dataclass(frozen=True)
class EadfArray:
    """Fourier coefficients (ports, 2, M, N) of measured patterns over elevation modes (M,) and azimuth modes
    (N,).
    """

    coefficients: Complex
    elevation_modes: Floats
    azimuth_modes: Floats

    @property
    def ports(self) -> int:
        """Number of switched ports."""
        return int(self.coefficients.shape[0])

    def steer(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Steering:
        """Return the steering vectors (n, ports, 2) of n directions (n,) in the body frame, rad."""
        az, el = (
            np.atleast_1d(np.asarray(azimuth_rad, np.float64)),
            np.atleast_1d(np.asarray(elevation_rad, np.float64)),
        )
        wave_az = np.exp(1j * np.outer(az, self.azimuth_modes))
        wave_el = np.exp(1j * np.outer(el, self.elevation_modes))
        by_el = np.einsum("kM,pqMN->kpqN", wave_el, self.coefficients)
        slope_el = np.einsum("kM,pqMN->kpqN", 1j * self.elevation_modes * wave_el, self.coefficients)
        return Steering(
            np.einsum("kpqN,kN->kpq", by_el, wave_az),
            np.einsum("kpqN,kN->kpq", by_el, 1j * self.azimuth_modes * wave_az),
            np.einsum("kpqN,kN->kpq", slope_el, wave_az),
        )


def eadf_from_grid(patterns: Complex) -> EadfArray:
    """Return the array of patterns (ports, 2, E, A): elevations -90 to 90 degrees inclusive, azimuths from 0,
    360 left out.

    Raises InputError for a grid of another shape, or values that are not finite.
    """
    if patterns.ndim != 4 or patterns.shape[1] != 2 or patterns.shape[3] % 2 or patterns.shape[2] < 3:
        raise InputError(
            f"array patterns have shape {patterns.shape}: (ports, 2, elevations >= 3, an even number of "
            "azimuths) is expected"
        )
    if not np.isfinite(patterns).all():
        raise InputError("array patterns hold values that are not finite: give every port at every angle")
    azimuths = patterns.shape[3]
    # Over the pole, azimuth turns by 180 degrees and both unit vectors of polarisation change their sign.
    beyond = -np.roll(patterns[:, :, 1:-1][:, :, ::-1], azimuths // 2, axis=3)
    sphere = np.concatenate([patterns, beyond], axis=2)
    spectrum = np.fft.fft2(sphere, axes=(2, 3)) / (sphere.shape[2] * azimuths)
    elevation_modes = np.fft.fftfreq(sphere.shape[2], 1.0 / sphere.shape[2])
    # The grid starts at -90 degrees: move the origin of the series to elevation zero.
    spectrum = spectrum * np.exp(0.5j * np.pi * elevation_modes)[:, None]
    return EadfArray(spectrum, elevation_modes, np.fft.fftfreq(azimuths, 1.0 / azimuths))


def load_patterns(path: Path) -> EadfArray:
    """Return the array of an .npz file whose array `patterns` is what `eadf_from_grid` expects. Raises
    InputError.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            patterns = np.asarray(file["patterns"], np.complex128)
    except (OSError, ValueError, KeyError) as problem:
        raise InputError(
            f"array patterns {path} cannot be read ({problem}): an .npz with 'patterns' is expected"
        ) from problem
    return eadf_from_grid(patterns)
