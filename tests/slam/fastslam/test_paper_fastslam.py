"""The paper's FastSLAM: its functions against plain formulas, the constants against a joint Kalman filter, and what it
is expected to do and not to do."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from cellslam.benchmarks.scores.metrics import score as scored
from cellslam.benchmarks.trials.estimation import estimate, warm_up
from cellslam.scenarios.estimator_options import loaded
from cellslam.scenarios.loading import load
from cellslam.scenarios.simulation import simulate
from cellslam.sim.frames import integrate_pose, rotation, unit_vector
from cellslam.sim.recording import Floats, Recording
from cellslam.slam.conformance.subject import tiny_drive
from cellslam.slam.fastslam import paper_fastslam as paper
from cellslam.slam.fastslam.paper_fastslam import HITS, IDENT, LAST, MU, SIGMA, UPPER, WIDTH, G, Particles, Seen
from cellslam.slam.model.matrices_kernel import Mat3, Mat32, Sym3, vec_of
from cellslam.slam.model.measurement_model import jacobians
from cellslam.slam.model.measurement_model import predict as seen_from
from tests.slam.driving import driven

POSE, VT = np.array([3.0, -2.0, 1.5, 0.7, 0.1, -0.2]), np.array([60.0, 45.0, 20.0])
Q = np.array([0.4, 3e-4, 5e-4])
STEP = np.array([1e-6, 1e-6])  # of beta (rad/s) and s
D = np.array([[30.0, -40.0, 0.5, -9.0], [-7.0, 4.0, 0.3, 0.0]])
GAIN = 20.0 * np.random.default_rng(0).normal(size=(3, 2))
TURNED = Mat3(*rotation(*POSE[3:]).ravel())
# Without clutter and errors that persist, with known offsets: what the paper's filter was written for.
KIND = {
    "radio.clock_offset_std_m": 0.0, "radio.clutter_scale": 0.0, "radio.calibration_correlation_deg": 0.0,
    "radio.roof_correlation_deg": 0.0, "radio.diffuse_correlation_m": 0.0, "radio.attitude_correlation_s": 0.0,
}  # fmt: skip


def upper(matrix: Floats) -> Floats:
    return np.asarray(matrix[np.triu_indices(len(matrix))])


def a_row(mu: Floats, Sigma: Floats, gain: Floats) -> Floats:
    return np.concatenate([mu, np.zeros(G - LAST), gain.T.ravel(), upper(Sigma)])


def parts(row: Floats) -> tuple[Floats, Floats, Floats]:
    return row[MU:LAST], row[SIGMA + UPPER], row[G:SIGMA].reshape(2, 3).T


def a_particle(P: Floats | None = None, rows: tuple[Floats, ...] = ()) -> Particles:
    P, vts = np.zeros((2, 2)) if P is None else P, np.zeros((1, 4, WIDTH))
    vts[0, : len(rows)] = np.reshape(rows, (-1, WIDTH))
    sums = np.zeros(2), upper(P), np.zeros(2), np.zeros(3), np.zeros(1)
    return Particles(POSE.copy(), D.copy(), *sums, vts, np.array([len(rows)]))


def measured(z: Floats, now: int = 7) -> paper.Measured:
    q = np.tile(Q, (len(z), 1))
    return paper.Measured(now, 100, 16.3, z, q, q, q, np.zeros(len(z)), np.array([0, len(z)]))


def matrix(m: Any) -> Floats:
    return np.stack([np.array(m.a), np.array(m.b)], axis=1) if isinstance(m, Mat32) else np.reshape(m, (3, 3))


def birth(pose: Floats, distance_m: float, azimuth_rad: float, elevation_rad: float) -> Floats:
    """Return the VT (3,) that a measurement points to."""
    return np.asarray(pose[:3] + distance_m * rotation(*pose[3:]) @ unit_vector(azimuth_rad, elevation_rad))


def pose_at(theta: Floats) -> Floats:
    return POSE + np.append(theta @ D, [0.0, 0.0])


def derivative(function: Any) -> Floats:
    """Return the derivative (3, 2) or (4, 2) of a function of theta at zero."""
    columns = [(function(+step) - function(-step)) / (2.0 * step.sum()) for step in np.diag(STEP)]
    return np.stack(columns, axis=1)


def test_a_vt_is_seen_as_the_model_says() -> None:
    seen = paper.see(a_particle(), TURNED, a_row(VT, np.eye(3), GAIN))
    np.testing.assert_allclose(seen.z, seen_from(POSE, VT), rtol=1e-12)
    H = jacobians(POSE, VT)[0]
    np.testing.assert_allclose(matrix(seen.H_Sigma), H, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(np.array(seen.spread)[UPPER], H @ H.T, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(
        matrix(seen.A), derivative(lambda theta: seen_from(pose_at(theta), VT + GAIN @ theta)), rtol=1e-6, atol=1e-8
    )


def test_motion_is_that_of_the_odometry_less_its_constants() -> None:
    u, dt, x = np.array([1.3, 0.1, -0.05, 0.4, 0.02, 0.03]), 0.5, a_particle()
    x.theta[:] = 0.01, 0.02

    def moved(theta: Floats) -> Floats:
        rate = u - np.array([0.0, 0.0, 0.0, theta[0], 0.0, 0.0])
        rate[0] = u[0] / (1.0 + theta[1])
        return integrate_pose(pose_at(theta - [0.01, 0.02]), rate, dt)

    slope = derivative(lambda step: moved(np.array([0.01, 0.02]) + step)[:4])
    expected = moved(np.array([0.01, 0.02]))
    paper.predict(x, u, dt)
    np.testing.assert_allclose(x.r, expected, rtol=1e-12)
    np.testing.assert_allclose(x.D.T, slope, rtol=1e-6, atol=1e-6)


def test_a_vt_begins_where_the_measurement_points() -> None:
    z, row = seen_from(POSE, VT), np.zeros(WIDTH)
    paper.begin(a_particle(), TURNED, row, z, Q)
    mu, Sigma, gain = parts(row)
    J = np.stack([(birth(POSE, *(z + e)) - birth(POSE, *(z - e))) / 2e-6 for e in 1e-6 * np.eye(3)], axis=1)
    np.testing.assert_allclose(mu, VT, rtol=1e-12)
    np.testing.assert_allclose(Sigma, (J * Q) @ J.T, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(gain, derivative(lambda theta: birth(pose_at(theta), *z)), rtol=1e-6, atol=1e-6)


def test_the_nearest_is_not_taken_twice_and_what_is_left_over_begins_a_vt() -> None:
    apart = np.array([0.0, 2.0, 0.0])
    rows = tuple(a_row(VT + k * apart, 0.5 * np.eye(3), np.zeros((3, 2))) for k in range(2))
    z = seen_from(POSE, VT + np.array([[0.0, 1.3, 0.0], [0.0, 2.1, 0.0], [0.0, 90.0, 0.0]]))
    z[0, 1] += 2.0 * np.pi  # a turn more makes no difference to an azimuth
    x, m = a_particle(rows=rows), measured(z)
    x.vts[0, :2, IDENT], x.vts[0, :2, HITS] = [41.0, 42.0], 3.0
    association = np.zeros(3, np.int64)
    near, work_i = np.zeros(4, np.int64), np.zeros(99, np.int64)
    room = paper.Scratch(np.zeros((4, 6)), np.zeros((4, 24)), near, np.zeros(99), work_i)
    paper.use_link(x, TURNED, m, 0, association, room)
    # Each alone would take 42, which is nearer to both.
    assert association.tolist() == [41, 42, -1]
    assert x.counts[0] == 3 and x.vts[0, 2, [IDENT, LAST, HITS]].tolist() == [102.0, 7.0, 1.0]
    assert x.vts[0, :2, HITS].tolist() == [4.0, 4.0]
    np.testing.assert_allclose(x.vts[0, 2, :3] - VT, [0.0, 90.0, 0.0], rtol=1e-12, atol=1e-9)


def test_constants_are_those_of_a_joint_kalman_filter() -> None:
    """In a linear world, of theta, a pose r = r^ + D theta and two VTs: means, covariances, likelihood."""
    rng, P = np.random.default_rng(5), np.array([[0.5, 0.2], [0.2, 0.3]])
    gains, root = rng.normal(size=(2, 3, 2)), rng.normal(size=(3, 3))
    sigmas = root @ root.T, 2.0 * np.eye(3)
    x = a_particle(P, tuple(a_row(np.zeros(3), s, g) for s, g in zip(sigmas, gains, strict=True)))
    x.r[:], x.D[:] = 0.0, 0.1 * rng.normal(size=(2, 4))
    to = np.zeros((12, 8))  # of theta and the VTs' own parts: theta, pose, VTs
    to[:2, :2], to[2:6, :2], to[6:9, :2], to[9:, :2] = np.eye(2), x.D.T, *gains
    to[6:, 2:] = np.eye(6)
    own = np.zeros((8, 8))
    own[:2, :2], own[2:5, 2:5], own[5:, 5:] = P, *sigmas
    mean, cov, likelihood = np.zeros(12), to @ own @ to.T, 0.0
    for _ in range(6):
        hv, hr, e, R = rng.normal(size=(2, 3, 3)), 0.3 * rng.normal(size=(2, 3, 4)), rng.normal(size=(2, 3)), np.diag(Q)
        H = np.zeros((6, 12))
        H[:3, 6:9], H[3:, 9:], H[:, 2:6] = hv[0], hv[1], hr.reshape(6, 4)
        x.y[:], x.info[:] = 0.0, 0.0
        for j in range(2):
            row = x.vts[0, j]
            mu, Sigma, gain = parts(row)
            A, S = hv[j] @ gain + hr[j] @ x.D.T, hv[j] @ Sigma @ hv[j].T
            seen = Seen(
                vec_of(hv[j] @ mu + hr[j] @ x.r[:4]),
                Mat3(*(hv[j] @ Sigma).ravel()),
                Sym3(*upper(S)),
                Mat32(vec_of(A[:, 0]), vec_of(A[:, 1])),
            )
            x.log_w[0] += paper.update(x, row, seen, vec_of(e[j] - np.array(seen.z)), Sym3(*upper(S + R)))
        paper.learn_constants(x)
        total = H @ cov @ H.T + np.kron(np.eye(2), R)
        miss = e.ravel() - H @ mean
        likelihood -= 0.5 * (miss @ np.linalg.solve(total, miss) + np.log(np.linalg.det(2.0 * np.pi * total)))
        K = cov @ H.T @ np.linalg.inv(total)
        mean, cov = mean + K @ miss, cov - K @ H @ cov
    (mu_a, Sigma_a, G_a), (mu_b, Sigma_b, G_b) = (parts(row) for row in x.vts[0, :2])
    P = np.array([[x.P[0], x.P[1]], [x.P[1], x.P[2]]])
    np.testing.assert_allclose(np.concatenate([x.theta, x.r[:4], mu_a, mu_b]), mean, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(P, cov[:2, :2], rtol=1e-8)
    np.testing.assert_allclose(x.D.T @ P @ x.D, cov[2:6, 2:6], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(Sigma_a + G_a @ P @ G_a.T, cov[6:9, 6:9], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(G_a @ P @ G_b.T, cov[6:9, 9:], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(Sigma_b + G_b @ P @ G_b.T, cov[9:, 9:], rtol=1e-8, atol=1e-12)
    assert x.log_w[0] == pytest.approx(likelihood, rel=1e-9)


def test_resampling_copies_particles_with_their_maps() -> None:
    estimator = paper.PaperFastSlam(paper.PaperFastSlamOptions(particles=4))
    driven(estimator, tiny_drive(), 20)
    x = estimator._x
    want = [of[2].copy() for of in x]
    x.counts[3] = 0
    estimator._resample(np.array([0.0, 0.0, 1.0, 0.0]))
    assert x.counts.sum() > 20
    for name, found, one in zip(Particles._fields, x, want, strict=True):
        for i in range(4):
            for link, count in enumerate(x.counts[i] if name == "vts" else ()):
                np.testing.assert_array_equal(found[i, link, :count], one[link, :count])
            if name not in ("vts", "log_w"):
                np.testing.assert_array_equal(found[i], one, err_msg=name)
    assert (x.log_w == 0.0).all()
    # They are copies: what becomes of one is not seen in another.
    x.vts[0, 0, 0, 0] += 1.0
    assert x.vts[1, 0, 0, 0] == want[7][0, 0, 0]


def scores_of(recording: Recording, **options: Any) -> dict[str, Any]:
    request = loaded("paper-fastslam", {"paper-fastslam": options})
    warm_up(request)
    return scored(recording, estimate(recording, request, np.random.default_rng(0)), None)


def test_maps_well_where_its_assumptions_hold_and_badly_where_not() -> None:
    recording = simulate(load("tiny", KIND), 4000, 0)
    kind, real = scores_of(recording), scores_of(simulate(load("tiny"), 4000, 0))
    assert kind["association_precision"] > 0.99
    assert kind["transmitter_rmse_m"] < 2.0
    assert real["map_gospa_m"] > 2.0 * kind["map_gospa_m"]


def test_marginalised_constants_are_found_where_drawn_ones_are_not() -> None:
    worse = {"odometry.gyro_bias_deg_per_s": 0.5, "odometry.wheel_scale": 0.1}
    recording = simulate(load("tiny", KIND | worse), 4000, 0)
    drawn, found = (scores_of(recording, motion=motion) for motion in ("sampled", "marginalised"))
    assert found["position_max_m"] < 0.3 * drawn["position_max_m"]


def test_same_answer_on_any_number_of_threads() -> None:
    before, found = numba.get_num_threads(), []
    for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(threads)
        found.append(driven(paper.PaperFastSlam(paper.PaperFastSlamOptions(particles=40)), tiny_drive(), 80)[-1].pose)
    numba.set_num_threads(before)
    np.testing.assert_array_equal(*found)
