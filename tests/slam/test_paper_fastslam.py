"""The paper's FastSLAM: its kernel against plain formulas, and what it is expected to do and not to do."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.compiling import njit
from cellslam.sim.frames import rotation
from cellslam.slam.api import setup_of, snapshots_of
from cellslam.slam.conformance import EstimatorConformance
from cellslam.slam.conformance.subject import Subject, drive, tiny_drive
from cellslam.slam.fastslam.paper.paper_fastslam import PaperFastSlam, PaperFastSlamOptions
from cellslam.slam.fastslam.paper.paper_fastslam_kernel import _give_birth, _innovation, _seen, _update
from cellslam.slam.model.matrices_kernel import mat_of, sym_of, vec_of
from cellslam.slam.model.measurement_model import birth, jacobians, predict

POSE, VT = np.array([3.0, -2.0, 1.5, 0.7, 0.1, -0.2]), np.array([60.0, 45.0, 20.0])
R, Q = rotation(*POSE[3:]), np.array([0.4, 3e-4, 5e-4])
# Without clutter and persisting errors, with known offsets: what the paper's filter was written for.
KIND = {
    "radio.clock_offset_std_m": 0.0, "radio.clutter_scale": 0.0, "radio.calibration_correlation_deg": 0.0,
    "radio.roof_correlation_deg": 0.0, "radio.diffuse_correlation_m": 0.0, "radio.attitude_correlation_s": 0.0,
}  # fmt: skip


@njit
def seen(place: Any, r: Any, mean: Any, cov: Any) -> Any:
    return _seen(vec_of(place), mat_of(r), vec_of(mean), sym_of(cov))


@njit
def updated(place: Any, r: Any, mean: Any, cov: Any, z: Any, q: Any, offset: float) -> float:
    of_vt = _seen(vec_of(place), mat_of(r), vec_of(mean), sym_of(cov))
    return _update(of_vt, _innovation(of_vt, z, q, offset), mean, cov)


@njit
def born(place: Any, r: Any, z: Any, offset: float, q: Any, mean: Any, cov: Any) -> None:
    _give_birth(vec_of(place), mat_of(r), z, q, offset, mean, cov)


def a_covariance() -> Any:
    root = np.random.default_rng(0).normal(size=(3, 3))
    return root @ root.T


def test_prediction_is_that_of_the_model() -> None:
    h, h_sigma, _ = seen(POSE[:3], R, VT, np.eye(3))
    np.testing.assert_allclose(h, predict(POSE, VT), rtol=1e-12)
    np.testing.assert_allclose(np.reshape(h_sigma, (3, 3)), jacobians(POSE, VT)[0], rtol=1e-10, atol=1e-14)


def test_update_is_the_textbook_one() -> None:
    cov, by, offset = a_covariance(), jacobians(POSE, VT)[0], 12.0
    z = predict(POSE, VT) + np.array([offset + 0.7, 2.0 * np.pi + 0.01, -0.02])
    mean, after, e, s = VT.copy(), cov.copy(), np.array([0.7, 0.01, -0.02]), by @ cov @ by.T + np.diag(Q)
    value = updated(POSE[:3], R, mean, after, z, Q, offset)
    gain = cov @ by.T @ np.linalg.inv(s)
    np.testing.assert_allclose(mean, VT + gain @ e, rtol=1e-10)
    np.testing.assert_allclose(after, cov - gain @ by @ cov, rtol=1e-8, atol=1e-10)
    assert value == pytest.approx(-0.5 * (e @ np.linalg.solve(s, e) + np.log(np.linalg.det(2.0 * np.pi * s))))


def test_birth_is_where_the_measurement_points() -> None:
    z, mean, cov = predict(POSE, VT) + np.array([12.0, 0.0, 0.0]), np.zeros(3), np.zeros((3, 3))
    born(POSE[:3], R, z, 12.0, Q, mean, cov)
    np.testing.assert_allclose(mean, VT, rtol=1e-12)
    slope = np.zeros((3, 3))
    for i in range(3):
        step = np.eye(3)[i] * 1e-6
        up, down = z - [12.0, 0, 0] + step, z - [12.0, 0, 0] - step
        slope[:, i] = (birth(POSE, *up) - birth(POSE, *down)) / 2e-6
    np.testing.assert_allclose(cov, (slope * Q) @ slope.T, rtol=1e-6, atol=1e-6)


def scores_of(overrides: dict[str, Any]) -> dict[str, Any]:
    recording = simulate(load("tiny", overrides), 4000, 0)
    (request,) = resolve({}, ("paper-fastslam",))
    warm_up(request)
    return score(recording, estimate(recording, request, np.random.default_rng(0)), None)


def test_maps_well_where_its_assumptions_hold_and_badly_where_not() -> None:
    kind, real = scores_of(KIND), scores_of({})
    assert kind["association_precision"] > 0.99
    assert kind["transmitter_rmse_m"] < 2.0
    assert real["map_gospa_m"] > 2.0 * kind["map_gospa_m"]


def test_spoilt_covariances_do_not_stall_the_assignment() -> None:
    recording, estimator = tiny_drive(), PaperFastSlam(PaperFastSlamOptions(particles=4))
    estimator.start(setup_of(recording), np.random.default_rng(0))
    for t, snapshot in enumerate(snapshots_of(recording)[:4]):
        answer = estimator.step(0.075 if t else 0.0, recording.odometry[t], snapshot)
        estimator._covs[:] = np.diag([-1e-3, 1e-3, 0.0]) if t % 2 else -1e3 * np.eye(3)
    assert np.isfinite(answer.pose).all()


def poses_of(estimator: Any, threads: int) -> Any:
    before = numba.get_num_threads()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    answers = drive(estimator, setup_of(tiny_drive()), Subject(type(estimator), None, tiny_drive()).steps(80))
    numba.set_num_threads(before)
    return np.array([answer.pose for answer in answers])


def test_same_answer_on_any_number_of_threads() -> None:
    estimator = PaperFastSlam(PaperFastSlamOptions(particles=20))
    np.testing.assert_array_equal(poses_of(estimator, 1), poses_of(estimator, 2))


class TestPaperFastSlam(EstimatorConformance):
    @pytest.fixture
    def estimator(self) -> type[Any]:
        return PaperFastSlam

    @pytest.fixture
    def options(self) -> Any:
        return PaperFastSlamOptions(particles=20)
