"""Merged measurements left out of the bound, and the filter that the bound stands for, on simulated drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.bound.merged_paths import both_bounds, merged, merged_share, without_merged
from cellslam.benchmarks.scores.metrics import nees
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Recording

# Of all drives drawn, one in so many would fail by chance.
ONE_IN = 1e4


def moved(recording: Recording, share: float, seed: int) -> tuple[Recording, np.ndarray]:
    """A copy in which others have moved a share of the measurements by twice their deviation in azimuth, and which."""
    truth, rng = recording.truth, np.random.default_rng(seed)
    flags = (rng.random(len(recording.measurements)) < share) & (truth.measurement_vt >= 0)
    shift = np.where(np.isnan(truth.measurement_std), np.nan, 0.0)
    shift[flags, 1] = 2.0 * truth.measurement_std[flags, 1]
    m = recording.measurements
    measurements = replace(m, azimuth_rad=wrap_angle(m.azimuth_rad + np.nan_to_num(shift[:, 1])))
    return replace(recording, measurements=measurements, truth=replace(truth, merging_shift=shift)), flags


def test_merged_measurements_are_left_out(make_recording):
    recording, flags = moved(make_recording(seed=3, snapshots=150, clutter=0.5), 0.3, 1)
    np.testing.assert_array_equal(merged(recording), flags)
    truth = recording.truth
    assert merged_share(recording) == flags.sum() / (truth.measurement_vt >= 0).sum()
    found, lower = both_bounds(recording), bound(recording)
    np.testing.assert_array_equal(found.pose_covariance, lower.pose_covariance)
    assert found.merged_m == bound(without_merged(recording)).position_rmse_m > 1.01 * lower.position_rmse_m
    np.testing.assert_array_equal(without_merged(recording).truth.measurement_vt[flags], -1)


def test_where_few_are_merged_or_nobody_knows_there_is_one_bound(make_recording):
    recording = make_recording(seed=3, snapshots=50)
    assert merged(recording) is None and np.isnan(merged_share(recording))
    assert without_merged(recording) is recording and both_bounds(recording).merged_m is None
    few, flags = moved(recording, 0.03, 1)
    assert flags.any() and both_bounds(few).merged_m is None


def test_a_file_keeps_what_merged_paths_have_moved(make_recording, tmp_path):
    recording, _ = moved(make_recording(seed=3, snapshots=50), 0.3, 1)
    recording.save(tmp_path / "drive.h5")
    np.testing.assert_array_equal(
        Recording.load(tmp_path / "drive.h5").truth.merging_shift, recording.truth.merging_shift
    )


@pytest.fixture(scope="module")
def drives() -> list[Recording]:
    """Short drives of a root seed that nothing was chosen on."""
    coarse = load("tiny", {"vehicle.snapshot_interval_s": 0.15})
    return [simulate(coarse, 74000, trial) for trial in range(10)]


def squared_at_the_end(recordings: list[Recording]) -> float:
    """The sum of the filter's squared normalised errors at the end of drives: chi-square of two for each."""
    return sum(nees(np.zeros_like(b.pose_error), b.pose_error, b.pose_covariance)[-1] for b in map(bound, recordings))


def test_the_filter_of_the_bound_errs_as_the_bound_says(drives):
    low, high = chi2.ppf([1 / ONE_IN, 1 - 1 / ONE_IN], 2 * len(drives))
    assert low < squared_at_the_end([without_merged(r) for r in drives]) < high
    # Errors that persist taken for white ones: a bound far too low.
    white = [replace(r, truth=replace(r.truth, persisting_std=None)) for r in drives]
    assert squared_at_the_end(white) > 2.0 * high
