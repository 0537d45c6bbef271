"""Error bounds: the joint one against its Jacobian, the closed forms of one path against the joint one."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte import RadioConfig
from cellslam.sim.lte.array import CircularArray, PathSet
from cellslam.sim.lte.downlink import LteWaveform
from cellslam.sim.lte.error_bounds import bound_scales, single_path_std
from cellslam.sim.lte.statistical.detection_kernel import captured
from cellslam.sim.lte.statistical.statistical_front_end import model_of
from cellslam.sim.lte.statistical.statistics import statistics
from cellslam.sim.nr.nr_waveform import NrWaveform
from cellslam.sim.waveform import Waveform
from tools.front_end_reference import fisher_information, joint_std

TINY = CircularArray(columns=5, rings=2, radius_m=0.06)


def paths(*rows: tuple[float, float, float], level_db: tuple[float, ...] | None = None) -> PathSet:
    level = np.array(level_db or [0.0] * len(rows))
    columns = np.array(rows).T
    weights = 10.0 ** (level / 20.0)[:, None] * np.array([0.6 + 0.2j, 0.7 - 0.1j])
    return PathSet(columns[0], columns[1], columns[2], weights)


def test_joint_information_agrees_with_the_full_jacobian() -> None:
    tones, both = LteWaveform(6).tones_hz, paths((100.0, 0.3, 0.2), (140.0, -1.0, 0.1))

    def model(x: np.ndarray) -> np.ndarray:
        rows = x.reshape(2, 7)
        weights = rows[:, [3, 5]] + 1j * rows[:, [4, 6]]
        steering = np.einsum("npq,nq->np", TINY.steer(rows[:, 1], rows[:, 2]).value, weights)
        delay = np.exp(-2j * np.pi * np.outer(rows[:, 0], tones) / SPEED_OF_LIGHT_MPS)
        return np.asarray(sum(np.kron(s, d) for s, d in zip(steering, delay, strict=True)))

    weights = both.weights.view(np.float64)  # real, imaginary part of both polarisations
    x = np.column_stack([both.distance_m, both.azimuth_rad, both.elevation_rad, weights]).ravel()
    step = 1e-6
    jacobian = np.array([(model(x + step * e) - model(x - step * e)) / (2 * step) for e in np.eye(14)]).T
    expected = 2.0 / 0.3 * (jacobian.conj().T @ jacobian).real
    got = fisher_information(TINY, tones, both, 0.3)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize(("apart_m", "turn_deg"), [(3.0, 0.0), (6.0, 0.0), (4.0, 5.0), (0.5, 9.0)])
def test_statistical_overlap_follows_the_array(apart_m: float, turn_deg: float) -> None:
    a, b = (300.0, 0.4, 0.1), (300.0 + apart_m, 0.4 + np.radians(turn_deg), 0.1)
    tones, weights = LteWaveform().tones_hz, np.array([0.6 + 0.2j, 0.7 - 0.1j])

    def columns(distance: float, azimuth: float, elevation: float) -> np.ndarray:
        """Signal, its derivatives by distance and angles up to factors, and both polarisations of a path."""
        value, by_az, by_el = (s[0] for s in CircularArray().steer(azimuth, elevation))
        delay = np.exp(-2j * np.pi * tones * distance / SPEED_OF_LIGHT_MPS)
        signal = np.outer(value @ weights, delay)
        angles = (np.outer(slope @ weights, delay) for slope in (by_az, by_el))
        parts = [signal, signal * tones / 1e7, *angles, *(np.outer(one, delay) for one in value.T)]
        return np.stack([part.ravel() for part in parts], 1)

    signal = columns(*b)[:, 0]
    left = signal - columns(*a) @ np.linalg.lstsq(columns(*a), signal, rcond=1e-9)[0]
    exact = 1.0 - np.sum(np.abs(left) ** 2) / np.sum(np.abs(signal) ** 2)
    assert abs(captured(np.array(a), np.array(b), model_of(RadioConfig(), statistics())) - exact) < 0.05


@pytest.mark.parametrize(
    ("elevation_deg", "waveform"),
    [(0.0, LteWaveform()), (20.0, LteWaveform()), (0.0, LteWaveform(25)), (30.0, NrWaveform(48, 1, 6, 12))],
)
def test_closed_forms_of_one_path_are_the_joint_bound(elevation_deg: float, waveform: Waveform) -> None:
    array, elevation, numeric = CircularArray(), np.radians(elevation_deg), []
    for azimuth in (-2.3, 0.1, 1.7):
        one = paths((300.0, azimuth, elevation))
        signal = array.steer(azimuth, elevation).value[0] @ one.weights[0]
        tones = waveform.tones_hz - waveform.tones_hz.mean()
        numeric.append(joint_std(array, tones, one, float(np.mean(np.abs(signal) ** 2)))[0])
    np.testing.assert_allclose(single_path_std(0.0, elevation, waveform), np.mean(numeric, axis=0), rtol=0.03)


def test_worked_numbers_of_one_path() -> None:
    std = single_path_std(0.0)
    np.testing.assert_allclose(std[0], 0.0405, atol=5e-5)
    np.testing.assert_allclose(np.degrees(std[1:]), [0.0685, 0.0704], rtol=1e-12)
    np.testing.assert_allclose(single_path_std(-20.0, 0.3), 10.0 * single_path_std(0.0, 0.3), rtol=1e-12)
    assert bound_scales(LteWaveform(25)).samples == 128 * 50
