"""The bound of the map against a plain joint Kalman recursion, against the errors of the filter whose it is, and as a
metric."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.bound import DETECTIONS_OF_A_TRUE_VT
from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.scores.statistics import efficiency_ratio
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.sweeps.trajectories import trajectory
from cellslam.benchmarks.tables.summaries import OF_MAP, estimate
from cellslam.slam.api import VtEstimate
from tests.benchmarks.bound.joint_filter import JointFilter


def test_map_bound_equals_the_joint_kalman_recursion(make_recording: Any) -> None:
    recording = make_recording(seed=3, snapshots=60, vts_per_site=3, detection=0.5)
    plain = JointFilter(recording)
    plain.run()
    found = bound(recording).map
    assert found is not None
    first = plain.core.size + 3 * np.arange(len(recording.truth.vts))[:, None] + np.arange(3)
    expected = np.sqrt(np.diag(plain.P)[first].sum(axis=1))
    seen = found.times_seen > 0
    np.testing.assert_allclose(found.std_m[seen], expected[seen], rtol=1e-4)
    assert np.isnan(found.std_m[~seen]).all()
    m, truth = recording.measurements, recording.truth
    for vt in np.flatnonzero(seen):
        assert found.times_seen[vt] == len(np.unique(m.snapshot[truth.measurement_vt == vt]))
    settled = found.std_m[found.times_seen >= DETECTIONS_OF_A_TRUE_VT]
    assert (
        len(settled)
        and found.over_time_m[50] == pytest.approx(found.over_time_m[59])
        and np.isnan(found.over_time_m[9])
    )
    assert found.over_time_m[-1] == pytest.approx(np.sqrt(np.mean(settled**2)), rel=0.5)


def perfect_filter(recording: Any) -> tuple[TrialResult, Any]:
    """What the filter that is linear about the truth says, and the bound."""
    limit, truth = bound(recording), recording.truth
    seen = np.flatnonzero(limit.map.times_seen > 0)
    link = np.array([np.flatnonzero(recording.links.site == s)[0] for s in truth.vts.site[seen]])
    at = truth.vts.position_m[seen] + limit.map.error[seen]
    vts = VtEstimate(seen, link, at, np.tile(np.eye(3), (len(seen), 1, 1)))
    poses = truth.poses + limit.pose_error
    return TrialResult("linear", poses, limit.pose_covariance, truth.measurement_vt, vts=vts), limit


@pytest.mark.slow
def test_a_filter_that_is_linear_about_the_truth_has_a_ratio_of_one(make_recording: Any) -> None:
    errors, bounds, rows = [], [], []
    for seed in range(24):
        recording = make_recording(seed=100 + seed, snapshots=80, vts_per_site=4, detection=0.7, ports=1)
        result, limit = perfect_filter(recording)
        row = score(recording, result, limit)
        errors.append(row["map_rmse_m"])
        bounds.append(row["bound_map_m"])
        rows.append({**row, "status": "ok"})
        kept = trajectory(recording, result, limit)
        often = kept.map_times_seen >= DETECTIONS_OF_A_TRUE_VT
        assert np.sqrt(np.mean(kept.map_error_m[often] ** 2)) == pytest.approx(row["map_rmse_m"], rel=1e-5)
    ratio, low, high = efficiency_ratio(np.array(errors), np.array(bounds), 0.95)
    assert 0.9 < ratio < 1.1 and low < 1.0 < high

    import pandas as pd

    assert estimate(pd.DataFrame(rows), OF_MAP)[0] == pytest.approx(ratio)


def test_only_what_was_mapped_counts(make_recording: Any) -> None:
    recording = make_recording(seed=5, snapshots=80, vts_per_site=4, detection=0.7)
    result, limit = perfect_filter(recording)
    assert result.vts is not None
    worst = np.argsort(-np.nan_to_num(limit.map.std_m))[:2]
    some = ~np.isin(result.vts.id, worst)
    columns = {name: getattr(result.vts, name)[some] for name in ("id", "link", "position_m", "covariance")}
    fewer = score(recording, replace(result, vts=VtEstimate(**columns)), limit)
    assert fewer["bound_map_m"] < score(recording, result, limit)["bound_map_m"]
    assert score(recording, replace(result, vts=None), limit)["map_rmse_m"] is None
