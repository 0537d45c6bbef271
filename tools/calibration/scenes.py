"""Random scenes measured by the signal-level front end: what the statistical one is calibrated with and held against.

A scene is one snapshot of one site whose two ports send over a few paths; array errors and surroundings are drawn
again for every scene. Roof and attitude are left out: they enter both front ends alike.

Source: own derivation, studies/front-end-calibration.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.frames import unit_vector, wrap_angle
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.array import array_at, miscalibrated
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.error_bounds import bound_scales
from cellslam.sim.lte.links import Cells, cells_of, slant
from cellslam.sim.lte.persisting_errors import draw_fields
from cellslam.sim.lte.radio_config import NR_BANDS
from cellslam.sim.lte.signal.signal_front_end import GAIN_STD_DB, PHASE_STD_DEG, SignalLevel, signal_level
from cellslam.sim.lte.statistical import detector_layout as k
from cellslam.sim.lte.statistical.detector_layout import PathColumns, Streams
from cellslam.sim.lte.statistical.measurement_kernel import array_gain, path_power
from cellslam.sim.lte.statistical.statistical_front_end import detect
from cellslam.sim.lte.statistical.statistics import Statistics
from cellslam.sim.recording import Floats, Ints

PORTS = 2
_OFF = ("roof_azimuth_deg", "roof_elevation_deg", "attitude_azimuth_deg", "attitude_elevation_deg",
        "calibration_distance_m", "load", "evm")  # fmt: skip
OFF = dict.fromkeys(_OFF, 0.0)
# Blocks that are calibrated, and the carrier in Hz.
BANDS = {"lte": ((100,), 2.66e9), "nr": (tuple(NR_BANDS), 3.5e9)}
POSE = np.array([3.0, -2.0, 1.8, 0.4, 0.0, 0.0])


@dataclass(frozen=True)
class Sample:
    """Paths of many link-snapshots and what was reported. `gamma_db`, `detected`, `error` (P, 3), `link` of each path,
    its `geometry` (P, 3); `clutter` (C, 6): link, distance, azimuth, elevation, SNR in dB, not used; `links`: how many.
    """

    link: Ints
    geometry: Floats
    gamma_db: Floats
    detected: np.ndarray
    error: Floats
    claimed: Floats
    clutter: Floats
    links: int


def radio_of(technology: str = "lte", resource_blocks: int | None = None) -> RadioConfig:
    """Return the radio configuration of a band, none named: the widest. Raises InputError for one that is none."""
    bands, carrier_hz = BANDS[technology]
    blocks = resource_blocks or max(bands)
    if blocks not in bands:
        raise InputError(f"resource_blocks {blocks}: {technology} is calibrated at {', '.join(map(str, bands))}")
    return RadioConfig(
        front_end="signal", technology=technology, resource_blocks=blocks, carrier_hz=carrier_hz, snr_cap_db=60.0,
        clock_offset_std_m=0.0, **OFF,
    )  # fmt: skip


def config_of(ratio_db: float, radio: RadioConfig | None = None) -> RadioConfig:
    """Return the radio configuration of the scenes at a specular-to-diffuse ratio; none given: LTE's."""
    return (radio or radio_of()).model_copy(update={"specular_to_diffuse_db": ratio_db})


def finer_db(radio: RadioConfig) -> float:
    """Return by how many dB a path's integrated SNR is above that of LTE of 20 MHz at the same SNR per sample."""
    return float(10.0 * np.log10(bound_scales(radio.waveform()).samples / bound_scales(LteWaveform()).samples))


def cells() -> Cells:
    """Return one site with one cell of two ports."""
    cell = SimpleNamespace(cell_id=375, azimuth_deg=0.0, tilt_deg=0.0)
    return cells_of([SimpleNamespace(cells=[cell], ports=PORTS)])


def draw_paths(rng: np.random.Generator, rho_db: Floats, config: RadioConfig) -> PathColumns:
    """Draw one snapshot's paths (n,) of about the given SNR per sample on either port, 30 to 600 m long."""
    n = len(rho_db)
    distance = rng.uniform(30.0, 600.0, n)
    towards = unit_vector(rng.uniform(-np.pi, np.pi, n), rng.uniform(0.0, 0.6, n))
    loss_db = np.array([-10.0 * np.log10(array_gain(e)) for e in np.arcsin(towards[:, 2])])
    amplitude = 10.0 ** ((rho_db + 10.0 * np.log10(config.noise_mw()) - config.eirp_dbm + loss_db) / 20.0)
    # Any polarisation: a random unitary matrix, so that both ports arrive with the same power.
    mix = rng.standard_normal((n, 2, 2)) + 1j * rng.standard_normal((n, 2, 2))
    gain = amplitude[:, None, None] * np.linalg.qr(mix)[0]
    return PathColumns(np.array([0, n]), POSE[:3] + distance[:, None] * towards, gain, np.zeros((n, 2)))


def scenes_of(rng: np.random.Generator, count: int, config: RadioConfig) -> list[PathColumns]:
    """Draw scenes of two to eight paths, -32 to 12 dB; from as much integrated SNR on in other bands."""
    weakest = -32.0 - finer_db(config)
    return [draw_paths(rng, rng.uniform(weakest, 12.0, rng.integers(2, 9)), config) for _ in range(count)]


def gamma_of(paths: PathColumns, config: RadioConfig, port: int, geometry: Floats) -> Floats:
    """Return the integrated SNR (n,), without unit, that the link budget gives each path on a port."""
    power = np.array([
        path_power(gain, slant(np.array(port))) * array_gain(e)
        for gain, e in zip(paths.gain, geometry[:, 2], strict=True)
    ])  # fmt: skip
    ratio = 10.0 ** (config.eirp_dbm / 10.0) / config.noise_mw()
    return np.asarray(bound_scales(config.waveform()).samples * ratio * power, np.float64)


def signal_bench(config: RadioConfig) -> SignalLevel:
    """Return a signal-level front end whose array and surroundings each scene replaces."""
    rng = np.random.default_rng(0)
    return signal_level(config, cells(), np.zeros(1), draw_fields(config, 0.075, rng), rng)


def in_scene(front_end: SignalLevel, rng: np.random.Generator) -> SignalLevel:
    """Return the front end with another array and other surroundings."""
    array = miscalibrated(array_at(front_end.config.carrier_hz), PHASE_STD_DEG, GAIN_STD_DB, rng)
    surroundings = replace(front_end.surroundings, entropy=int(rng.integers(2**32)))
    return replace(front_end, array=array, surroundings=surroundings)


def measured_by_signals(
    config: RadioConfig, scenes: list[PathColumns], rng: np.random.Generator, advance: Callable[[int], None]
) -> Sample:
    """Return what the signal-level front end reports of the scenes."""
    base, tables, still = signal_bench(config), [], np.zeros(3)
    for number, paths in enumerate(scenes):
        tables.append(in_scene(base, rng).measure(paths, POSE, still, still, number, rng))
        advance(1)
    return collect(scenes, tables, base.config)


def measured_by_statistics(
    config: RadioConfig, scenes: list[PathColumns], rng: np.random.Generator, constants: Statistics | None = None
) -> Sample:
    """Return what the statistical front end reports of the scenes; fields that persist are redrawn each scene."""
    tables, site, own = [], cells(), config.model_copy(update={"front_end": "statistical"})
    for number, paths in enumerate(scenes):
        fields, streams = draw_fields(own, 0.075, rng, constants), Streams.spawn(rng)
        d = detect(own, site, paths, POSE[None], np.zeros(1), fields, streams, number, constants=constants)
        table = np.full((len(d.path), k.COLUMNS), np.nan)
        m = d.measurements
        for column, values in (
            (k.SNAPSHOT, m.snapshot), (k.LINK, m.link), (k.DISTANCE, m.distance_m), (k.AZIMUTH, m.azimuth_rad),
            (k.ELEVATION, m.elevation_rad), (k.SNR_DB, m.snr_db), (k.CLAIMED_STD, m.distance_std_m), (k.PATH, d.path),
        ):  # fmt: skip
            table[:, column] = values
        tables.append(table)
    return collect(scenes, tables, config)


def collect(scenes: list[PathColumns], tables: list[Floats], config: RadioConfig) -> Sample:
    """Return what became of each path and link, and the clutter, from a table (M, COLUMNS), m, rad, dB, per scene."""
    parts: dict[str, list[Floats]] = {name: [] for name in ("link", "geometry", "gamma", "found", "error", "claim")}
    clutter = []
    for number, (paths, table) in enumerate(zip(scenes, tables, strict=True)):
        geometry = geometry_of(paths)
        for port in range(PORTS):
            rows = table[table[:, k.LINK] == port]
            real = rows[rows[:, k.PATH] >= 0.0]
            error = np.full((len(geometry), 3), np.nan)
            which = real[:, k.PATH].astype(int)
            error[which] = real[:, [k.DISTANCE, k.AZIMUTH, k.ELEVATION]] - geometry[which]
            claim = np.full(len(geometry), np.nan)
            claim[which] = real[:, k.CLAIMED_STD]
            error[:, 1] = wrap_angle(error[:, 1])
            link = PORTS * number + port
            parts["link"].append(np.full(len(geometry), link))
            parts["geometry"].append(geometry)
            parts["gamma"].append(gamma_of(paths, config, port, geometry))
            parts["found"].append(np.isfinite(error[:, 0]))
            parts["error"].append(error)
            parts["claim"].append(claim)
            false = rows[rows[:, k.PATH] < 0.0][:, [k.LINK, k.DISTANCE, k.AZIMUTH, k.ELEVATION, k.SNR_DB, k.PATH]]
            false[:, 0] = link
            clutter.append(false)
    joined = {name: np.concatenate(value) for name, value in parts.items()}
    return Sample(
        joined["link"].astype(np.int64), joined["geometry"], 10.0 * np.log10(np.maximum(joined["gamma"], 1e-9)),
        joined["found"].astype(bool), joined["error"], joined["claim"], np.concatenate(clutter), PORTS * len(scenes),
    )  # fmt: skip


def geometry_of(paths: PathColumns) -> Floats:
    """Return distance, azimuth and elevation (n, 3), m, rad, rad, of a scene's paths at the array."""
    from cellslam.sim.lte.statistical.measurement_kernel import body_geometry

    out = np.empty((len(paths.vt_m), 3))
    for row, vt in zip(out, paths.vt_m, strict=True):
        body_geometry(POSE, vt, row)
    return out
