"""Cramér-Rao bound of a single path in closed form.

For the stacked uniform circular array and any tones: Gamma = N rho is the integrated SNR over N = 128 ports x tones
(LTE: 2 a resource block); rho is the mean SNR per sample. With unknown complex weights of both polarisations, delay,
azimuth and elevation decouple, and each deviation is scale / sqrt(2 Gamma). The scale is also the width of the path's
ambiguity function in that component.

Source: own derivation, docs/explanation/front-end.md, "Bound".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.statistical.detector_layout import AZIMUTH_EXPONENT, ELEVATION_GROWTH
from cellslam.sim.waveform.waveform import Waveform

ARRAY_PORTS = 128
# sd_az = 0.0685 deg and sd_el = 0.0704 deg at rho = 0 dB, elevation 0, Gamma = 25 600: 16 x 4 patches, 0.147
# m, 57.7 mm.
_AZIMUTH_SCALE_RAD = np.radians(0.0685) * np.sqrt(2.0 * 25_600.0)
_ELEVATION_SCALE_RAD = np.radians(0.0704) * np.sqrt(2.0 * 25_600.0)


@dataclass(frozen=True)
class BoundScales:
    """Deviation times sqrt(2 Gamma) at elevation 0, and the number of samples N = Gamma / rho."""

    samples: int
    distance_m: float
    azimuth_rad: float
    elevation_rad: float


def bound_scales(waveform: Waveform) -> BoundScales:
    """Return the scales of the single-path bound for a waveform; sd_d = c / (beta sqrt(2 Gamma))."""
    beta_radps = 2.0 * np.pi * float(np.std(waveform.tones_hz))
    samples = ARRAY_PORTS * len(waveform.tones_hz)
    return BoundScales(samples, SPEED_OF_LIGHT_MPS / beta_radps, float(_AZIMUTH_SCALE_RAD), float(_ELEVATION_SCALE_RAD))


def single_path_std(
    snr_db: ArrayLike, elevation_rad: ArrayLike = 0.0, waveform: Waveform | None = None
) -> NDArray[np.float64]:
    """Return bound deviations (..., 3) of distance in m, azimuth and elevation in rad, at the SNR per sample rho in
    dB; no waveform: LTE of 20 MHz.
    """
    scales = bound_scales(waveform or LteWaveform())
    rho, el = np.broadcast_arrays(
        10.0 ** (np.asarray(snr_db, np.float64) / 10.0), np.asarray(elevation_rad, np.float64)
    )
    root = np.sqrt(2.0 * scales.samples * rho)
    azimuth = scales.azimuth_rad / np.cos(el) ** AZIMUTH_EXPONENT
    elevation = scales.elevation_rad * (1.0 + ELEVATION_GROWTH * el**2)
    return np.stack([scales.distance_m / root, azimuth / root, elevation / root], axis=-1)
