"""The signal that the switched array receives: the paper's equations 2 to 4 for one snapshot.

Powers are in milliwatt per resource element. One symbol of the slot is kept per array port, each port being sampled in
a slot of its own: the first carries the reference signals of antenna ports 0 and 1, the second those of 2 and 3.

Source: the extended FastSLAM paper, section II, equations 2 to 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation, rotation, unit_vector
from cellslam.sim.lte.array import AntennaArray, Complex, Floats, doppler_phasors
from cellslam.sim.lte.downlink.lte_waveform import pilots
from cellslam.sim.lte.downlink.ofdm import subcarrier_frequency_hz
from cellslam.sim.lte.downlink.reference_signals import SLOTS
from cellslam.sim.lte.joint_bound import PathSet

SUBCARRIERS_PER_BLOCK = 12


@dataclass(frozen=True)
class Impairments:
    """What the air adds: noise power per element, other elements' load, transmitters' error vector
    magnitude.
    """

    noise_mw: float
    load: float = 0.0
    evm: float = 0.0


@dataclass(frozen=True)
class PortSignal:
    """One cell's antenna port as it arrives: paths with weights in sqrt(mW), offsets of its site's clock and
    carrier.
    """

    cell_id: int
    port: int
    paths: PathSet
    clock_offset_m: float = 0.0
    carrier_offset_hz: float = 0.0


def arriving_paths(
    pose: Floats,
    vt_m: Floats,
    gain: Complex,
    slant: Floats,
    amplitude: Floats,
    carrier_hz: float,
) -> PathSet:
    """Return the paths (n,) of one transmit port in the body frame of `pose` (6,); m and rad.

    `vt_m` (n, 3); `gain` (n, 2, 2) [received, sent] in the (H, V) of the world frame; `slant` (2,) of the
    transmit port; `amplitude` (n,) in sqrt(mW): radiated power and sector antenna. Weights carry the
    propagation phase, and are turned into the (H, V) of the body frame.
    """
    towards = vt_m - pose[:3]
    distance = np.linalg.norm(towards, axis=1)
    body = towards @ rotation(*pose[3:])
    (az_world, el_world), (az, el) = azimuth_elevation(towards), azimuth_elevation(body)
    turn = np.einsum("npi,ij,nqj->nqp", polarisation(az_world, el_world), rotation(*pose[3:]), polarisation(az, el))
    phase = np.exp(-2j * np.pi * distance * carrier_hz / SPEED_OF_LIGHT_MPS)
    weights = (amplitude * phase)[:, None] * np.einsum("nqp,npr,r->nq", turn, gain, slant)
    return PathSet(distance, az, el, weights)


def polarisation(azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> Floats:
    """Return the unit vectors (n, 2, 3) of H (growing azimuth) and V (growing elevation) of n directions."""
    az, el = np.asarray(azimuth_rad, np.float64), np.asarray(elevation_rad, np.float64)
    h = unit_vector(az + 0.5 * np.pi, np.zeros_like(az))
    v = unit_vector(az, el + 0.5 * np.pi)
    return np.stack([h, v], axis=-2)


def frequency_response(
    array: AntennaArray,
    tones_hz: Floats,
    times_s: Floats,
    velocity_mps: ArrayLike,
    signal: PortSignal,
    carrier_hz: float,
) -> Complex:
    """Return the channel (ports, tones) of one transmit port (equation 2), in roots of mW, Doppler over the switched
    aperture included.

    `tones_hz` (tones,) in Hz; `times_s` (ports,) from `switching_times_s`; `velocity_mps` (3,) in m/s of the array in
    the body frame.
    """
    paths = signal.paths
    steering = array.steer(paths.azimuth_rad, paths.elevation_rad).value
    moving = doppler_phasors(times_s, velocity_mps, paths.azimuth_rad, paths.elevation_rad, carrier_hz)
    on_array = np.einsum("npq,nq->np", steering, paths.weights) * moving
    length = paths.distance_m + signal.clock_offset_m
    delay = np.exp(-2j * np.pi * np.outer(length, tones_hz) / SPEED_OF_LIGHT_MPS)
    drift = np.exp(2j * np.pi * signal.carrier_offset_hz * (times_s - times_s.mean()))
    return np.asarray(drift[:, None] * (on_array.T @ delay), np.complex128)


def received_symbol(
    array: AntennaArray,
    times_s: Floats,
    slots: ArrayLike,
    velocity_mps: ArrayLike,
    signals: list[PortSignal],
    impairments: Impairments,
    resource_blocks: int,
    carrier_hz: float,
    rng: np.random.Generator,
    symbol: int = 0,
) -> Complex:
    """Return one symbol's elements (ports, 12 N_RB) of a snapshot in roots of mW, all cells summed (equation 4).

    `slots` (ports,): slot of the frame in which each array port is sampled. Reference elements carry each port's own
    signal, the cell's other ports being silent there; a share `load` of a cell's other elements carries data. Raises
    InputError where no antenna port has a reference signal in the symbol: 0 and 1 send in the first, 2 and 3 in the
    second.
    """
    count = SUBCARRIERS_PER_BLOCK * resource_blocks
    tones = subcarrier_frequency_hz(np.arange(count), resource_blocks)
    slot = np.asarray(slots, np.int64) % SLOTS
    total = _complex_normal(rng, (array.ports, count), impairments.noise_mw)
    for signal in signals:
        listed = {other.port for other in signals if other.cell_id == signal.cell_id}
        if symbol not in (0, 1) or not listed & set(_senders(symbol)):
            raise InputError(
                f"antenna port {signal.port} of cell {signal.cell_id} has no reference signal in symbol {symbol}: "
                "ports 0 and 1 send in symbol 0, ports 2 and 3 in symbol 1"
            )
        sent = _sent(signal, slot, count, impairments, rng, symbol)
        response = frequency_response(array, tones, times_s, velocity_mps, signal, carrier_hz)
        total += response * sent
    return total


def reference_response(received: Complex, cell_id: int, port: int, slots: ArrayLike, resource_blocks: int) -> Complex:
    """Return the least-squares channel (ports, 2 N_RB), in roots of mW as `received` (ports, 12 N_RB), of a cell's
    port: received over sent on its reference elements, of the symbol in which it first sends.
    """
    out = np.empty((len(received), 2 * resource_blocks), np.complex128)
    for row, slot in enumerate(np.asarray(slots, np.int64) % SLOTS):
        subcarriers, values = pilots(cell_id, port, int(slot), resource_blocks)
        out[row] = received[row, subcarriers] * values.conj()
    return out


def _senders(symbol: int) -> tuple[int, int]:
    """Return the antenna ports whose reference signal is in the first or second symbol of a slot."""
    return (0, 1) if symbol == 0 else (2, 3)


def _sent(
    signal: PortSignal, slot: np.ndarray[tuple[int, ...], np.dtype[np.int64]], count: int, impairments:
    Impairments, rng: np.random.Generator, symbol: int,
) -> Complex:  # fmt: skip
    """Return what one port sends (ports, count): data, its own reference signal, silence on the other
    ports'.
    """
    shape = (len(slot), count)
    carries = rng.random(shape) < impairments.load
    bits = rng.integers(0, 4, shape)
    # Two ports share the power of a data element; the reference elements of one port have all of it.
    sent = carries * np.exp(0.5j * np.pi * (bits + 0.5)) / np.sqrt(2.0)
    for row, s in enumerate(slot):
        for port in _senders(symbol):
            elements, values = pilots(signal.cell_id, port, int(s), count // SUBCARRIERS_PER_BLOCK)
            sent[row, elements] = values if port == signal.port else 0.0
    return np.asarray(sent + sent * _complex_normal(rng, shape, impairments.evm**2), np.complex128)


def _complex_normal(rng: np.random.Generator, shape: tuple[int, ...], power: float) -> Complex:
    """Return circular complex Gaussian numbers of mean power `power`."""
    pair = rng.standard_normal((*shape, 2)) * np.sqrt(0.5 * power)
    return np.asarray(pair[..., 0] + 1j * pair[..., 1], np.complex128)
