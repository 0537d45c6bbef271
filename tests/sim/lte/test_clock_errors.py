"""Clocks that wander and step: as their formulas say, and declared in the truth."""

import numpy as np
import pytest

from cellslam.scenarios.loading import load
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.lte.faults import draw_clock_errors, walk_densities
from cellslam.sim.lte.radio_config import RadioConfig
from cellslam.sim.recording import Recording
from cellslam.sim.world import simulate

DT = 0.1


def walk_of(oscillator, snapshots, sites, seed):
    config = RadioConfig(clock_oscillator=oscillator)
    errors = draw_clock_errors(config, DT * np.arange(snapshots), sites, np.random.default_rng(seed))
    assert errors is not None
    return errors.wander_m / SPEED_OF_LIGHT_MPS


def test_densities_are_those_of_the_source():
    """h_0 = 2e-19 s and h_-2 = 2e-20 1/s, worked by hand: c sqrt(1e-19) and c sqrt(2 pi^2 2e-20)."""
    assert walk_densities("tcxo") == pytest.approx((0.094803, 0.188365), rel=1e-4)
    assert walk_densities("ideal") == (0.0, 0.0)


@pytest.mark.parametrize("oscillator", ["tcxo", "ocxo", "rubidium"])
def test_allan_variance_is_the_formulas(oscillator):
    """sigma_y^2 = <(x(t + 2 tau) - 2 x(t + tau) + x(t))^2> / (2 tau^2), over 400 clocks of 100 s."""
    x = walk_of(oscillator, 1001, 400, 1)
    for steps in (1, 10, 100):
        second = x[2 * steps :: 2 * steps] - 2 * x[steps : -steps : 2 * steps] + x[: -2 * steps : 2 * steps]
        tau_s, (walk, rate_walk) = steps * DT, np.array(walk_densities(oscillator)) / SPEED_OF_LIGHT_MPS
        measured, tolerance = np.mean(second**2) / (2.0 * tau_s**2), 4.0 * np.sqrt(2.0 / second.size) + 0.01
        assert measured == pytest.approx(walk**2 / tau_s + rate_walk**2 * tau_s / 3.0, rel=tolerance)


def test_the_walk_does_not_depend_on_the_interval():
    """Variance after 50 s in intervals of 0.1 s and of 10 s: q1 t + q2 t^3 / 3, of 4000 clocks."""
    walk, rate_walk = walk_densities("tcxo")
    expected = walk**2 * 50.0 + rate_walk**2 * 50.0**3 / 3.0
    for count in (501, 6):
        errors = draw_clock_errors(
            RadioConfig(clock_oscillator="tcxo"), np.linspace(0.0, 50.0, count), 4000, np.random.default_rng(2)
        )
        assert np.var(errors.wander_m[-1]) == pytest.approx(expected, rel=0.09)


def test_steps_are_in_the_distances_and_in_the_truth(tiny, tmp_path):
    sets = {"radio.clock_step_times_s": [10.0], "radio.clock_step_std_m": 30.0, "radio.clock_oscillator": "ocxo"}
    stepped = simulate(load("tiny", sets).world, 3, 0)
    truth, m = stepped.truth, stepped.measurements
    np.testing.assert_array_equal(m.azimuth_rad, tiny.measurements.azimuth_rad)
    site = stepped.links.site[m.link]
    added = m.distance_m - tiny.measurements.distance_m
    np.testing.assert_allclose(added, truth.clock_wander_m[m.snapshot, site], atol=1e-9)
    offsets = truth.clock_offsets_at(stepped.elapsed_s)
    jump = np.diff(offsets, axis=0)[np.searchsorted(stepped.elapsed_s, 10.0) - 1]
    np.testing.assert_array_equal(truth.clock_steps.time_s, [10.0, 10.0])
    np.testing.assert_allclose(jump[truth.clock_steps.site], truth.clock_steps.size_m, atol=0.01)
    assert stepped.sites.walk_densities[:, 0] == pytest.approx(walk_densities("ocxo"))
    stepped.save(tmp_path / "drive.h5")
    again = Recording.load(tmp_path / "drive.h5")
    np.testing.assert_array_equal(again.truth.clock_steps.size_m, truth.clock_steps.size_m)
    np.testing.assert_array_equal(again.truth.clock_wander_m, truth.clock_wander_m)


def test_a_step_of_the_receiver_is_one_for_all(tiny):
    config = RadioConfig(clock_steps_per_hour=360.0, clock_steps_together=True)
    errors = draw_clock_errors(config, np.arange(0.0, 100.0, 0.1), 3, np.random.default_rng(4))
    assert len(errors.steps) >= 3 and (errors.wander_m == errors.wander_m[:, :1]).all()
    assert tiny.truth.clock_steps is None and tiny.truth.clock_wander_m is None
