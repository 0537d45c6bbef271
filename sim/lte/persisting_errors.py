"""Which measurement errors are white and which persist, cause by cause, and the random fields of those that do.

A persisting error is the same for all links that meet it alike, and changes slowly: array calibration and roof
scattering are fixed functions of the direction in the body frame, diffuse energy is a function of the receiver's place
for each VT and port, motion of the array within a snapshot turns all its paths together.

Source: own derivation, docs/explanation/persisting-errors.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.lte.statistical.detector_layout import TRAIL_DECAY_M
from cellslam.sim.lte.statistical.measurement_kernel import Fields
from cellslam.sim.lte.statistical.statistics import LTE, Statistics, statistics_of
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Floats

WAVES = 32
# Waves over a VT's position in rad per m: so short that every VT has a field of its own.
_APART_RADPM = 40.0


@dataclass(frozen=True)
class Cause:
    """One cause of error: its deviations (3,) in m, rad, rad, and the scale over which it changes (0: white)."""

    name: str
    std: Floats
    scale: float


def causes(config: RadioConfig, constants: Statistics | None = None) -> tuple[Cause, ...]:
    """Return calibration and roof (scale in rad), diffuse energy (m), attitude (s); `constants`: other than shipped."""
    diffuse = _diffuse_floor(config, constants) * 10.0 ** (-config.specular_to_diffuse_db / 20.0)

    def angular(distance_m: float, azimuth_deg: float, elevation_deg: float) -> Floats:
        return np.array([distance_m, *np.radians([azimuth_deg, elevation_deg])])

    calibration = angular(
        config.calibration_distance_m, config.calibration_azimuth_deg, config.calibration_elevation_deg
    )
    roof = angular(0.0, config.roof_azimuth_deg, config.roof_elevation_deg)
    attitude = angular(0.0, config.attitude_azimuth_deg, config.attitude_elevation_deg)
    return (
        Cause("calibration", calibration, float(np.radians(config.calibration_correlation_deg))),
        Cause("roof", roof, float(np.radians(config.roof_correlation_deg))),
        Cause("diffuse", diffuse, config.diffuse_correlation_m),
        Cause("attitude", attitude, config.attitude_correlation_s),
    )


def _diffuse_floor(config: RadioConfig, constants: Statistics | None) -> Floats:
    """Return the deviations (3,) in m, rad, rad that diffuse energy as strong as its path causes.

    Where they were not measured, those of LTE of 20 MHz are scaled: the energy in a resolution cell disturbs a path, in
    amplitude its root, and draws the distance to the mean delay of that energy (studies/nr-drives.md).
    """
    floor = np.array((constants or statistics_of(config)).diffuse_floor)
    if config.statistics_file or config.statistics_band not in (LTE, ""):
        return floor
    (share, delay), (measured, measured_delay) = (
        _trail_within(SPEED_OF_LIGHT_MPS / waveform.bandwidth_hz) for waveform in (config.waveform(), LteWaveform())
    )
    return np.asarray(floor * np.sqrt(share / measured) * [delay / measured_delay, 1.0, 1.0], np.float64)


def _trail_within(cell_m: float) -> tuple[float, float]:
    """Return how much of a path's diffuse energy, which decays with delay, is in a cell behind it, and its mean delay
    in m."""
    share = -np.expm1(-cell_m / TRAIL_DECAY_M)
    return share, TRAIL_DECAY_M - cell_m / np.expm1(cell_m / TRAIL_DECAY_M)


def floors(config: RadioConfig, constants: Statistics | None = None) -> Floats:
    """Return the error floors (3,) in m, rad, rad: the variances of all causes, added."""
    return np.asarray(np.sqrt(sum(c.std**2 for c in causes(config, constants))), np.float64)


def white_floors(config: RadioConfig, constants: Statistics | None = None) -> Floats:
    """Return the part of the floors (3,), in m, rad, rad, that is redrawn for every measurement."""
    white = [c.std**2 for c in causes(config, constants) if c.scale == 0.0]
    return np.asarray(np.sqrt(sum(white, np.zeros(3))), np.float64)


def persisting_std(config: RadioConfig) -> Floats:
    """Return the marginal deviations (3,) in m, rad, rad of what persists."""
    return np.asarray(config.noise_scale * np.sqrt(floors(config) ** 2 - white_floors(config) ** 2), np.float64)


def draw_fields(
    config: RadioConfig, interval_s: float, rng: np.random.Generator, constants: Statistics | None = None
) -> Fields:
    """Draw a trial's receiver and surroundings. Every field has a Gaussian correlation, exp(-x^2 / (2 scale^2)).

    With `config.array_seed` the array's calibration is that of the seed, whatever `rng` is.
    """
    calibration, roof, diffuse, attitude = causes(config, constants)
    direction_scale = np.array([calibration.scale] * 3 + [roof.scale] * 2)
    direction_std = np.concatenate([calibration.std, roof.std[1:]])
    direction_wave, direction_phase = rng.standard_normal((5, WAVES, 3)), _phases(rng, (5, WAVES))
    if config.array_seed is not None:
        array_rng = stream(config.array_seed, 0, Stream.ARRAY)
        direction_wave[:3], direction_phase[:3] = (
            array_rng.standard_normal((3, WAVES, 3)),
            _phases(array_rng, (3, WAVES)),
        )
    place_wave, place_phase = rng.standard_normal((3, WAVES, 6)), _phases(rng, (3, WAVES))
    port_phase = _phases(rng, (3, WAVES, 4))
    time_wave, time_phase = rng.standard_normal((3, WAVES)), _phases(rng, (3, WAVES))
    place_wave[:, :, :3] *= _per_scale(diffuse.scale)
    place_wave[:, :, 3:] *= _APART_RADPM
    # Yaw moves azimuths; pitch and roll move elevations.
    turns = attitude.std[[1, 2, 2]]
    return Fields(
        direction_std=config.noise_scale * np.where(direction_scale > 0.0, direction_std, 0.0),
        direction_wave=direction_wave * np.array([_per_scale(s) for s in direction_scale])[:, None, None],
        direction_phase=direction_phase,
        place_std=config.noise_scale * diffuse.std * (diffuse.scale > 0.0),
        place_wave=place_wave,
        place_phase=place_phase,
        port_phase=port_phase,
        time_std=config.noise_scale * turns * (attitude.scale > 0.0),
        time_wave=time_wave * _per_scale(attitude.scale) * interval_s,
        time_phase=time_phase,
    )


def calibration_at(fields: Fields, directions: Floats) -> Floats:
    """Return the array's calibration errors (n, 3) in m, rad, rad at directions (n, 2): azimuth, elevation, body
    frame."""
    flat = np.cos(directions[:, 1])
    unit = np.stack([flat * np.cos(directions[:, 0]), flat * np.sin(directions[:, 0]), np.sin(directions[:, 1])])
    angle = np.einsum("fwi,in->nfw", fields.direction_wave[:3], unit) + fields.direction_phase[:3]
    return np.asarray(fields.direction_std[:3] * np.sqrt(2.0 / angle.shape[2]) * np.cos(angle).sum(axis=2))


def _per_scale(scale: float) -> float:
    return 1.0 / scale if scale > 0.0 else 0.0


def _phases(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    return rng.uniform(0.0, 2.0 * np.pi, shape)
