"""Sums over many paths: the transform gives what the sum gives, and is left where tones or paths do not suit it."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.downlink.lte_waveform import LteWaveform
from cellslam.sim.lte.signal import path_sums
from cellslam.sim.lte.signal.path_sums import PathSums
from cellslam.sim.nr.nr_waveform import NrWaveform


def drawn(paths: int, tones_hz: np.ndarray) -> tuple[PathSums, np.ndarray, np.ndarray]:
    """Paths before and far behind the first, weights, and the sum as its formula says, in double precision."""
    rng = np.random.default_rng(paths)
    weights = (rng.standard_normal((3, paths, 2)) @ [1.0, 1j]).astype(np.complex64)
    length = np.append(rng.uniform(-400.0, 2600.0, paths - 2), [0.0, 9993.0])
    exact = weights @ np.exp(-2j * np.pi * np.outer(length, tones_hz) / SPEED_OF_LIGHT_MPS)
    return PathSums(length, tones_hz), weights, exact


@pytest.mark.parametrize("waveform", [NrWaveform(272), NrWaveform(132), NrWaveform(272, 2)])
def test_the_transform_is_the_sum(waveform: NrWaveform) -> None:
    sums, weights, exact = drawn(path_sums.MANY_PATHS + 44, waveform.tones_hz)
    assert sums._transforms
    np.testing.assert_allclose(sums.of(weights), exact, atol=1e-4 * np.abs(exact).std())
    every = np.zeros_like(weights)
    every[:, ::5] = weights[:, ::5]
    np.testing.assert_allclose(sums.of_every(5, weights), sums.of(every), atol=1e-4 * np.abs(exact).std())


@pytest.mark.parametrize(
    ("paths", "tones_hz"),
    [(300, LteWaveform().tones_hz), (300, NrWaveform(272, 1, 6, 12).tones_hz), (50, NrWaveform(272).tones_hz)],
)
def test_uneven_tones_and_few_paths_are_summed(paths: int, tones_hz: np.ndarray) -> None:
    sums, weights, exact = drawn(paths, tones_hz)
    assert not sums._transforms
    np.testing.assert_allclose(sums.of(weights), exact, atol=1e-4 * np.abs(exact).std())
