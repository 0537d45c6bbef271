"""EKF-SLAM's kernels against plain formulas: prediction, birth, update, motion, sizes, the ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cellslam.sim.frames import integrate_pose, rotation, unit_vector
from cellslam.slam.api import setup_of
from cellslam.slam.conformance.subject import tiny_drive
from cellslam.slam.joint.new_filters import NO_ERRORS, core_of, new_mixture
from cellslam.slam.joint.snapshot.association_kernel import expect, score_pairs
from cellslam.slam.joint.snapshot.birth_kernel import give_birth
from cellslam.slam.joint.snapshot.motion_kernel import Interval, Step, forget, move
from cellslam.slam.joint.snapshot.observation_kernel import field, ground, rotations_of
from cellslam.slam.joint.snapshot.sizes_kernel import DIFFUSE_SIZE, WHITE, count_diffuse, count_white
from cellslam.slam.joint.snapshot.update_kernel import Vec3, add_up, compare, correct, gains, innovate, update
from cellslam.slam.joint.state.layout import LAST, ArrayErrors, one_of
from cellslam.slam.joint.state.states_kernel import enter, leave
from cellslam.slam.model.field_kernel import bells, grid
from cellslam.slam.model.matrices_kernel import Sym3
from cellslam.slam.model.measurement_kernel import Spherical
from cellslam.slam.model.measurement_model import predict

POSE = np.array([3.0, -2.0, 1.5, 0.7, 0.1, -0.2])
OFFSET = 6
NOW = 3  # number of the fixture's snapshot
ERRORS = ArrayErrors(
    np.array([0.2, 0.004, 0.006]), grid(0.6, 1.1, 1.9), np.array([0.0, 0.01, 0.02]), grid(0.4, 1.3, 1.9),
    np.array([0.7, 0.013, 0.009]), 0.15, np.array([0.005, 0.008, 0.009]), 0.15, np.radians([0.1, 0.3]), 3.0, 0.5,
)  # fmt: skip


def slopes(function: Callable[[Any], Any], x: Any) -> Any:
    """Return the numeric Jacobian of a function at x."""
    steps = 1e-6 * np.eye(len(x))
    return np.array([(function(x + step) - function(x - step)) / 2e-6 for step in steps]).T


@pytest.mark.parametrize("scale", [None, 0.06])
def test_prediction_and_jacobians_are_those_of_the_model(one_filter: Any, scale: float | None) -> None:
    one = one_filter(scale=scale)
    one.put(POSE, 15.0, [90.0, 2.5, 0.3], anchor=[-4.0, 6.0, 2.0])
    n = one.n
    p, mean = one.spread(np.random.default_rng(0).normal(size=(n, n))), one.f.x[:n].copy()

    def expected(x: Any) -> Any:
        one.f.x[:n] = x
        return one.model(0)[0]

    h, by = one.model(0)
    by_model = predict(POSE, one.place(0)) * [1.0 + (scale or 0.0), 1.0, 1.0]
    np.testing.assert_allclose(h - [15.0, 0.0, 0.0], by_model, rtol=1e-12)
    np.testing.assert_allclose(by, slopes(expected, mean), rtol=1e-6, atol=1e-7)
    one.f.x[:n] = mean
    spread = (by @ p @ by.T)[np.triu_indices(3)]
    _, hph = compare(one.f, NO_ERRORS, 0, one.offset, one.measurement(h, np.ones(3)), one.w.jacobian, one.w.pending)
    np.testing.assert_allclose(hph, spread, rtol=1e-10)
    given = expect(one.f, NO_ERRORS, 0, one.offset, rotations_of(one.f), one.w.jacobian)
    np.testing.assert_allclose(given.hph, spread, rtol=1e-10)
    np.testing.assert_allclose(given.z, h, rtol=1e-12)


def test_errors_that_persist_enter_and_are_linear_in_their_states(one_filter: Any) -> None:
    one = one_filter(ERRORS)
    one.put(POSE, 15.0, [90.0, 2.5, 0.3])
    assert (one.f.core.sway >= 0).all()  # sway is always there, pose and offset before it
    before = one.n
    plain = np.array(predict(POSE, one.place(0))) + 15.0 * np.eye(3)[0]
    h, by = one.model(0)
    assert one.n > before + 3 + 4  # weights of two fields, and the three diffuse errors
    entered = np.arange(before, one.n)
    np.testing.assert_allclose(np.diag(one.f.p)[entered], 1.0)
    weights = np.setdiff1d(entered, one.f.vts.state[0])
    # The squares of the bells sum to one: all errors together have the variances that they were told.
    variance = ERRORS.calibration**2 + ERRORS.roof**2 + ERRORS.diffuse**2
    np.testing.assert_allclose((by[:, entered] ** 2).sum(axis=1), variance, rtol=1e-12)
    np.testing.assert_allclose((by[:, weights] ** 2).sum(axis=1), ERRORS.calibration**2 + ERRORS.roof**2, rtol=1e-12)
    states = np.append(entered, [*one.f.core.sway, one.f.core.ground])
    one.f.x[states] = x = np.random.default_rng(1).normal(size=len(states))
    np.testing.assert_allclose(one.model(0)[0] - plain, by[:, states] @ x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(h, plain, rtol=1e-12)


@pytest.mark.parametrize("scale", [None, 0.06])
def test_birth_is_exact_and_correlated_with_all_states(one_filter: Any, scale: float | None) -> None:
    one, z, q = one_filter(scale=scale), np.array([120.0, 1.0, 0.2]), np.array([0.4, 2e-4, 3e-4])
    one.put(POSE, 15.0)
    n = one.n
    before = one.spread(np.random.default_rng(0).normal(size=(n, n)) * 0.01)

    def born(x: Any) -> Any:
        """Return range, azimuth, elevation about POSE's place of what pose, scale, offset and measurement point to."""
        distance = (x[n] - x[one.offset]) / (1.0 if scale is None else 1.0 + x[one.f.core.range_scale])
        out = x[:3] + distance * rotation(*x[3:6]) @ unit_vector(x[n + 1], x[n + 2]) - POSE[:3]
        flat = np.hypot(out[0], out[1])
        return np.array([np.hypot(flat, out[2]), np.arctan2(out[1], out[0]), np.arctan2(out[2], flat)])

    one.f.vts.state[0] = -1
    given = np.concatenate([one.f.x[:n], z])
    assert give_birth(one.f, NO_ERRORS, 0, one.offset, z, q, True, 1.0, 3, one.w.jacobian, one.w.pending)
    at, by, p = one.f.vts.state[0, :3], slopes(born, given), one.f.p[: one.n, : one.n]
    np.testing.assert_array_equal(at, n + np.arange(3))
    np.testing.assert_allclose(one.f.x[at], born(given), rtol=1e-12)
    np.testing.assert_allclose(p[n:, :n], by[:, :n] @ before, rtol=1e-5, atol=1e-9)
    spread = by[:, :n] @ before @ by[:, :n].T + (by[:, n:] * q) @ by[:, n:].T
    np.testing.assert_allclose(p[n:, n:], spread, rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(p, p.T)


def test_updates_are_textbook_kalman_updates_also_while_they_wait(one_filter: Any, kalman: Callable[..., Any]) -> None:
    one, q, turn = one_filter(), np.array([0.3, 1e-4, 2e-4]), np.array([0.0, 2.0 * np.pi, 0.0])
    one.put(POSE, 5.0, [80.0, 0.5, 0.2], [60.0, -1.0, 0.1])
    cov = one.spread(np.random.default_rng(1).normal(size=(13, 13)) * 0.02)
    mean = begin = one.f.x[:13].copy()
    for j, e in ((0, [0.2, 0.01, -0.02]), (1, [-0.3, 0.01, 0.01]), (0, [0.1, np.nan, 0.01]), (1, [0.1, 0.0, 0.0])):
        h, by = one.model(j)
        n = len(mean)
        mean, cov, value = kalman(mean, cov, by[:, :n], np.array(e) - by @ (mean - begin), q)
        got = correct(
            one.f, NO_ERRORS, j, OFFSET, one.measurement(h + e + turn, q), 1.0, one.rules, one.w.jacobian, one.w.pending
        )
        np.testing.assert_allclose(got, value, rtol=1e-8)
        np.testing.assert_array_equal(one.f.x[:n], begin)  # about which all measurements are linearised
        # A state that enters meanwhile is independent.
        enter(one.f, -1, 4.0)
        mean, begin = np.append(mean, 0.0), np.append(begin, 0.0)
        cov = np.block([[cov, np.zeros((n, 1))], [np.zeros((1, n)), np.full((1, 1), 4.0)]])
    add_up(one.f, one.w.pending)
    np.testing.assert_allclose(one.f.x[: one.n], mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.f.p[: one.n, : one.n], cov, rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(one.f.p, one.f.p.T)


def test_pairs_beyond_the_gate_are_none(one_filter: Any, kalman: Callable[..., Any]) -> None:
    one, q = one_filter(), np.array([0.3, 1e-4, 2e-4])
    one.put(POSE, 5.0, [80.0, 0.5, 0.2])
    one.f.vts.slots[0, LAST] = NOW - 4
    p = one.spread(np.random.default_rng(1).normal(size=(10, 10)) * 0.02)
    h, by = one.model(0)
    for e in np.array([[0.2, 0.01, -0.02], [0.3, np.nan, 0.02]]):
        there = np.isfinite(e)
        s = (by @ p @ by.T + np.diag(q))[np.ix_(there, there)]
        e /= np.sqrt(e[there] @ np.linalg.solve(s, e[there]))
        near, far = np.sqrt(16.3 - 0.01) * e, np.sqrt(16.3 + 0.01) * e
        seen = one.seen(h + np.array([near, far]), np.array([q, q]))
        assert score_pairs(one.f, NO_ERRORS, seen, 0, one.w.jacobian, one.w.pairs) == 1
        assert one.w.pairs.score[0, 0] == pytest.approx(kalman(one.f.x[:10], p, by, near, q)[2])
        assert one.w.pairs.score[0, 1] == -np.inf
        assert one.w.pairs.gated[:2].tolist() == [1, 0]


def test_fields_are_one_kalman_filter_over_all_weights(one_filter: Any, kalman: Callable[..., Any]) -> None:
    """Weights that enter as directions are met, and leave, in a linear world: exactly the joint filter of them all."""
    rng, std, g = np.random.default_rng(5), np.array([0.3, 0.02, 0.05]), grid(0.5, 1.3, 1.9)
    one = one_filter(NO_ERRORS._replace(calibration=std, calibration_grid=g))
    f, w = one.f, one.w
    one.mixture.reserve(3 * g.cells, 1)
    f = one_of(one.mixture.arrays, 0)
    n = len(f.x)
    w = w._replace(pending=w.pending._replace(rows=np.zeros((51, n)), t=np.zeros((3, n)), added=np.zeros(n)))
    mean, cov, q = np.zeros(3 * g.cells), np.eye(3 * g.cells), np.array([0.1, 1e-4, 2e-4])
    for now in range(60):
        azimuth, elevation = rng.uniform(-3.0, 3.0), rng.uniform(-0.5, 0.8)
        w.jacobian.size[0] = 0
        value = field(f, g, std, 0, Spherical(1.0, azimuth, elevation), now, w.jacobian)
        count = bells(g, azimuth, elevation, w.jacobian.cells, w.jacobian.values)
        row = np.zeros((3, len(mean)))
        for c in range(3):
            row[c, c * g.cells + w.jacobian.cells[:count]] = std[c] * w.jacobian.values[:count]
        np.testing.assert_allclose(value, row @ mean, atol=1e-9)
        e = rng.normal(size=3) * [0.4, 0.02, 0.05]
        mean, cov, log_density = kalman(mean, cov, row, e, q)
        hph = gains(f, w.jacobian, w.pending)
        assert update(f, innovate(Vec3(*e), q, hph), w.pending) == pytest.approx(log_density, rel=1e-9, abs=1e-9)
        add_up(f, w.pending)
        if now == 30:  # give up some weights: in the joint filter they are marginalised, and met again as new ones
            for owner in list(f.owner[f.core.size : f.size[0]])[:20]:
                leave(f, int(f.fields.state[owner]))
                mean[owner], cov[owner], cov[:, owner], cov[owner, owner] = 0.0, 0.0, 0.0, 1.0
    met = np.flatnonzero(f.fields.state >= 0)
    assert len(met) > 80
    places = f.fields.state[met]
    np.testing.assert_allclose(f.x[places], mean[met], atol=1e-9)
    np.testing.assert_allclose(f.p[np.ix_(places, places)], cov[np.ix_(met, met)], atol=1e-9)


def test_what_persists_fades_as_a_gauss_markov_process(one_filter: Any) -> None:
    one = one_filter(ERRORS)
    one.put(POSE, 5.0, [80.0, 0.5, 0.2])
    one.model(0)
    root = np.random.default_rng(3).normal(size=(one.n, one.n))
    p, x = one.spread(root), one.f.x[: one.n].copy()
    moved, dt, area = 0.1, 0.05, np.sqrt(np.pi / 2.0)
    kept, variance = np.ones(one.n), np.zeros(one.n)
    diffuse = one.f.vts.state[0, 3:]
    kept[diffuse], variance[diffuse] = np.exp(-moved / (area * ERRORS.diffuse_m)), 1.0
    kept[one.f.core.sway], variance[one.f.core.sway] = np.exp(-dt / (area * ERRORS.sway_s)), ERRORS.sway**2
    kept[4:6], variance[4:6] = np.exp(-dt / (area * ERRORS.tilt_s)), ERRORS.tilt**2
    forget(one.f, ERRORS, moved, dt)
    np.testing.assert_allclose(one.f.x[: one.n], kept * x, rtol=1e-12)
    expected = kept[:, None] * p * kept + np.diag((1.0 - kept**2) * variance)
    np.testing.assert_allclose(one.f.p[: one.n, : one.n], expected, rtol=1e-12)


def test_motion_is_that_of_the_frames_module() -> None:
    setup = setup_of(tiny_drive())
    sheet = replace(setup.odometry_model, bias=np.full(6, 0.02), scale=np.full(6, 0.01), noise_density=np.full(6, 0.01))
    setup = replace(
        setup, odometry_model=replace(sheet, bias_walk_density=np.full(6, 1e-3)), start_pose=POSE,
        start_std=np.full(6, 0.05),
    )  # fmt: skip
    core = core_of(setup, NO_ERRORS)
    f = one_of(new_mixture(setup, core, NO_ERRORS, np.zeros((1, 2)), np.ones(2)).arrays, 0)
    u, dt, n = np.array([2.0, 0.3, -0.1, 0.4, -0.2, 0.1]), 0.3, core.size
    f.x[core.bias], f.x[core.scale] = 0.01, 0.02
    before, p = np.concatenate([f.x[:n], np.zeros(6)]), f.p[:n, :n].copy()

    def moved(x: Any) -> Any:
        """Return the core that a core, and behind it the odometry's noise, move to."""
        velocity = (u - x[core.bias] - x[n:]) / (1.0 + x[core.scale])
        out = np.concatenate([integrate_pose(x[:6], velocity, dt), x[6:n]])
        out[core.noise] += x[n:] * dt
        return out

    noise, walk = setup.odometry_model.noise_density, setup.odometry_model.bias_walk_density
    move(f, Interval(dt, u, noise, walk), Step(np.empty((6, n + 6)), np.empty((6, len(f.x)))))
    by = slopes(moved, before)
    expected = by[:, :n] @ p @ by[:, :n].T + by[:, n:] @ by[:, n:].T * 0.01**2 / dt
    expected[core.bias, core.bias] += 1e-6 * dt
    np.testing.assert_allclose(f.x[:n], moved(before), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(f.p[:n, :n], expected, rtol=1e-6, atol=1e-10)


def test_sizes_have_the_slope_and_information_of_the_likelihood(one_filter: Any) -> None:
    """Of a measurement with white noise and a state that it shows: the numeric slope of log N in the log of each
    size."""
    one, rng = one_filter(ERRORS), np.random.default_rng(4)
    root, q, load, told = rng.normal(size=(3, 3)), np.array([0.3, 0.5, 0.2]), np.array([0.6, 0.4, 0.7]), 0.8
    e = rng.normal(size=3)

    def log_density(factor: Any) -> Any:
        state = told * np.exp(2.0 * factor[3]) * np.outer(load, load)
        s = root @ root.T + np.diag(q * np.exp(2.0 * factor[:3])) + state
        return np.array([-0.5 * (e @ np.linalg.solve(s, e) + np.log(np.linalg.det(s)))])

    s = root @ root.T + np.diag(q) + told * np.outer(load, load)
    spread = Sym3(*s[np.triu_indices(3)])
    count_white(one.f, Vec3(*e), spread, q)
    count_diffuse(one.f, 0, told, q[0], Vec3(*(told * load)), Vec3(*e), spread)
    at = np.append(np.arange(WHITE, WHITE + 3), DIFFUSE_SIZE)
    np.testing.assert_allclose(one.f.learnt.sizes[0, at], slopes(log_density, np.zeros(4))[0], rtol=1e-5)
    inverse = np.linalg.inv(s)
    information = 2.0 * np.append(q * np.diag(inverse), told * load @ inverse @ load) ** 2
    np.testing.assert_allclose(one.f.learnt.sizes[1, at], information, rtol=1e-9)
    by_white, by_state = inverse @ np.diag([2.0 * q[0], 0.0, 0.0]), inverse @ (2.0 * told * np.outer(load, load))
    assert one.f.learnt.sizes[2, WHITE] == pytest.approx(0.5 * np.trace(by_white @ by_state), rel=1e-9)


PULL_DEG = -2.713  # at 10 degrees: sin 0.17365, root of 4 + sin^2 2.00752, coefficient -0.39616, power 0.15694


@pytest.mark.parametrize(("elevation_deg", "pull_deg"), [(10.0, PULL_DEG), (-10.0, 0.0), (0.0, 0.0)])
def test_the_mean_of_a_path_and_its_reflection_from_the_ground(
    one_filter: Any, elevation_deg: float, pull_deg: float
) -> None:
    one = one_filter(NO_ERRORS._replace(ground=0.5))
    place, sight = one.f.core.ground, one.w.jacobian
    assert one.f.p[place, place] == 0.5**2
    one.f.x[place], sight.size[0] = 2.0, 0
    value = ground(one.f, Spherical(100.0, 0.7, np.radians(elevation_deg)), sight)
    np.testing.assert_allclose(np.degrees(value), [0.0, 0.0, 2.0 * pull_deg], atol=2e-3)
    assert sight.size[0] == (pull_deg != 0.0)
    if pull_deg:
        np.testing.assert_allclose(np.degrees(sight.by[:, 0]), [0.0, 0.0, pull_deg], atol=1e-3)
