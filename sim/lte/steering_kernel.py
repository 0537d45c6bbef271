"""Compiled steering of the circular array, with the Doppler phase that motion adds over the switched aperture.

Its NumPy twin is `array.CircularArray.steer`. Source: array and switching, the extended FastSLAM paper, section II;
element pattern, TR 38.901, Table 7.3-1.
"""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

from cellslam.sim.compiling import njit
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.statistical.detector_layout import Array


class SteeringModel(NamedTuple):
    """The ideal circular array in motion, as the receiver knows it.

    `curve` of the element pattern in dB per rad^2; `polarisation` (2, 2) slants x (H, V); `factor` (ports,) complex
    weight of each port; `doppler` (ports,) in rad per m/s; `velocity` (3,) of the body in m/s; `rate` (tones,) phase of
    each tone in rad per m.
    """

    columns: int
    rings: int
    radius_m: float
    spacing_m: float
    wavenumber: float
    peak_dbi: float
    curve: float
    floor_db: float
    polarisation: Array
    factor: Array
    doppler: Array
    velocity: Array
    rate: Array


@njit(cache=True, nogil=True)
def _soft_floor(loss: float, floor: float) -> tuple[float, float]:
    """Return x / (1 + (x / floor)^4)^(1/4) and its slope."""
    ratio = loss / floor
    base = 1.0 + ratio * ratio * ratio * ratio
    root = math.sqrt(math.sqrt(base))
    return loss / root, 1.0 / (base * root)


@njit(cache=True, nogil=True)
def steer_circular(
    azimuth: Array, elevation: Array, m: SteeringModel, value: Array, by_azimuth: Array, by_elevation: Array
) -> None:
    """Write steering vectors and their derivatives per rad, each (n, ports, 2), of n directions (n,) in rad."""
    velocity, doppler = m.velocity, m.doppler
    neper = math.log(10.0) / 20.0
    for n in range(len(azimuth)):
        ca, sa, ce, se = math.cos(azimuth[n]), math.sin(azimuth[n]), math.cos(elevation[n]), math.sin(elevation[n])
        rate = ce * (velocity[0] * ca + velocity[1] * sa) + velocity[2] * se
        rate_az = ce * (velocity[1] * ca - velocity[0] * sa)
        rate_el = velocity[2] * ce - se * (velocity[0] * ca + velocity[1] * sa)
        in_elevation, slope_e = _soft_floor(m.curve * elevation[n] * elevation[n], m.floor_db)
        for column in range(m.columns):
            off = wrap(azimuth[n] - 2.0 * math.pi * column / m.columns)
            co, so = math.cos(off), math.sin(off)
            in_azimuth, slope_a = _soft_floor(m.curve * off * off, m.floor_db)
            loss, slope = _soft_floor(in_azimuth + in_elevation, m.floor_db)
            size = math.exp(neper * (m.peak_dbi - loss))
            loss_az = neper * slope * slope_a * 2.0 * m.curve * off
            loss_el = neper * slope * slope_e * 2.0 * m.curve * elevation[n]
            for ring in range(m.rings):
                height = (ring - 0.5 * (m.rings - 1)) * m.spacing_m
                phase = m.wavenumber * (m.radius_m * ce * co + height * se)
                phase_az = -m.wavenumber * m.radius_m * ce * so
                phase_el = m.wavenumber * (height * ce - m.radius_m * se * co)
                for s in range(2):
                    port = 2 * (column * m.rings + ring) + s
                    response = size * cmath.exp(1j * (phase + doppler[port] * rate)) * m.factor[port]
                    d_az = complex(-loss_az, phase_az + doppler[port] * rate_az) * response
                    d_el = complex(-loss_el, phase_el + doppler[port] * rate_el) * response
                    for q in range(2):
                        value[n, port, q] = response * m.polarisation[s, q]
                        by_azimuth[n, port, q] = d_az * m.polarisation[s, q]
                        by_elevation[n, port, q] = d_el * m.polarisation[s, q]
