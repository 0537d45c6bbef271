"""Array model and measured patterns: derivatives, polarisation, switching, Doppler."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.array import (
    AntennaArray,
    CircularArray,
    array_at,
    eadf_from_grid,
    miscalibrated,
    switching_times_s,
)
from tools.front_end_reference import doppler_phasors

TINY = CircularArray(columns=5, rings=2, radius_m=0.06)
SMALL_GRID = np.radians(np.arange(0.0, 360.0, 6.0)), np.radians(np.arange(-90.0, 91.0, 6.0))


def measured(array: CircularArray) -> np.ndarray:
    """A smooth, band-limited pattern on the grid: what a measurement in a chamber would give."""
    azimuth, elevation = np.meshgrid(*SMALL_GRID)
    smooth = replace(array, floor_db=300.0, width_deg=300.0)
    value = smooth.steer(azimuth.ravel(), elevation.ravel()).value * np.cos(elevation.ravel())[:, None, None] ** 2
    return value.reshape(*azimuth.shape, array.ports, 2).transpose(2, 3, 0, 1)


@pytest.mark.parametrize("array", [CircularArray(), TINY, eadf_from_grid(measured(TINY))])
def test_derivatives_agree_with_differences(array: AntennaArray) -> None:
    azimuth, elevation, step = np.array([-2.9, 0.3, 1.9]), np.array([-0.4, 0.1, 0.9]), 1e-6
    steering = array.steer(azimuth, elevation)
    by_azimuth = array.steer(azimuth + step, elevation).value - array.steer(azimuth - step, elevation).value
    by_elevation = array.steer(azimuth, elevation + step).value - array.steer(azimuth, elevation - step).value
    scale = np.abs(steering.value).max()
    np.testing.assert_allclose(steering.by_azimuth, by_azimuth / (2 * step), atol=1e-6 * scale * 100)
    np.testing.assert_allclose(steering.by_elevation, by_elevation / (2 * step), atol=1e-6 * scale * 100)


def test_one_element_by_hand() -> None:
    # One column looking forward, one ring: on boresight 8 dBi, no phase but the radius; slants see H with
    # both signs.
    array = CircularArray(columns=1, rings=1)
    value = array.steer(0.0, 0.0).value[0]
    phase = np.exp(2j * np.pi * 0.147 * 2.66e9 / SPEED_OF_LIGHT_MPS)
    amplitude = 10.0 ** (8.0 / 20.0) / np.sqrt(2.0)
    np.testing.assert_allclose(value, amplitude * phase * np.array([[1.0, 1.0], [-1.0, 1.0]]), rtol=1e-12)


def test_turning_by_one_column_renames_the_ports() -> None:
    array = CircularArray()
    here, there = array.steer(0.2, 0.3).value[0], array.steer(0.2 + 2.0 * np.pi / 16, 0.3).value[0]
    np.testing.assert_allclose(np.roll(here, 8, axis=0), there, rtol=1e-9)


def test_mean_port_gain_is_what_the_link_budget_takes() -> None:
    from cellslam.sim.lte.statistical.measurement_kernel import array_gain

    azimuth = np.linspace(-3.0, 3.0, 40)
    for elevation_deg in (0.0, 20.0, 40.0):
        value = CircularArray().steer(azimuth, np.full(40, np.radians(elevation_deg))).value
        mean = np.mean(np.abs(value @ np.array([0.6, 0.8j])) ** 2)
        assert abs(10.0 * np.log10(mean / array_gain(np.radians(elevation_deg)))) < 0.35


def test_eadf_interpolates_between_its_samples() -> None:
    azimuth, elevation = np.array([0.123, -2.2, 3.0]), np.array([0.4, -0.7, 1.2])
    smooth = replace(TINY, floor_db=300.0, width_deg=300.0)
    expected = smooth.steer(azimuth, elevation).value * np.cos(elevation)[:, None, None] ** 2
    got = eadf_from_grid(measured(TINY)).steer(azimuth, elevation).value
    np.testing.assert_allclose(got, expected, atol=0.02 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: eadf_from_grid(measured(TINY) * np.nan), "not finite"),
        (lambda: eadf_from_grid(np.zeros((4, 3, 5, 6), complex)), "shape"),
        (lambda: CircularArray(calibration=np.ones(3, complex)), "128 ports"),
        (lambda: switching_times_s(CircularArray(), "spiral"), "order 'spiral'"),  # type: ignore[arg-type]
    ],
)
def test_impossible_arrays_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_switching_visits_every_port_once_every_half_millisecond() -> None:
    array = CircularArray()
    for order in ("column", "ring"):
        times = np.sort(switching_times_s(array, order))  # type: ignore[arg-type]
        np.testing.assert_allclose(np.diff(times), 0.5e-3)
        assert times[0] == 11e-3
        np.testing.assert_allclose(times[-1] + 0.5e-3, 75e-3)
    by_ring = switching_times_s(array, "ring").reshape(16, 4, 2)
    assert (np.diff(by_ring[:, 0, 0]) > 0).all()
    np.testing.assert_allclose(np.diff(by_ring[0, :, 0]), 16e-3)


def test_doppler_over_the_aperture() -> None:
    # 1 m/s towards the wave turns the phase by 204 degrees over 64 ms.
    times = switching_times_s(CircularArray())
    phasors = doppler_phasors(times, [1.0, 0.0, 0.0], 0.0, 0.0, 2.66e9)[0]
    turn = np.degrees(np.unwrap(np.angle(phasors)))
    np.testing.assert_allclose(turn[-1] - turn[0], 203.6 * 127 / 127.5, rtol=0.01)
    sideways = doppler_phasors(times, [1.0, 0.0, 0.0], np.pi / 2, 0.0, 2.66e9)
    np.testing.assert_allclose(sideways, 1.0, atol=1e-12)


def test_calibration_errors_have_the_given_size() -> None:
    array = CircularArray(columns=64, rings=16)
    wrong = miscalibrated(array, 5.0, 0.5, np.random.default_rng(2)).calibration
    assert wrong is not None
    assert abs(np.degrees(np.std(np.angle(wrong))) - 5.0) < 0.4
    assert abs(np.std(20.0 * np.log10(np.abs(wrong))) - 0.5) < 0.04


def test_an_array_for_another_carrier_is_the_same_in_wavelengths() -> None:
    usual, other = CircularArray(), array_at(3.5e9)
    assert other.radius_m == pytest.approx(0.1117, abs=1e-4)
    for here, there in zip(usual.steer([0.3, -2.0], [0.1, 0.5]), other.steer([0.3, -2.0], [0.1, 0.5]), strict=True):
        np.testing.assert_allclose(there, here, rtol=1e-9)
    assert array_at(2.66e9) == usual
