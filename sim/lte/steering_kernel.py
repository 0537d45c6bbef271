"""Compiled steering of the circular array, with the Doppler phase that motion adds over the switched aperture.

Its NumPy twin is `array.CircularArray.steer`. Source: array and switching, the extended FastSLAM paper, section II;
element pattern, TR 38.901, Table 7.3-1; phasors: arguments reduced to an eighth of a turn in two parts, Cody and Waite
1980, Taylor series to degree 17.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.lte.statistical.detector_layout import Array

ANY_ORDER = {"reassoc", "contract", "nsz"}  # of sums: nothing is assumed about what is finite
_QUARTER_HIGH, _QUARTER_LOW = 1.5707963267341256, 6.077100506506192e-11  # their sum is pi / 2
# Taylor coefficients of sin(r) / r and cos(r) in r^2
_ODD = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(9))
_EVEN = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(9))


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


@part(fastmath=ANY_ORDER - {"reassoc"})
def write_phasors(angle: Array, cosine: Array, sine: Array) -> None:
    """Write cosine and sine (n,) of angles (n,) in rad, exact to 1e-15 up to some 100 000 rad."""
    for i in range(len(angle)):
        quarters = math.floor(angle[i] * (2.0 / math.pi) + 0.5)
        r = (angle[i] - quarters * _QUARTER_HIGH) - quarters * _QUARTER_LOW
        s = r * r
        odd, even = _ODD[8], _EVEN[8]
        for k in range(7, -1, -1):
            odd, even = odd * s + _ODD[k], even * s + _EVEN[k]
        odd = odd * r
        turned = quarters & 1
        c, d = (-odd, even) if turned else (even, odd)
        sign = -1.0 if quarters & 2 else 1.0
        cosine[i], sine[i] = sign * c, sign * d


@part
def _soft_floor(loss: float, floor: float) -> tuple[float, float]:
    """Return x / (1 + (x / floor)^4)^(1/4) and its slope."""
    ratio = loss / floor
    base = 1.0 + ratio * ratio * ratio * ratio
    root = math.sqrt(math.sqrt(base))
    return loss / root, 1.0 / (base * root)


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def steer_circular(
    azimuth: Array, elevation: Array, m: SteeringModel, value: Array, by_azimuth: Array, by_elevation: Array
) -> None:
    """Write steering vectors and their derivatives per rad, each (n, ports, 2), of n directions (n,) in rad."""
    velocity, doppler, ports = m.velocity, m.doppler, len(m.factor)
    neper = math.log(10.0) / 20.0
    size, loss_az, loss_el = np.empty(ports), np.empty(ports), np.empty(ports)
    phase, phase_az, phase_el = np.empty(ports), np.empty(ports), np.empty(ports)
    cosine, sine = np.empty(ports), np.empty(ports)
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
            strength = math.exp(neper * (m.peak_dbi - loss))
            for ring in range(m.rings):
                height = (ring - 0.5 * (m.rings - 1)) * m.spacing_m
                for port in range(2 * (column * m.rings + ring), 2 * (column * m.rings + ring) + 2):
                    size[port] = strength
                    loss_az[port] = neper * slope * slope_a * 2.0 * m.curve * off
                    loss_el[port] = neper * slope * slope_e * 2.0 * m.curve * elevation[n]
                    phase[port] = m.wavenumber * (m.radius_m * ce * co + height * se) + doppler[port] * rate
                    phase_az[port] = -m.wavenumber * m.radius_m * ce * so + doppler[port] * rate_az
                    phase_el[port] = m.wavenumber * (height * ce - m.radius_m * se * co) + doppler[port] * rate_el
        write_phasors(phase, cosine, sine)
        for port in range(ports):
            response = size[port] * complex(cosine[port], sine[port]) * m.factor[port]
            d_az = complex(-loss_az[port], phase_az[port]) * response
            d_el = complex(-loss_el[port], phase_el[port]) * response
            for q in range(2):
                share = m.polarisation[port & 1, q]
                value[n, port, q] = response * share
                by_azimuth[n, port, q] = d_az * share
                by_elevation[n, port, q] = d_el * share
