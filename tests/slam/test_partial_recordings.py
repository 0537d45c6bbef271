"""EKF-SLAM on recordings that lack a component: hypotheses of a VT; drives of the simulator with columns removed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.recording import Recording
from cellslam.slam.joint.new_filters import NO_ERRORS
from cellslam.slam.joint.snapshot.birth_kernel import begin, tidy
from cellslam.slam.joint.snapshot.tentative_kernel import LEAST_WEIGHT, _prune, consider, update_hypotheses
from cellslam.slam.joint.snapshot.update_kernel import add_up, compare, correct, innovate
from cellslam.slam.joint.state.layout import WEIGHT, Births
from cellslam.slam.model.measurement_model import predict

VT, Q = np.array([60.0, 45.0, 12.0]), np.array([0.01, 1e-4, 1e-4])
DRIFT = {"odometry.gyro_bias_deg_per_s": 0.5, "vehicle.duration_s": 20.0, "vehicle.distance_m": 15.0}


def see(one: Any, now: int, pose: Any, z: Any) -> None:
    """Let a filter of an exactly known vehicle be at a pose and measure: give birth, or correct the VT."""
    f, w = one.f, one.w
    f.x[:6] = pose
    seen = one.seen(z[None], Q[None])._replace(now=now)
    if f.count[0] == 0:
        flat = np.isnan(z[2])
        first = np.array([*z[:2], 0.0]) if flat else z, np.array([*Q[:2], 0.1]) if flat else Q
        seen = seen._replace(births=Births(first[0][None], first[1][None], 0))
        begin(f, NO_ERRORS, one.block, seen, 0, 1, 0, w.jacobian, w.pending)
        return
    j = int(np.argmax(f.vts.anchor[: f.count[0], WEIGHT]))
    use = update_hypotheses if f.vts.anchor[j, WEIGHT] < 1.0 else correct
    use(f, NO_ERRORS, j, 6, one.measurement(z, Q), 1.0, one.rules, w.jacobian, w.pending)
    add_up(f, w.pending)
    tidy(f, NO_ERRORS, one.block, now, one.rules)


def corner(steps: int) -> Any:
    """Return poses of a drive of 30 m ahead and 30 m to the left."""
    way, zero = np.linspace(0.0, 60.0, steps), np.zeros(steps)
    return np.stack([np.minimum(way, 30.0), np.maximum(way - 30.0, 0.0), zero, np.pi / 2 * (way > 30.0), zero, zero], 1)


@pytest.mark.parametrize("missing", [[0], [0, 2], [1, 2], [1], [2]])
def test_a_vt_is_found_though_a_component_is_never_measured(missing: list[int], one_filter: Any) -> None:
    rng, one = np.random.default_rng(0), one_filter(confirm=0)
    for now, pose in enumerate(corner(120)):
        z = predict(pose, VT) + np.sqrt(Q) * rng.standard_normal(3)
        z[missing] = np.nan
        see(one, now, pose, z)
        assert one.f.vts.anchor[: one.f.count[0], WEIGHT].sum() == pytest.approx(1.0)
    best = int(np.argmax(one.f.vts.anchor[: one.f.count[0], WEIGHT]))
    assert one.f.vts.anchor[best, WEIGHT] > 0.99
    assert np.linalg.norm(one.place(best)[:2] - VT[:2]) < 2.0
    if len(missing) == 1 and 2 not in missing:
        assert np.linalg.norm(one.place(best) - VT) < 3.0


def test_on_a_straight_street_two_sides_remain(one_filter: Any) -> None:
    """Distances do not tell left from right: both hypotheses stay, mirrored, and the vehicle is not moved by either."""
    one = one_filter(confirm=0)
    one.f.p[[0, 1], [0, 1]] = 0.01
    before = one.f.p[:7, :7].copy()
    for now, way in enumerate(np.linspace(0.0, 40.0, 80)):
        pose = np.array([way, 0, 0, 0, 0, 0])
        see(one, now, pose, np.array([predict(pose, VT)[0], np.nan, np.nan]))
        np.testing.assert_array_equal(one.f.x[:7], [*pose, 0.0])
        np.testing.assert_array_equal(one.f.p[:7, :7], before)
    assert one.f.count[0] == 2
    left, right = one.place(0), one.place(1)
    assert left[1] == pytest.approx(-right[1], abs=3.0)
    assert abs(left[1]) == pytest.approx(np.hypot(*VT[1:]), rel=0.1)


def test_hypotheses_are_corrected_as_a_schmidt_filter_does(one_filter: Any) -> None:
    one = one_filter()
    one.put([3.0, -2.0, 1.5, 0.7, 0.1, -0.2], 5.0, [80.0, 0.5, 0.2], [60.0, -1.0, 0.1])
    p = one.spread(np.random.default_rng(1).normal(size=(13, 13)) * 0.02)
    x, (expected, h) = one.f.x[:13].copy(), one.model(0)
    e, q = np.array([0.4, 0.01, -0.02]), np.array([0.3, 1e-4, 2e-4])
    gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + np.diag(q))
    gain[np.r_[:7, 10:13]] = 0.0
    left = np.eye(13) - gain @ h
    measurement = one.measurement(expected + e + [0.0, 2.0 * np.pi, 0.0], q)
    given, hph = compare(one.f, NO_ERRORS, 0, 6, measurement, one.w.jacobian, one.w.pending)
    consider(one.f, 0, innovate(given, q, hph), given, one.w.pending)
    add_up(one.f, one.w.pending)
    np.testing.assert_allclose(one.f.x[:13], x + gain @ e, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.f.p[:13, :13], left @ p @ left.T + (gain * q) @ gain.T, rtol=1e-7, atol=1e-12)


def test_hypotheses_that_agree_are_one_also_behind_the_array(one_filter: Any) -> None:
    one = one_filter()
    one.put(np.zeros(6), 0.0, [50.0, 3.1, 0.0], [50.0, -3.1, 0.0], [50.0, 1.0, 0.0], [50.0, 2.0, 0.0])
    one.spread(np.sqrt(0.1) * np.eye(19))
    weight = one.f.vts.anchor[:4, WEIGHT]
    weight[:] = [0.3, 0.2, 0.5, 0.1 * LEAST_WEIGHT]
    assert _prune(one.f, 0, 0, LEAST_WEIGHT) == 2
    np.testing.assert_allclose(weight, [0.5, 0.0, 0.5, 0.0], rtol=1e-3)


@pytest.fixture(scope="module")
def drifting() -> Recording:
    """A drive of `tiny` with a gyro twenty times worse than the default."""
    return simulate(load("tiny", DRIFT), 5, 0)


def rmse(recording: Recording, name: str, *missing: str) -> float:
    """Return the position RMSE (m) of an estimator on a recording without some columns."""
    m, (request,) = recording.measurements, resolve({}, (name,))
    nothing: dict[str, Any] = {column: np.full(len(m), np.nan) for column in missing}
    part = replace(recording, measurements=replace(m, **nothing))
    warm_up(request)
    return float(score(part, estimate(part, request, np.random.default_rng(0)), None)["position_rmse_m"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("missing", "share"), [(("elevation_rad",), 0.6), (("distance_m",), 0.6), (("azimuth_rad", "elevation_rad"), 1.1)]
)
def test_what_is_left_helps_and_distances_alone_do_no_harm(
    missing: tuple[str, ...], share: float, drifting: Recording
) -> None:
    assert rmse(drifting, "ekf-slam", *missing) < share * rmse(drifting, "dead-reckoning")
