"""The receiver's antenna array: steering vectors of both polarisations with analytic derivatives, and its
switching.

An array answers for directions in the body frame: `steer` returns what each port receives of a unit wave
polarised along H (growing azimuth) and V (growing elevation).

Source: 128 ports switched every 0.5 ms after 11 ms of gain control, the extended FastSLAM paper, section II; pattern of
an element, TR 38.901, Table 7.3-1. Columns, rings and their distances are assumptions.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, wrap_angle

Complex = NDArray[np.complex128]
Floats = NDArray[np.float64]
PORT_INTERVAL_S = 0.5e-3
GAIN_CONTROL_S = 11e-3


class Steering(NamedTuple):
    """Responses (n, ports, 2) in (H, V), and their derivatives by azimuth and elevation, per radian."""

    value: Complex
    by_azimuth: Complex
    by_elevation: Complex


class AntennaArray(Protocol):
    """Anything that steers: geometric models and measured patterns alike."""

    @property
    def ports(self) -> int:
        """Number of switched ports."""
        ...

    def steer(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Steering:
        """Return the steering vectors (n, ports, 2) of n directions (n,) in rad."""
        ...


@dataclass(frozen=True)
class CircularArray:
    """Stacked uniform circular array of patches with two slants: ports = columns x rings x 2, in this order.

    Patches look outwards; pattern of TR 38.901, Table 7.3-1 with a smooth floor. `calibration` (ports,)
    complex factors that the receiver does not know; None: ideal.
    """

    columns: int = 16
    rings: int = 4
    radius_m: float = 0.147
    ring_spacing_m: float = 0.0577
    slant_deg: float = 45.0
    peak_dbi: float = 8.0
    width_deg: float = 65.0
    floor_db: float = 30.0
    carrier_hz: float = 2.66e9
    calibration: Complex | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.columns < 1 or self.rings < 1:
            raise InputError(f"an array of {self.columns} columns x {self.rings} rings has no element")
        if self.calibration is not None and self.calibration.shape != (self.ports,):
            raise InputError(f"calibration has shape {self.calibration.shape}, the array {self.ports} ports")

    @property
    def ports(self) -> int:
        """Number of switched ports."""
        return 2 * self.columns * self.rings

    def steer(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Steering:
        """Return the steering vectors (n, ports, 2) of n directions (n,) in the body frame, rad."""
        az, el = (
            np.atleast_1d(np.asarray(azimuth_rad, np.float64)),
            np.atleast_1d(np.asarray(elevation_rad, np.float64)),
        )
        value, by_azimuth, by_elevation = self._elements(az[:, None, None], el[:, None, None])
        polarisation = self.polarisation
        return Steering(*(self._ports_of(e, polarisation) for e in (value, by_azimuth, by_elevation)))

    def _elements(self, az: Floats, el: Floats) -> tuple[Complex, Complex, Complex]:
        """Return patch responses (n, columns, rings) without polarisation, and their derivatives."""
        facing = (2.0 * np.pi * np.arange(self.columns) / self.columns)[None, :, None]
        height = ((np.arange(self.rings) - 0.5 * (self.rings - 1)) * self.ring_spacing_m)[None, None, :]
        k = 2.0 * np.pi * self.carrier_hz / SPEED_OF_LIGHT_MPS
        off = np.asarray(wrap_angle(az - facing))
        phase = k * (self.radius_m * np.cos(el) * np.cos(off) + height * np.sin(el))
        phase_az = -k * self.radius_m * np.cos(el) * np.sin(off)
        phase_el = k * (height * np.cos(el) - self.radius_m * np.sin(el) * np.cos(off))
        loss_db, loss_az, loss_el = self._loss(off, el)
        value = 10.0 ** ((self.peak_dbi - loss_db) / 20.0) * np.exp(1j * phase)
        neper = np.log(10.0) / 20.0
        return value, value * (1j * phase_az - neper * loss_az), value * (1j * phase_el - neper * loss_el)

    def _loss(self, off: Floats, el: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the pattern's loss in dB under its peak, and its derivatives by azimuth and elevation."""
        curve = 12.0 / np.radians(self.width_deg) ** 2
        in_azimuth, slope_a = _smooth_floor(curve * off**2, self.floor_db)
        in_elevation, slope_e = _smooth_floor(curve * el**2, self.floor_db)
        loss, slope = _smooth_floor(in_azimuth + in_elevation, self.floor_db)
        return loss, slope * slope_a * 2.0 * curve * off, slope * slope_e * 2.0 * curve * el

    @property
    def polarisation(self) -> Floats:
        """Return (2, 2): per slant, its sensitivity to (H, V), without unit."""
        s = np.radians(self.slant_deg)
        return np.array([[np.sin(s), np.cos(s)], [-np.sin(s), np.cos(s)]])

    def _ports_of(self, elements: Complex, polarisation: Floats) -> Complex:
        ports = (elements[..., None, None] * polarisation).reshape(len(elements), self.ports, 2)
        return ports if self.calibration is None else ports * self.calibration[None, :, None]


def _smooth_floor(loss_db: Floats, floor_db: float) -> tuple[Floats, Floats]:
    """Return x / (1 + (x / floor)^4)^(1/4), a min(x, floor) with derivatives, and its slope."""
    base = 1.0 + (loss_db / floor_db) ** 4
    return loss_db * base**-0.25, base**-1.25


def array_at(carrier_hz: float) -> CircularArray:
    """Return the default array built for another carrier: its radius and the spacing of its rings follow the
    wavelength.
    """
    array = CircularArray()
    scale = array.carrier_hz / carrier_hz
    return replace(
        array, radius_m=scale * array.radius_m, ring_spacing_m=scale * array.ring_spacing_m, carrier_hz=carrier_hz
    )


def calibration_error(ports: int, phase_std_deg: float, gain_std_db: float, rng: np.random.Generator) -> Complex:
    """Return complex factors (ports,) of random phase and gain errors, one draw per port."""
    phase = np.radians(phase_std_deg) * rng.standard_normal(ports)
    gain_db = gain_std_db * rng.standard_normal(ports)
    return np.asarray(10.0 ** (gain_db / 20.0) * np.exp(1j * phase), np.complex128)


def miscalibrated(
    array: CircularArray, phase_std_deg: float, gain_std_db: float, rng: np.random.Generator
) -> CircularArray:
    """Return the array as it really is, where the receiver believes in `array`."""
    return replace(array, calibration=calibration_error(array.ports, phase_std_deg, gain_std_db, rng))


def switching_times_s(array: CircularArray, order: Literal["column", "ring"] = "column") -> Floats:
    """Return when each port is sampled (ports,), from the start of the snapshot: gain control, then 0.5 ms a
    port.

    "column": all rings of one column, then the next column; "ring": round one ring, then the next.
    """
    index = np.arange(array.ports).reshape(array.columns, array.rings, 2)
    if order == "ring":
        slots = index.transpose(1, 0, 2).reshape(-1)
    elif order == "column":
        slots = index.reshape(-1)
    else:
        raise InputError(f"switching order '{order}' is unknown (column, ring)")
    times = np.empty(array.ports)
    times[slots] = GAIN_CONTROL_S + PORT_INTERVAL_S * np.arange(array.ports)
    return times


def doppler_phasors(
    times_s: Floats,
    velocity_mps: ArrayLike,
    azimuth_rad: ArrayLike,
    elevation_rad: ArrayLike,
    carrier_hz: float,
) -> Complex:
    """Return exp(j 2 pi nu t) (n, ports) of n directions for a receiver moving with body velocity (3,).

    nu = v . n / wavelength, n pointing to where the wave comes from; the phase is zero at the mean sampling
    time.
    """
    az, el = (
        np.atleast_1d(np.asarray(azimuth_rad, np.float64)),
        np.atleast_1d(np.asarray(elevation_rad, np.float64)),
    )
    towards = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=-1)
    shift_hz = towards @ np.asarray(velocity_mps, np.float64) * carrier_hz / SPEED_OF_LIGHT_MPS
    return np.asarray(np.exp(2j * np.pi * np.outer(shift_hz, times_s - times_s.mean())), np.complex128)
