"""Compiled steering: what each port of an array receives of a wave, and the Doppler phase that motion adds meanwhile.

Response of port m to a wave from (azimuth, elevation), polarised along H (growing azimuth) or V (growing elevation):

    b_m = factor_m element_m exp(j doppler_m (velocity . n)),   n: unit vector to where the wave comes from

Elements are those of a stacked circular array (`Circle`), or a Fourier series on the sphere (`Series`).

Source: array and switching, the extended FastSLAM paper, section II; element pattern, TR 38.901, Table 7.3-1; series:
Landmann, Del Galdo, "Efficient antenna description for MIMO channel modelling and estimation", 2004; phasors: arguments
reduced to an eighth of a turn in two parts, Cody and Waite 1980, Taylor series to degree 17.
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


class Circle(NamedTuple):
    """Patches on stacked circles that look outwards: `curve` of their pattern in dB per rad^2; `polarisation` (2, 2)
    slants x (H, V). No columns: the elements are a `Series`.
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


class Series(NamedTuple):
    """Measured patterns: `coefficients` (M, 2 ports N) over elevation modes (M,), then port, (H, V) and azimuth modes
    (N,). No modes: the elements are a `Circle`.
    """

    coefficients: Array
    elevation_modes: Array
    azimuth_modes: Array


class SteeringModel(NamedTuple):
    """An array in motion, as the receiver knows it: its elements; `factor` (ports,) complex weight of each port;
    `doppler` (ports,) in rad per m/s; `velocity` (3,) of the body in m/s; `rate` (tones,) phase of each tone in rad
    per m.
    """

    circle: Circle
    series: Series
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
    """Return x / (1 + (x / floor)^4)^(1/4), a min(x, floor) with derivatives, and its slope."""
    ratio = loss / floor
    base = 1.0 + ratio * ratio * ratio * ratio
    root = math.sqrt(math.sqrt(base))
    return loss / root, 1.0 / (base * root)


@part
def _approach(azimuth: float, elevation: float, velocity: Array) -> tuple[float, float, float]:
    """Return the speed towards where a wave comes from in m/s, and its derivatives by azimuth and elevation."""
    ca, sa, ce, se = math.cos(azimuth), math.sin(azimuth), math.cos(elevation), math.sin(elevation)
    forward = velocity[0] * ca + velocity[1] * sa
    sideways = ce * (velocity[1] * ca - velocity[0] * sa)
    return ce * forward + velocity[2] * se, sideways, velocity[2] * ce - se * forward


@njit(cache=True, nogil=True, fastmath={"contract", "nsz"})
def steer(azimuth: Array, elevation: Array, m: SteeringModel) -> tuple[Array, Array, Array]:
    """Return steering vectors (n, ports, 2) in (H, V) of n directions (n,) in rad, and their derivatives per rad."""
    shape = (len(azimuth), len(m.factor), 2)
    value = np.empty(shape, np.complex128)
    by_azimuth, by_elevation = np.empty(shape, np.complex128), np.empty(shape, np.complex128)
    if m.circle.columns:
        _steer_circle(azimuth, elevation, m, value, by_azimuth, by_elevation)
    else:
        _steer_series(azimuth, elevation, m, value, by_azimuth, by_elevation)
    return value, by_azimuth, by_elevation


@part(fastmath={"contract", "nsz"})
def _steer_circle(
    azimuth: Array, elevation: Array, m: SteeringModel, value: Array, by_azimuth: Array, by_elevation: Array
) -> None:
    """Write the steering vectors (n, ports, 2) of a circular array and their derivatives."""
    c, doppler, ports = m.circle, m.doppler, len(m.factor)
    neper = math.log(10.0) / 20.0
    size, loss_az, loss_el = np.empty(ports), np.empty(ports), np.empty(ports)
    phase, phase_az, phase_el = np.empty(ports), np.empty(ports), np.empty(ports)
    cosine, sine = np.empty(ports), np.empty(ports)
    for n in range(len(azimuth)):
        ce, se = math.cos(elevation[n]), math.sin(elevation[n])
        rate, rate_az, rate_el = _approach(azimuth[n], elevation[n], m.velocity)
        in_elevation, slope_e = _soft_floor(c.curve * elevation[n] * elevation[n], c.floor_db)
        for column in range(c.columns):
            off = wrap(azimuth[n] - 2.0 * math.pi * column / c.columns)
            co, so = math.cos(off), math.sin(off)
            in_azimuth, slope_a = _soft_floor(c.curve * off * off, c.floor_db)
            loss, slope = _soft_floor(in_azimuth + in_elevation, c.floor_db)
            strength = math.exp(neper * (c.peak_dbi - loss))
            for ring in range(c.rings):
                height = (ring - 0.5 * (c.rings - 1)) * c.spacing_m
                for port in range(2 * (column * c.rings + ring), 2 * (column * c.rings + ring) + 2):
                    size[port] = strength
                    loss_az[port] = neper * slope * slope_a * 2.0 * c.curve * off
                    loss_el[port] = neper * slope * slope_e * 2.0 * c.curve * elevation[n]
                    phase[port] = c.wavenumber * (c.radius_m * ce * co + height * se) + doppler[port] * rate
                    phase_az[port] = -c.wavenumber * c.radius_m * ce * so + doppler[port] * rate_az
                    phase_el[port] = c.wavenumber * (height * ce - c.radius_m * se * co) + doppler[port] * rate_el
        write_phasors(phase, cosine, sine)
        for port in range(ports):
            response = size[port] * complex(cosine[port], sine[port]) * m.factor[port]
            d_az = complex(-loss_az[port], phase_az[port]) * response
            d_el = complex(-loss_el[port], phase_el[port]) * response
            for q in range(2):
                share = c.polarisation[port & 1, q]
                value[n, port, q] = response * share
                by_azimuth[n, port, q] = d_az * share
                by_elevation[n, port, q] = d_el * share


@part
def _steer_series(
    azimuth: Array, elevation: Array, m: SteeringModel, value: Array, by_azimuth: Array, by_elevation: Array
) -> None:
    """Write the steering vectors (n, ports, 2) of measured patterns and their derivatives."""
    s, ports, count = m.series, len(m.factor), len(m.series.azimuth_modes)
    for n in range(len(azimuth)):
        upwards = np.exp(1j * elevation[n] * s.elevation_modes).reshape(1, -1)
        # Over azimuth modes: the patterns at this elevation, and their derivative by it.
        level = (upwards @ s.coefficients).reshape(ports, 2, count)
        slope = ((1j * s.elevation_modes * upwards) @ s.coefficients).reshape(ports, 2, count)
        around = np.exp(1j * azimuth[n] * s.azimuth_modes)
        rate, rate_az, rate_el = _approach(azimuth[n], elevation[n], m.velocity)
        for port in range(ports):
            turn = m.factor[port] * np.exp(1j * m.doppler[port] * rate)
            for q in range(2):
                element, d_az, d_el = 0j, 0j, 0j
                for k in range(count):
                    element += level[port, q, k] * around[k]
                    d_az += level[port, q, k] * around[k] * 1j * s.azimuth_modes[k]
                    d_el += slope[port, q, k] * around[k]
                value[n, port, q] = element * turn
                by_azimuth[n, port, q] = (d_az + 1j * m.doppler[port] * rate_az * element) * turn
                by_elevation[n, port, q] = (d_el + 1j * m.doppler[port] * rate_el * element) * turn
