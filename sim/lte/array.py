"""The receiver's antenna array, modelled or measured: its steering vectors, its switching, its errors.

An array answers for directions in the body frame: `steer` returns what each port receives of a unit wave polarised
along H (growing azimuth) and V (growing elevation). `steering_kernel` has the formulas.

Source: 128 ports switched every 0.5 ms after 11 ms of gain control, the extended FastSLAM paper, section II; pattern of
an element, TR 38.901, Table 7.3-1; columns, rings and their distances are assumptions. Measured patterns: Landmann, Del
Galdo, "Efficient antenna description for MIMO channel modelling and estimation", 2004: patterns sampled on a regular
grid are continued over the poles, so that they are periodic in both angles; their Fourier series interpolates them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.steering_kernel import Circle, Series, SteeringModel, steer

Complex = NDArray[np.complex128]
ComplexSingle = NDArray[np.complex64]
Floats = NDArray[np.float64]
PORT_INTERVAL_S = 0.5e-3
GAIN_CONTROL_S = 11e-3
_NO_CIRCLE = Circle(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros((2, 2)))
_NO_SERIES = Series(np.zeros((0, 0), np.complex128), np.zeros(0), np.zeros(0))


class Steering(NamedTuple):
    """Responses (n, ports, 2) in (H, V), and their derivatives by azimuth and elevation, per radian."""

    value: Complex
    by_azimuth: Complex
    by_elevation: Complex


@dataclass(frozen=True)
class PathSet:
    """Paths (n,) at the array: length in m, direction in the body frame, weights (n, 2) of the received H and V."""

    distance_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    weights: Complex

    def __len__(self) -> int:
        return len(self.distance_m)


class AntennaArray(ABC):
    """An array of switched ports: a geometric model or measured patterns."""

    @property
    @abstractmethod
    def ports(self) -> int:
        """Number of switched ports."""

    @property
    @abstractmethod
    def elements(self) -> tuple[Circle, Series, Complex]:
        """What the kernels make steering vectors from: circle, series, and complex factors (ports,)."""

    def moving(self, factor: Complex, doppler: Floats, velocity_mps: Floats, rate: Floats) -> SteeringModel:
        """Return the array in motion, its ports weighed by `factor` (ports,): see `SteeringModel`."""
        circle, series, own = self.elements
        return SteeringModel(circle, series, own * factor, doppler, velocity_mps, rate)

    def steer(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Steering:
        """Return the steering vectors (n, ports, 2) of n directions (n,) in the body frame, rad."""
        azimuth, elevation = (np.array(angle, np.float64, ndmin=1) for angle in (azimuth_rad, elevation_rad))
        at_rest = self.moving(np.ones(self.ports, np.complex128), np.zeros(self.ports), np.zeros(3), np.zeros(0))
        return Steering(*steer(azimuth, elevation, at_rest))


@dataclass(frozen=True)
class CircularArray(AntennaArray):
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

    @property
    def elements(self) -> tuple[Circle, Series, Complex]:
        """The circle of patches, no series, and the calibration (ports,)."""
        slant = np.radians(self.slant_deg)
        circle = Circle(
            columns=self.columns, rings=self.rings, radius_m=self.radius_m, spacing_m=self.ring_spacing_m,
            wavenumber=2.0 * np.pi * self.carrier_hz / SPEED_OF_LIGHT_MPS, peak_dbi=self.peak_dbi,
            curve=float(12.0 / np.radians(self.width_deg) ** 2), floor_db=self.floor_db,
            polarisation=np.array([[np.sin(slant), np.cos(slant)], [-np.sin(slant), np.cos(slant)]]),
        )  # fmt: skip
        calibration = np.ones(self.ports, np.complex128) if self.calibration is None else self.calibration
        return circle, _NO_SERIES, calibration


@dataclass(frozen=True)
class EadfArray(AntennaArray):
    """Measured patterns as an effective aperture distribution function: Fourier coefficients (M, ports, 2, N) over
    elevation modes (M,) and azimuth modes (N,).
    """

    coefficients: Complex
    elevation_modes: Floats
    azimuth_modes: Floats

    @property
    def ports(self) -> int:
        """Number of switched ports."""
        return int(self.coefficients.shape[1])

    @property
    def elements(self) -> tuple[Circle, Series, Complex]:
        """No circle, the series of the patterns, and ones (ports,)."""
        flat = self.coefficients.reshape(len(self.elevation_modes), -1)
        return _NO_CIRCLE, Series(flat, self.elevation_modes, self.azimuth_modes), np.ones(self.ports, np.complex128)


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
    coefficients = np.ascontiguousarray(np.moveaxis(spectrum, 2, 0), np.complex128)
    return EadfArray(coefficients, elevation_modes, np.fft.fftfreq(azimuths, 1.0 / azimuths))


def array_at(carrier_hz: float) -> CircularArray:
    """Return the default array built for another carrier: its radius and the spacing of its rings follow the
    wavelength.
    """
    array = CircularArray()
    scale = array.carrier_hz / carrier_hz
    return replace(
        array, radius_m=scale * array.radius_m, ring_spacing_m=scale * array.ring_spacing_m, carrier_hz=carrier_hz
    )


def miscalibrated(
    array: CircularArray, phase_std_deg: float, gain_std_db: float, rng: np.random.Generator
) -> CircularArray:
    """Return the array as it really is, with random phase and gain errors, one draw per port; the receiver believes in
    `array`.
    """
    phase = np.radians(phase_std_deg) * rng.standard_normal(array.ports)
    gain_db = gain_std_db * rng.standard_normal(array.ports)
    return replace(array, calibration=np.asarray(10.0 ** (gain_db / 20.0) * np.exp(1j * phase), np.complex128))


def switching_times_s(array: CircularArray, order: Literal["column", "ring"] = "column") -> Floats:
    """Return when each port is sampled (ports,), from the start of the snapshot: gain control, then 0.5 ms a port.

    "column": all rings of one column, then the next column; "ring": round one ring, then the next.
    """
    if order not in ("column", "ring"):
        raise InputError(f"switching order '{order}' is unknown (column, ring)")
    slots = np.arange(array.ports).reshape(array.columns, array.rings, 2)
    if order == "ring":
        slots = slots.transpose(1, 0, 2)
    times = np.empty(array.ports)
    times[slots.reshape(-1)] = GAIN_CONTROL_S + PORT_INTERVAL_S * np.arange(array.ports)
    return times
