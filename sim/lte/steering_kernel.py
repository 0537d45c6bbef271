"""Compiled steering of the circular array, with the Doppler phase that motion adds over the switched aperture."""

from __future__ import annotations

import cmath
import math

from numba import njit

from cellslam.sim.frames_kernel import wrap
from cellslam.sim.lte.statistical.detector_layout import Array


@njit(cache=True, nogil=True)
def _soft_floor(loss: float, floor: float) -> tuple[float, float]:
    """Return x / (1 + (x / floor)^4)^(1/4) and its slope."""
    ratio = loss / floor
    base = 1.0 + ratio * ratio * ratio * ratio
    root = math.sqrt(math.sqrt(base))
    return loss / root, 1.0 / (base * root)


@njit(cache=True, nogil=True)
def steer_circular(
    azimuth: Array, elevation: Array, columns: int, rings: int, radius_m: float, spacing_m: float, wavenumber: float,
    peak_dbi: float, curve: float, floor_db: float, polarisation: Array, factor: Array, doppler: Array, velocity: Array,
    value: Array, by_azimuth: Array, by_elevation: Array,
) -> None:  # fmt: skip
    """Write steering vectors and derivatives, each (n, ports, 2), of n directions.

    `curve` of the element pattern in dB per rad^2; `polarisation` (2, 2) slants x (H, V); `factor` (ports,) complex
    per port; `doppler` (ports,) in rad per m/s; `velocity` (3,) of the body.
    """
    neper = math.log(10.0) / 20.0
    for n in range(len(azimuth)):
        ca, sa, ce, se = math.cos(azimuth[n]), math.sin(azimuth[n]), math.cos(elevation[n]), math.sin(elevation[n])
        rate = ce * (velocity[0] * ca + velocity[1] * sa) + velocity[2] * se
        rate_az = ce * (velocity[1] * ca - velocity[0] * sa)
        rate_el = velocity[2] * ce - se * (velocity[0] * ca + velocity[1] * sa)
        in_elevation, slope_e = _soft_floor(curve * elevation[n] * elevation[n], floor_db)
        for column in range(columns):
            off = wrap(azimuth[n] - 2.0 * math.pi * column / columns)
            co, so = math.cos(off), math.sin(off)
            in_azimuth, slope_a = _soft_floor(curve * off * off, floor_db)
            loss, slope = _soft_floor(in_azimuth + in_elevation, floor_db)
            size = math.exp(neper * (peak_dbi - loss))
            loss_az = neper * slope * slope_a * 2.0 * curve * off
            loss_el = neper * slope * slope_e * 2.0 * curve * elevation[n]
            for ring in range(rings):
                height = (ring - 0.5 * (rings - 1)) * spacing_m
                phase = wavenumber * (radius_m * ce * co + height * se)
                phase_az = -wavenumber * radius_m * ce * so
                phase_el = wavenumber * (height * ce - radius_m * se * co)
                for s in range(2):
                    port = 2 * (column * rings + ring) + s
                    response = size * cmath.exp(1j * (phase + doppler[port] * rate)) * factor[port]
                    d_az = complex(-loss_az, phase_az + doppler[port] * rate_az) * response
                    d_el = complex(-loss_el, phase_el + doppler[port] * rate_el) * response
                    for q in range(2):
                        value[n, port, q] = response * polarisation[s, q]
                        by_azimuth[n, port, q] = d_az * polarisation[s, q]
                        by_elevation[n, port, q] = d_el * polarisation[s, q]
