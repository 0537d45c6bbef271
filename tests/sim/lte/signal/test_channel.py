"""The channel: phases and polarisation by hand, scatterers, sums over many paths, what is added to the elements."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS, azimuth_elevation, rotation, unit_vector
from cellslam.sim.lte.array import CircularArray, switching_times_s
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.signal import symbol
from cellslam.sim.lte.signal.channel import SCATTERERS, Surroundings, arriving_paths
from cellslam.sim.lte.statistical.detector_layout import PathColumns
from cellslam.sim.nr.nr_waveform import NrWaveform
from cellslam.sim.rays.gain import polarisation_basis

ARRAY = CircularArray(columns=4, rings=2)
TIMES = switching_times_s(ARRAY)
CARRIER_HZ = 2.66e9
TONES = LteWaveform(25).tones_hz
HERE = np.array([0.0, 0.0, 1.8])


def test_arriving_field_is_the_same_vector_in_both_frames() -> None:
    rng = np.random.default_rng(4)
    pose = np.array([3.0, -2.0, 1.8, 0.7, 0.2, -0.3])
    vt, slant = rng.uniform(-200.0, 200.0, (5, 3)), np.array([1.0, 1.0]) / np.sqrt(2.0)
    gain = rng.normal(size=(5, 2, 2)) + 1j * rng.normal(size=(5, 2, 2))
    paths = arriving_paths(pose, vt, gain, slant, np.full(5, 2.0), CARRIER_HZ)
    towards = vt - pose[:3]
    phase = np.exp(-2j * np.pi * np.linalg.norm(towards, axis=1) * CARRIER_HZ / SPEED_OF_LIGHT_MPS)
    world = (
        2.0
        * phase[:, None]
        * np.einsum("pni,np->ni", polarisation_basis(unit_vector(*azimuth_elevation(towards))), gain @ slant)
    )
    body = np.einsum(
        "pni,np->ni", polarisation_basis(unit_vector(paths.azimuth_rad, paths.elevation_rad)), paths.weights
    )
    np.testing.assert_allclose(body @ rotation(*pose[3:]).T, world, atol=1e-9)


@pytest.mark.parametrize("azimuth", [-2.0, 0.0, 1.0])
def test_polarisation_is_a_right_handed_frame(azimuth: float) -> None:
    h, v = polarisation_basis(unit_vector(azimuth, 0.4))
    np.testing.assert_allclose(np.cross(h, v), unit_vector(azimuth, 0.4), atol=1e-12)


def gain_of(vt: NDArray[np.float64]) -> NDArray[np.complex128]:
    return (0.113 / (4.0 * np.pi * np.linalg.norm(vt - HERE, axis=1))[:, None, None] * np.eye(2)).astype(complex)


@pytest.mark.parametrize("scatterers", [SCATTERERS, 313])
def test_scatterers_carry_the_diffuse_power_and_stand_still(scatterers: int) -> None:
    vt = np.array([[-150.0, 60.0, 35.0], [-60.0, 260.0, 30.0], [120.0, -160.0, 40.0]])
    paths, power = PathColumns(np.array([0, 2, 3]), vt, gain_of(vt), np.zeros((3, 2))), []
    for entropy in range(60):
        more = Surroundings(entropy, 6.0, scatterers).add(paths, HERE)
        assert more.rows.tolist() == [0, 2 * (scatterers + 1), 3 * (scatterers + 1)]
        power.append((np.abs(more.gain[1 : scatterers + 1]) ** 2).sum() / (np.abs(more.gain[0]) ** 2).sum())
        np.testing.assert_array_equal(more.vt_m[:: scatterers + 1], vt)
        excess = np.linalg.norm(more.vt_m[1 : scatterers + 1] - HERE, axis=1)
        assert (excess > np.linalg.norm(vt[0] - HERE) - 15.0).all()
    assert abs(np.mean(power) / 10.0**-0.6 - 1.0) < 0.06
    near = Surroundings(3, 6.0).add(paths, HERE + np.array([0.5, 0.3, 0.0]))
    np.testing.assert_array_equal(near.vt_m, Surroundings(3, 6.0).add(paths, HERE).vt_m)
    none = PathColumns(np.zeros(2, int), np.zeros((0, 3)), np.zeros((0, 2, 2)), np.zeros((0, 2)))
    assert Surroundings(3, 6.0).add(none, HERE) is none


@pytest.mark.parametrize(
    ("paths", "tones_hz", "transforms"),
    [
        (symbol.MANY_PATHS + 44, NrWaveform(272).tones_hz, True),
        (300, LteWaveform().tones_hz, False),
        (50, NrWaveform(272).tones_hz, False),
    ],
)
def test_sums_over_paths_are_their_formula(paths: int, tones_hz: NDArray[np.float64], transforms: bool) -> None:
    rng = np.random.default_rng(paths)
    weights = (rng.standard_normal((3, paths, 2)) @ [1.0, 1j]).astype(np.complex64)
    # Paths before and far behind the first.
    length = np.append(rng.uniform(-400.0, 2600.0, paths - 2), [0.0, 9993.0])
    exact = weights @ np.exp(-2j * np.pi * np.outer(length, tones_hz) / SPEED_OF_LIGHT_MPS)
    sums = symbol.PathSums(length, tones_hz)
    assert sums._transforms == transforms
    np.testing.assert_allclose(sums.of(weights), exact, atol=1e-4 * np.abs(exact).std())
    every = np.zeros_like(weights)
    every[:, ::5] = weights[:, ::5]
    np.testing.assert_allclose(sums.of_every(5, weights[:, ::5]), sums.of(every), atol=1e-4 * np.abs(exact).std())


def test_what_is_added_to_the_elements_is_its_formula() -> None:
    rng = np.random.default_rng(5)
    normal = rng.standard_normal((4, 7, 2), np.float32)
    response, every = ((rng.standard_normal((n, 7, 2)) @ [1.0, 1j]).astype(np.complex64) for n in (4, 3))
    words, slots = rng.integers(0, 65536, (4, 7), np.uint16), np.array([2, 0, 2, 1])
    total, variance = np.zeros((4, 7), np.complex64), np.full((4, 7), np.float32(0.5))
    symbol.add_pilots(total, variance, response, every, slots, 0.1)
    pilots = response * every[slots]
    np.testing.assert_allclose(total, pilots, rtol=1e-6)
    symbol.add_data(total, response, words, 0.4, 2.0)
    qpsk = np.where(words & 1, 1.0, -1.0) + 1j * np.where(words & 2, 1.0, -1.0)
    expected = pilots + np.where(words >> 2 < 0.4 * 16384, response * qpsk * np.sqrt(2.0), 0.0)
    np.testing.assert_allclose(total, expected, rtol=1e-6)
    symbol.add_noise(total, variance, normal)
    # Noise, and what the transmitter errs by, are drawn as one.
    deviation = np.sqrt(0.5 + 0.01 * np.abs(pilots) ** 2)
    np.testing.assert_allclose(total, expected + deviation * (normal @ [1.0, 1j]), rtol=1e-5)
