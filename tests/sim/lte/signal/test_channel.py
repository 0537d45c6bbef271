"""The received signal: phases and polarisation by hand, reference elements back to the channel, collisions,
noise.
"""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, rotation
from cellslam.sim.lte.array import CircularArray, switching_times_s
from cellslam.sim.lte.downlink.ofdm import subcarrier_frequency_hz
from cellslam.sim.lte.joint_bound import PathSet
from cellslam.sim.lte.signal.channel import (
    Impairments,
    PortSignal,
    arriving_paths,
    frequency_response,
    polarisation,
    received_symbol,
    reference_response,
)

ARRAY = CircularArray(columns=4, rings=2)
TIMES = switching_times_s(ARRAY)
SLOTS = np.arange(ARRAY.ports)
CARRIER_HZ = 2.66e9
BLOCKS = 25
TONES = subcarrier_frequency_hz(np.arange(12 * BLOCKS), BLOCKS)
STILL = np.zeros(3)


def one_path(distance: float = 300.0, level: float = 1.0, azimuth: float = 0.4) -> PathSet:
    return PathSet(
        np.array([distance]), np.array([azimuth]), np.array([0.1]), level * np.array([[0.6 + 0.2j, 0.7 - 0.1j]])
    )


def receive(signals: list[PortSignal], impairments: Impairments, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return received_symbol(ARRAY, TIMES, SLOTS, STILL, signals, impairments, BLOCKS, CARRIER_HZ, rng)


def test_one_path_is_steering_times_delay() -> None:
    paths = one_path()
    got = frequency_response(ARRAY, TONES, TIMES, STILL, PortSignal(375, 0, paths, clock_offset_m=-70.0), CARRIER_HZ)
    steering = ARRAY.steer(0.4, 0.1).value[0] @ paths.weights[0]
    delay = np.exp(-2j * np.pi * TONES * (300.0 - 70.0) / SPEED_OF_LIGHT_MPS)
    np.testing.assert_allclose(got, np.outer(steering, delay), rtol=1e-12)


def test_a_carrier_offset_acts_as_a_common_doppler() -> None:
    at_rest = PortSignal(375, 0, one_path(azimuth=0.0))
    level = PathSet(at_rest.paths.distance_m, np.zeros(1), np.zeros(1), at_rest.paths.weights)
    moving = frequency_response(ARRAY, TONES, TIMES, [2.0, 0.0, 0.0], PortSignal(375, 0, level), CARRIER_HZ)
    offset_hz = 2.0 * CARRIER_HZ / SPEED_OF_LIGHT_MPS
    shifted = PortSignal(375, 0, level, carrier_offset_hz=offset_hz)
    np.testing.assert_allclose(frequency_response(ARRAY, TONES, TIMES, STILL, shifted, CARRIER_HZ), moving, rtol=1e-9)


def test_reference_elements_give_the_channel_back() -> None:
    signals = [PortSignal(375, 0, one_path(300.0)), PortSignal(375, 1, one_path(300.0, 0.5))]
    received = receive(signals, Impairments(noise_mw=0.0))
    for signal in signals:
        got = reference_response(received, 375, signal.port, SLOTS, BLOCKS)
        first = 3 if signal.port == 0 else 0
        tones = TONES[first + 6 * np.arange(2 * BLOCKS)]
        expected = frequency_response(ARRAY, tones, TIMES, STILL, signal, CARRIER_HZ)
        np.testing.assert_allclose(got, expected, atol=1e-12)


def test_colliding_cells_interfere_and_others_do_not() -> None:
    weak, strong = PortSignal(375, 0, one_path()), one_path(500.0, 10.0)
    clean = reference_response(receive([weak], Impairments(0.0)), 375, 0, SLOTS, BLOCKS)
    for cell, collides in ((177, True), (178, False), (376, False)):
        both = receive([weak, PortSignal(cell, 0, strong), PortSignal(cell, 1, strong)], Impairments(0.0))
        seen = reference_response(both, 375, 0, SLOTS, BLOCKS)
        assert (np.abs(seen - clean).max() > 1.0) == collides


def test_noise_load_and_transmitter_error_have_their_power() -> None:
    quiet = PortSignal(375, 0, one_path(level=0.0))
    noise = receive([quiet], Impairments(noise_mw=0.2))
    assert abs(np.mean(np.abs(noise) ** 2) / 0.2 - 1.0) < 5.0 / np.sqrt(noise.size)
    other = PortSignal(376, 0, one_path())
    response = frequency_response(ARRAY, TONES, TIMES, STILL, other, CARRIER_HZ)
    share = np.mean(np.abs(response) ** 2)
    data = reference_response(receive([other], Impairments(0.0, load=0.3)), 375, 0, SLOTS, BLOCKS)
    assert abs(np.mean(np.abs(data) ** 2) / share / 0.15 - 1.0) < 0.15
    erred = reference_response(receive([other], Impairments(0.0, evm=0.1)), 376, 0, SLOTS, BLOCKS)
    true = reference_response(receive([other], Impairments(0.0)), 376, 0, SLOTS, BLOCKS)
    assert abs(np.mean(np.abs(erred / true - 1.0) ** 2) / 0.01 - 1.0) < 0.2


def test_arriving_field_is_the_same_vector_in_both_frames() -> None:
    rng = np.random.default_rng(4)
    pose = np.array([3.0, -2.0, 1.8, 0.7, 0.2, -0.3])
    vt, slant = rng.uniform(-200.0, 200.0, (5, 3)), np.array([1.0, 1.0]) / np.sqrt(2.0)
    gain = rng.normal(size=(5, 2, 2)) + 1j * rng.normal(size=(5, 2, 2))
    paths = arriving_paths(pose, vt, gain, slant, np.full(5, 2.0), CARRIER_HZ)
    towards = vt - pose[:3]
    az = np.arctan2(towards[:, 1], towards[:, 0])
    el = np.arctan2(towards[:, 2], np.hypot(towards[:, 0], towards[:, 1]))
    phase = np.exp(-2j * np.pi * np.linalg.norm(towards, axis=1) * CARRIER_HZ / SPEED_OF_LIGHT_MPS)
    world = 2.0 * phase[:, None] * np.einsum("npi,np->ni", polarisation(az, el), gain @ slant)
    body = np.einsum("npi,np->ni", polarisation(paths.azimuth_rad, paths.elevation_rad), paths.weights)
    np.testing.assert_allclose(body @ rotation(*pose[3:]).T, world, atol=1e-9)


@pytest.mark.parametrize("azimuth", [-2.0, 0.0, 1.0])
def test_polarisation_is_a_right_handed_frame(azimuth: float) -> None:
    h, v = polarisation(azimuth, 0.4)
    towards = np.array([np.cos(0.4) * np.cos(azimuth), np.cos(0.4) * np.sin(azimuth), np.sin(0.4)])
    np.testing.assert_allclose(np.cross(h, v), towards, atol=1e-12)


def test_ports_2_and_3_send_in_the_second_symbol() -> None:
    signals = [PortSignal(375, port, one_path(300.0, level)) for port, level in ((0, 0.8), (2, 1.0), (3, 0.5))]
    rng = np.random.default_rng(1)
    received = received_symbol(
        ARRAY, TIMES, SLOTS, STILL, signals, Impairments(noise_mw=0.0), BLOCKS, CARRIER_HZ, rng, symbol=1
    )
    for signal in signals[1:]:
        got = reference_response(received, 375, signal.port, SLOTS, BLOCKS)
        # v = 3 (n_s mod 2) + 3 (p - 2); 375 mod 6 = 3: the elements of a port move by three from slot to slot.
        for row, slot in enumerate(SLOTS):
            first = (3 * (slot % 2) + 3 * (signal.port - 2) + 3) % 6
            tones = TONES[first + 6 * np.arange(2 * BLOCKS)]
            expected = frequency_response(ARRAY, tones, TIMES, STILL, signal, CARRIER_HZ)
            np.testing.assert_allclose(got[row], expected[row], atol=1e-12)


@pytest.mark.parametrize(("port", "symbol"), [(2, 0), (0, 1), (0, 4)])
def test_a_port_without_signal_in_the_symbol_is_refused(port: int, symbol: int) -> None:
    with pytest.raises(InputError, match=f"antenna port {port} of cell 375 has no reference signal in symbol {symbol}"):
        received_symbol(
            ARRAY, TIMES, SLOTS, STILL, [PortSignal(375, port, one_path())], Impairments(0.0), BLOCKS, CARRIER_HZ,
            np.random.default_rng(1), symbol,
        )  # fmt: skip
