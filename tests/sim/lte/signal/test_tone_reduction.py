"""Fewer tones: what is kept of paths across the window, the noise, and where nothing may be reduced."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.signal.tone_reduction import MOST_LOSS_DB, reduction_of
from cellslam.sim.nr.nr_waveform import NrWaveform

WINDOW = (-50.0, 1700.0)


def tones_of(distance_m: float, tones_hz: np.ndarray) -> np.ndarray:
    return np.exp(-2j * np.pi * tones_hz * distance_m / SPEED_OF_LIGHT_MPS)


@pytest.mark.parametrize(
    ("waveform", "size"),
    [
        (NrWaveform(272), 4),
        (NrWaveform(48), 2),
        (NrWaveform(24, 1, 6, 12), 4),
        (NrWaveform(24, 1, 4, 12), 6),
    ],
)
def test_a_path_keeps_its_delay_and_nearly_all_of_its_energy(waveform: NrWaveform, size: int) -> None:
    tones = waveform.tones_hz
    reduction = reduction_of(tones, *WINDOW)
    assert reduction.size == size
    for distance in (*WINDOW, 300.0, 825.0):
        got = reduction.of(tones_of(distance, tones)[None])[0]
        left = got * tones_of(distance, reduction.tones_hz).conj()
        np.testing.assert_allclose(left, left[0], rtol=1e-9)
        loss_db = -10.0 * np.log10(np.sum(np.abs(got) ** 2) / len(tones))
        summed = len(reduction.taps) == size
        assert -0.03 <= loss_db < (0.15 if not summed else MOST_LOSS_DB if distance != 825.0 else 1e-9)


@pytest.mark.parametrize("waveform", [NrWaveform(272), NrWaveform(132)])
def test_a_filter_leaves_noise_white_and_nearly_all_of_the_band(waveform: NrWaveform) -> None:
    reduction = reduction_of(waveform.tones_hz, *WINDOW)
    overlap = [np.vdot(reduction.taps[4 * step :], reduction.taps[: -4 * step]) for step in range(1, 8)]
    assert np.linalg.norm(reduction.taps) == pytest.approx(1.0)
    assert np.abs(overlap).max() < 0.01
    assert np.ptp(reduction.tones_hz) > 0.98 * np.ptp(waveform.tones_hz)


def test_noise_per_sample_stays() -> None:
    rng, tones = np.random.default_rng(1), NrWaveform(24).tones_hz
    noise = (rng.standard_normal((64, len(tones), 2)) @ [1.0, 1j]) / np.sqrt(2.0)
    power = np.mean(np.abs(reduction_of(tones, *WINDOW).of(noise)) ** 2)
    assert abs(power - 1.0) < 5.0 / np.sqrt(64 * len(tones) / 2)


def test_lte_long_windows_and_uneven_tones_are_left_as_they_are() -> None:
    tones = NrWaveform(24).tones_hz
    uneven = tones + np.where(np.arange(len(tones)) % 7 == 3, 4e3, 0.0)
    lte = LteWaveform().tones_hz
    for kept, window in ((lte, WINDOW), (lte, (-5000.0, 6600.0)), (tones, (-50.0, 5000.0)), (uneven, WINDOW)):
        reduction, y = reduction_of(kept, *window), np.ones((2, len(kept)), complex)
        assert reduction.size == 1 and reduction.of(y) is y
