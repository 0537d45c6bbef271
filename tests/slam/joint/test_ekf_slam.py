"""EKF-SLAM and its oracles on whole drives: the bound where errors are white, bounded maps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.bound.cramer_rao import bound
from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.slam.conformance.subject import tiny_drive
from cellslam.slam.joint.ekf_slam import EkfSlam
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.measurements.measurement_options import NOTHING_PERSISTS
from tests.slam.driving import driven

WHITE = {
    "radio.calibration_correlation_deg": 0.0, "radio.roof_correlation_deg": 0.0, "radio.diffuse_correlation_m": 0.0,
    "radio.attitude_correlation_s": 0.0,
}  # fmt: skip
AS_CLAIMED: dict[str, Any] = {"noise_model": "claimed", **NOTHING_PERSISTS}


@pytest.fixture(scope="module")
def white_drive() -> Recording:
    """40 m of lund-530 whose measurement errors are white, as the filter assumes."""
    shorter = {"vehicle.distance_m": 40.0, "vehicle.duration_s": 45.0, "vehicle.stops": 1}
    return simulate(load("lund-530", {**WHITE, **shorter}), 4000, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factor"), [("ekf-slam", 3.0), ("oracle-association", 3.0), ("oracle-map", 2.0)])
def test_reaches_the_bound_where_errors_are_white(white_drive: Recording, name: str, factor: float) -> None:
    limit = bound(white_drive)
    (request,) = resolve({name: AS_CLAIMED}, (name,))
    warm_up(request)
    scores = score(white_drive, estimate(white_drive, request, np.random.default_rng(0)), limit)
    assert scores["position_rmse_m"] < factor * limit.position_rmse_m
    if name == "oracle-map":
        assert scores["map_gospa_m"] is None and scores["clock_offset_rmse_m"] < 0.5
    else:
        assert scores["clock_offset_rmse_m"] < 4.0 * limit.clock_offset_std_m[-1].max()
        assert scores["association_precision"] > 0.95
        assert 0.7 < scores["nees_mean"] < 3.5  # 2 for an honest filter; while the start lasts, covariances are wide


@pytest.mark.slow
def test_the_start_finds_the_offset_by_exact_measurements() -> None:
    """Where births counted, it was wrong by up to a hundred deviations in three of these four drives."""
    scenario = load("noiseless", {"vehicle.distance_m": 15.0, "vehicle.duration_s": 20.0, "vehicle.stops": 0})
    (request,) = resolve(scenario.estimator, ("ekf-slam",))
    warm_up(request)
    for trial in (6, 7, 9, 10):
        drive = simulate(scenario, 4000, trial)
        assert drive.truth is not None
        found = estimate(drive, request, np.random.default_rng(0))
        apart = found.clock_offset_m[-1] - drive.truth.clock_offsets_m
        assert np.all(np.abs(apart) < 4.0 * np.sqrt(found.clock_offset_variance_m2[-1]))
        assert abs(apart[0]) < 5.0


@pytest.mark.slow
def test_map_stays_bounded() -> None:
    few = EkfSlamOptions(vts=12, start_limit_s=3.0, sharing="none")
    estimator = EkfSlam(few)
    last = driven(estimator, tiny_drive())[-1]
    mixture = estimator._joint
    assert mixture is not None
    assert mixture.arrays.count[0, 0] <= 16
    assert last.vts is not None
    assert len(last.vts.id) > mixture.arrays.count[0, 0]  # those that made room are still on the map
    assert np.linalg.eigvalsh(last.vts.covariance).min() >= -1e-9
