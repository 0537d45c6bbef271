"""Merging in the bound, and the filter that the bound stands for, on simulated drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.bound.linear_model import linear_model
from cellslam.benchmarks.bound.merged_paths import LEAST_SHARE, both_bounds, merged, merged_share, merging
from cellslam.benchmarks.scores.belief import squared_error
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.frames import wrap_angle
from cellslam.sim.lte.persisting_errors import Cause
from cellslam.sim.recording import Recording

# Of all drives drawn, one in so many would fail by chance.
ONE_IN = 1e4


SIZE, LASTS_S = np.radians(3.0), 4.0


def moved(recording: Recording, size: float, lasts_s: float, seed: int) -> Recording:
    """A copy in which others have moved the azimuths of every VT by Gauss-Markov processes."""
    truth, rng, m = recording.truth, np.random.default_rng(seed), recording.measurements
    shift = np.where(np.isnan(truth.measurement_std), np.nan, 0.0)
    left = np.exp(-np.diff(recording.time_s) / lasts_s)
    for vt in np.unique(truth.measurement_vt[truth.measurement_vt >= 0]):
        by = size * rng.standard_normal(len(recording.time_s))
        for t, kept in enumerate(left, start=1):
            by[t] = kept * by[t - 1] + np.sqrt(1.0 - kept**2) * by[t]
        of_vt = truth.measurement_vt == vt
        shift[of_vt, 1] = by[m.snapshot[of_vt]]
    measurements = replace(m, azimuth_rad=wrap_angle(m.azimuth_rad + np.nan_to_num(shift[:, 1])))
    return replace(recording, measurements=measurements, truth=replace(truth, merging_shift=shift))


def test_where_many_are_merged_there_are_two_bounds(make_recording, tmp_path):
    recording = moved(make_recording(seed=3, snapshots=150, clutter=0.5), SIZE, LASTS_S, 1)
    truth, true = recording.truth, recording.truth.measurement_vt >= 0
    beyond = np.abs(truth.merging_shift[:, 1]) > 0.5 * truth.measurement_std[:, 1]
    np.testing.assert_array_equal(merged(recording), beyond & true)
    assert merged_share(recording) == (beyond & true).sum() / true.sum()
    found, lower = both_bounds(recording), bound(recording)
    np.testing.assert_array_equal(found.pose_covariance, lower.pose_covariance)
    assert found.merged_m == bound(recording, merging=merging(recording)).position_rmse_m
    assert found.merged_m > 1.01 * lower.position_rmse_m
    recording.save(tmp_path / "drive.h5")
    np.testing.assert_array_equal(Recording.load(tmp_path / "drive.h5").truth.merging_shift, truth.merging_shift)


def test_size_and_duration_of_merging_are_those_of_the_drive(drives):
    found = [merging(moved(recording, SIZE, LASTS_S, seed)) for seed, recording in enumerate(drives)]
    assert np.sqrt(np.mean([c.std**2 for c in found], axis=0)) == pytest.approx([0.0, SIZE, 0.0], rel=0.15)
    assert np.median([c.scale for c in found]) == pytest.approx(LASTS_S, rel=0.3)


def test_each_vt_merges_by_itself(make_recording):
    recording = make_recording(seed=3, snapshots=50)
    _, drive = linear_model(recording, merging=Cause("merging", np.full(3, 0.1), LASTS_S))
    states = drive.views.state[drive.sightings.view_of, :, -1]
    of_vt = np.unique(np.column_stack([drive.sightings.vt, states]), axis=0)
    assert len(of_vt) == len(np.unique(of_vt[:, 0])) > 3 and len(np.unique(states)) == 3 * len(of_vt)


def test_merging_that_moves_nothing_costs_nothing(make_recording):
    recording = make_recording(seed=3, snapshots=50)
    still = replace(recording, truth=replace(recording.truth, merging_shift=0.0 * recording.truth.measurement_std))
    found, expected = bound(still, merging=merging(still)), bound(recording)
    np.testing.assert_array_equal(found.pose_covariance, expected.pose_covariance)


@pytest.mark.parametrize("snapshots", [1, 2])
def test_short_drives_without_noise_have_both_bounds(make_recording, snapshots):
    recording = moved(make_recording(seed=3, snapshots=snapshots), SIZE, LASTS_S, 1)
    exact = replace(recording, truth=replace(recording.truth, measurement_std=0.0 * recording.truth.measurement_std))
    for one in (recording, exact):
        found = both_bounds(one)
        assert merging(one).scale > 0.0 and found.merged_m >= found.position_rmse_m


def test_where_few_are_merged_or_nobody_knows_there_is_one_bound(make_recording):
    recording = make_recording(seed=3, snapshots=50)
    assert merged(recording) is None and np.isnan(merged_share(recording))
    assert both_bounds(recording).merged_m is None
    few = moved(recording, np.radians(0.22), 0.01, 1)
    assert 0.0 < merged_share(few) < LEAST_SHARE and both_bounds(few).merged_m is None


@pytest.fixture(scope="module")
def drives() -> list[Recording]:
    """Short drives of a root seed that nothing was chosen on."""
    coarse = load("tiny", {"vehicle.snapshot_interval_s": 0.15})
    return [simulate(coarse, 74000, trial) for trial in range(10)]


def squared_at_the_end(recordings: list[Recording], merging: Cause | None = None) -> float:
    """The sum of the filter's squared normalised errors at the end of drives: chi-square of two for each."""
    found = [bound(recording, merging=merging) for recording in recordings]
    return sum(squared_error(b.pose_error[:, :2], b.pose_covariance[:, :2, :2])[-1] for b in found)


@pytest.mark.slow
def test_the_filter_of_the_bound_errs_as_the_bound_says(drives):
    low, high = chi2.ppf([1 / ONE_IN, 1 - 1 / ONE_IN], 2 * len(drives))
    assert low < squared_at_the_end(drives) < high
    # Errors that persist taken for white ones: a bound far too low.
    white = [replace(r, truth=replace(r.truth, persisting_std=None)) for r in drives]
    assert squared_at_the_end(white) > 2.0 * high
    # So is one that counts merged measurements as if they were not.
    merge = [moved(r, SIZE, LASTS_S, seed) for seed, r in enumerate(drives)]
    assert low < squared_at_the_end(merge, Cause("merging", np.array([0.0, SIZE, 0.0]), LASTS_S)) < high
    assert squared_at_the_end(merge) > 2.0 * high
