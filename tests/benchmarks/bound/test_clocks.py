"""The bound of clocks that walk and step."""

from dataclasses import replace

import numpy as np

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.scenarios.loading import load
from cellslam.sim.recording import ClockSteps, Recording
from cellslam.sim.world import simulate


def walking(recording: Recording, walk: float, rate_walk: float) -> Recording:
    one = np.ones(len(recording.sites))
    sites = replace(recording.sites, clock_walk_m_sqrt_s=walk * one, clock_drift_walk_m_s_sqrt_s=rate_walk * one)
    return replace(recording, sites=sites)


def of_first_site(recording: Recording) -> Recording:
    """Return the recording without what the other sites were measured of."""
    m, truth = recording.measurements, recording.truth
    rows = recording.links.site[m.link] == 0
    columns = {name: None if c is None else c[rows] for name, c in vars(m).items()}
    of_rows = ("measurement_vt", "measurement_std", "persisting_std", "merging_shift")
    truth = replace(truth, **{name: getattr(truth, name)[rows] for name in of_rows})
    return replace(recording, measurements=replace(m, **columns), truth=truth)


def test_an_unseen_clock_walks_as_the_formula_says(tiny: Recording) -> None:
    """150^2 + q1 t + q2 t^3 / 3, with q1 = 4 m^2/s and q2 = 0.25 m^2/s^3."""
    result, t = bound(walking(of_first_site(tiny), 2.0, 0.5)), tiny.elapsed_s
    expected = 150.0**2 + 4.0 * t + 0.25 * t**3 / 3.0
    np.testing.assert_allclose(result.clock_offset_std_m[:, 1] ** 2, expected, rtol=1e-4)


def test_a_known_step_is_found_again(tiny: Recording) -> None:
    """Before it nothing changes; after it the offset is known again, by the map, and the pose about as well."""
    steps = ClockSteps(np.zeros(1, np.int64), np.array([20.0]), np.array([30.0]))
    stepped, known = bound(replace(tiny, truth=replace(tiny.truth, clock_steps=steps))), bound(tiny)
    at = int(np.searchsorted(tiny.elapsed_s, 20.0))
    np.testing.assert_array_equal(stepped.pose_covariance[:at], known.pose_covariance[:at])
    assert (stepped.clock_offset_std_m[at:, 0] > known.clock_offset_std_m[at:, 0]).all()
    assert stepped.clock_offset_std_m[-1, 0] < 2.0 * known.clock_offset_std_m[-1, 0]
    assert stepped.horizontal_std_m[-1] < 1.5 * known.horizontal_std_m[-1]


def test_the_filters_mean_follows_a_walk() -> None:
    """Of clocks ten times as bad as a TCXO its error is as large as its covariance says; without a walk it is lost."""
    drive = simulate(load("tiny", {"radio.clock_oscillator": "tcxo"}).world, 3, 0)
    m, wander_m = drive.measurements, drive.truth.clock_wander_m
    distance_m = m.distance_m + 9.0 * wander_m[m.snapshot, drive.links.site[m.link]]
    drive = replace(drive, measurements=replace(m, distance_m=distance_m))
    told, still = bound(walking(drive, *(10.0 * drive.sites.walk_densities[:, 0]))), bound(walking(drive, 0.0, 0.0))
    squared = [np.sum(result.pose_error[1:, :2] ** 2, axis=1) for result in (told, still)]
    assert np.mean(squared[0] / told.horizontal_std_m[1:] ** 2) < 3.0
    assert np.mean(squared[1] / still.horizontal_std_m[1:] ** 2) > 10.0
