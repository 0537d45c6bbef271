"""The closed forms of the single-path bound against the Fisher information of the array they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.error_bounds import bound_scales, single_path_std
from cellslam.sim.nr.nr_waveform import NrWaveform

WAVELENGTH_M = SPEED_OF_LIGHT_MPS / 2.66e9


def response(azimuth: float, elevation: float) -> NDArray[np.complex128]:
    """16 columns x 4 rings of +-45 degree patches (128, 2): radius 147 mm, rings 57.7 mm apart, 8 dBi, 65
    degrees.
    """
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    rows = []
    for column in 2.0 * np.pi * np.arange(16) / 16:
        off = np.angle(np.exp(1j * (azimuth - column)))
        loss_db = min(12.0 * (np.degrees(off) / 65.0) ** 2 + 12.0 * (np.degrees(elevation) / 65.0) ** 2, 30.0)
        gain = 10.0 ** ((8.0 - loss_db) / 20.0)
        for ring in range(4):
            place = np.array([0.147 * np.cos(column), 0.147 * np.sin(column), 0.0577 * (ring - 1.5)])
            field = gain * np.exp(2j * np.pi / WAVELENGTH_M * (towards @ place)) / np.sqrt(2.0)
            rows += [(field, field), (-field, field)]
    return np.array(rows)


def fisher_std(azimuth: float, elevation: float, tones: NDArray[np.float64]) -> NDArray[np.float64]:
    """Square roots of the first three diagonal entries of the inverse Fisher information at rho = 0 dB."""
    step, weight = 1e-5, np.array([0.6 + 0.2j, 0.7 - 0.1j])
    here = response(azimuth, elevation)
    by_azimuth = (response(azimuth + step, elevation) - response(azimuth - step, elevation)) / (2.0 * step)
    by_elevation = (response(azimuth, elevation + step) - response(azimuth, elevation - step)) / (2.0 * step)
    signal, flat = here @ weight, np.ones(len(tones))
    columns = [
        np.kron(signal, -2j * np.pi * tones / SPEED_OF_LIGHT_MPS),
        np.kron(by_azimuth @ weight, flat),
        np.kron(by_elevation @ weight, flat),
    ]
    columns += [unit * np.kron(here[:, p], flat) for p in (0, 1) for unit in (1.0, 1j)]
    jacobian = np.array(columns).T
    information = 2.0 * np.real(jacobian.conj().T @ jacobian) / np.mean(np.abs(signal) ** 2)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))[:3]))


@pytest.mark.parametrize("elevation_deg", [0.0, 20.0, 30.0, 45.0])
def test_closed_forms_agree_with_the_fisher_information(elevation_deg: float) -> None:
    elevation = np.radians(elevation_deg)
    numeric = np.mean([fisher_std(a, elevation, LteWaveform(100).tones_hz) for a in (-2.3, 0.1, 1.7)], axis=0)
    np.testing.assert_allclose(single_path_std(0.0, elevation), numeric, rtol=0.02)


def test_worked_numbers_at_zero_decibel() -> None:
    std = single_path_std(0.0)
    np.testing.assert_allclose(std[0], 0.0405, atol=5e-5)
    np.testing.assert_allclose(np.degrees(std[1:]), [0.0685, 0.0704], rtol=1e-12)


def test_twenty_decibel_are_a_factor_of_ten() -> None:
    np.testing.assert_allclose(single_path_std(-20.0, 0.3), 10.0 * single_path_std(0.0, 0.3), rtol=1e-12)


def test_delay_bound_scales_with_bandwidth() -> None:
    narrow = LteWaveform(25).tones_hz
    numeric = fisher_std(0.4, 0.0, narrow)
    np.testing.assert_allclose(single_path_std(0.0, 0.0, LteWaveform(25))[0], numeric[0], rtol=1e-3)
    assert bound_scales(LteWaveform(25)).samples == 128 * 50


@pytest.mark.parametrize(("blocks", "comb", "symbols"), [(24, 4, 4), (48, 6, 12)])
def test_any_waveform_has_its_bound(blocks: int, comb: int, symbols: int) -> None:
    nr = NrWaveform(blocks, 1, comb, symbols)
    numeric = np.mean([fisher_std(a, 0.0, nr.tones_hz) for a in (-2.3, 0.1, 1.7)], axis=0)
    np.testing.assert_allclose(single_path_std(0.0, 0.0, nr), numeric, rtol=0.02)


def test_tones_leave_out_the_carrier() -> None:
    tones = LteWaveform(100).tones_hz
    assert tones[0] == -600 * 15e3
    assert tones[100] == 15e3  # subcarrier 600 sits right above the gap
    assert len(tones) == 200
    assert 0.0 not in tones
