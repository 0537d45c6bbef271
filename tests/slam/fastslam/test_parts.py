"""The replaceable parts of FastSLAM: each does what it says, by name and as an object, and the filter works with it."""

from __future__ import annotations

import itertools
import pickle
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.extending import overload

from cellslam.slam.fastslam.fastslam import FastSlam
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts.association import (
    FromTruth,
    Hungarian,
    Nearest,
    Sampled,
    associate,
    hashed,
    take_best,
)
from cellslam.slam.fastslam.parts.choice import chosen
from cellslam.slam.fastslam.parts.clock import OfVt, absorb, begin_offset, expect
from cellslam.slam.fastslam.parts.landmarks import Cartesian
from cellslam.slam.fastslam.parts.murty_kernel import best_assignments, murty
from cellslam.slam.fastslam.parts.proposal import FromMeasurements, FromMotion
from cellslam.slam.fastslam.snapshot import nuisance_kernel, pair_kernel, update_kernel
from cellslam.slam.fastslam.state.layout import (
    BOUND,
    GAIN,
    LANES,
    MU,
    O_A,
    O_H,
    O_MU,
    O_S,
    OFFSET0,
    OUT,
    OWN_OFFSET,
    OWN_VARIANCE,
    RECORD_WITH_OFFSET,
    SIGMA,
    V_WEIGHT,
    W_B,
    W_E,
    W_MASK,
    W_OFFSET_PRIOR,
    W_ROWS,
    Link,
    Scratch,
    sums_of,
)
from cellslam.slam.fastslam.state.particles import draw
from cellslam.slam.model.assignment_kernel import LEFT_OUT

from .test_exact import UPPER, read, row
from .test_fastslam import VTS, drive, make_setup, make_snapshot


def all_assignments(score: np.ndarray) -> list[tuple[float, tuple[int, ...]]]:
    """Return total and rows of every assignment of columns to different rows or none, best first, by trying each."""
    rows, columns = score.shape
    found = []
    for choice in itertools.product(range(-1, rows), repeat=columns):
        taken = [r for r in choice if r >= 0]
        if len(set(taken)) == len(taken) and all(score[r, c] > LEFT_OUT / 2 for c, r in enumerate(choice) if r >= 0):
            found.append((sum(score[r, c] for c, r in enumerate(choice) if r >= 0), choice))
    return sorted(found, reverse=True)


def test_murty_lists_the_best_assignments_in_order():
    rng = np.random.default_rng(4)
    for _ in range(60):
        rows, columns = rng.integers(1, 5, 2)
        score = rng.normal(0, 3, (rows, columns))
        score[rng.random((rows, columns)) < 0.3] = LEFT_OUT
        expected = all_assignments(score)
        most = int(rng.integers(1, len(expected) + 5))
        choices, totals = np.empty((most, columns), np.int64), np.empty(most)
        count = best_assignments(score, rows, columns, choices, totals)
        assert count == min(most, len(expected))
        assert np.allclose(totals[:count], [total for total, _ in expected[:count]])
        assert len({tuple(c) for c in choices[:count]}) == count


def test_draws_are_as_probable_as_their_scores_say():
    score = np.array([[1.0, 0.5], [-0.5, 2.0]])
    expected = all_assignments(score)
    weight = np.exp([total for total, _ in expected])
    weight /= weight.sum()
    row_of, seen = np.empty(2, np.int64), dict.fromkeys([c for _, c in expected], 0)
    for i in range(4000):
        log_chance = murty(score, 2, 2, len(expected), hashed(3, i), row_of)
        seen[tuple(row_of.tolist())] += 1
        assert log_chance == pytest.approx(np.log(weight[[c for _, c in expected].index(tuple(row_of.tolist()))]))
    assert np.allclose(np.array(list(seen.values())) / 4000, weight, atol=0.03)


@njit
def associated(part, s, found, measured, link):
    associate(part, s, found, 0, measured, link, 7, 1.0)


def scratch(scores: np.ndarray) -> Scratch:
    """Return scratch in which every lane has the same scores (C, M)."""
    c, m = scores.shape
    w = np.zeros(W_ROWS * LANES, np.float32)
    return Scratch(
        w, w.view(np.int32), np.zeros(sums_of(3).rows * LANES), np.arange(c), np.ones(c, np.bool_),
        np.zeros((c, OUT * LANES), np.float32),
        np.repeat(scores[..., None], LANES, 2).astype(np.float32), scores > 0.0, np.empty((m, LANES), np.int32),
        np.empty((c, m)), np.empty(m, np.int64), np.empty(4 * (c + m + 2)), np.empty(4 * (c + m + 2), np.int64),
    )  # fmt: skip


def link_of(tracks: int) -> Link:
    return Link(
        np.zeros((tracks, LANES), np.int32), np.zeros(tracks, np.int32), np.zeros((tracks, LANES), np.float32),
        np.arange(tracks), np.arange(tracks, dtype=np.int32), np.zeros((BOUND, tracks), np.float32),
    )  # fmt: skip


def test_hungarian_is_best_nearest_takes_the_best_pair_first():
    """The best pair leaves the other measurement a bad one: together the others are worth more."""
    scores = np.array([[5.0, 4.0], [4.5, 0.5]])
    for part, rows in ((Hungarian(), [1, 0]), (Nearest(), [0, 1])):
        s = scratch(scores)
        associated(part, s, 2, 2, link_of(2))
        assert s.row_of.tolist() == [[rows[0]] * LANES, [rows[1]] * LANES]


def test_sampled_association_corrects_the_weight_by_the_chance_of_the_draw():
    for scores in (np.array([[0.4]]), np.array([[0.4], [0.2]])):
        total = 1.0 + np.exp(scores).sum()
        s = scratch(scores)
        associated(Sampled(8, 1), s, len(scores), 1, link_of(len(scores)))
        rows = s.row_of[0]
        assert len(set(rows.tolist())) == len(scores) + 1
        worth = np.where(rows >= 0, scores[np.maximum(rows, 0), 0], 0.0)
        assert np.allclose(s.v[V_WEIGHT * LANES :][:LANES], np.log(total) - worth, atol=1e-6)


def test_told_association_is_the_truth():
    truth = FromTruth(np.array([4, -1, 9, 9, 4]))
    first = truth.for_snapshot(make_snapshot(0, [(0, 1.0, 0.0, 0.0)] * 3), 0)
    assert first.vt.tolist() == [4, -1, 9]
    s = scratch(np.full((3, 3), -1.0))
    associated(first, s, 3, 3, link_of(3))
    assert s.row_of[:, 0].tolist() == [0, -1, 2]


@njit
def expected_with(part, w, rec, out):
    expect(part, Cartesian(), w, rec, out)


@njit
def begun(part, w, rec):
    begin_offset(part, w, rec)


@njit
def absorbed(part, w, v, rec, out):
    absorb(part, w, v, rec, out)


def test_an_offset_of_its_own_is_a_fourth_state():
    """One Cartesian VT, its offset its own, in a linear world: as one Kalman filter of four states."""
    rng = np.random.default_rng(2)
    parts = chosen(FastSlamOptions(landmarks="cartesian", clock="per-vt")).parts
    w, out, v = np.zeros(W_ROWS * LANES), np.zeros(OUT * LANES), np.zeros(sums_of(3).rows * LANES)
    rec = np.zeros(RECORD_WITH_OFFSET * LANES)
    mean, cov = np.array([40.0, -20.0, 10.0, 3.0]), np.diag([4.0, 9.0, 2.0, 25.0])
    gain = rng.normal(size=3)
    cov[:3, :3] += 25.0 * np.outer(gain, gain)
    cov[:3, 3] = cov[3, :3] = 25.0 * gain
    row(w, W_B, 3.0)
    row(w, W_OFFSET_PRIOR, 25.0)
    row(w, W_MASK, 1.0)
    begun(OfVt(), w, rec)
    row(rec, OFFSET0, 3.0)
    row(rec, MU, [40.0, -20.0, 10.0, 0.0, 0.0])
    row(rec, SIGMA, np.diag([4.0, 9.0, 2.0])[UPPER])
    row(rec, GAIN, np.column_stack([gain, np.zeros((3, 2))]).ravel())
    q, evidence = np.array([0.3, 0.2, 0.4]), 0.0
    for _ in range(20):
        h = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
        full = np.column_stack([h, [1.0, 0.0, 0.0]])
        e = full @ rng.normal(size=4)
        nuisance_kernel.forget(w, v, 3)
        expected_with(OfVt(), w, rec, out)
        gain = read(rec, GAIN, 9).reshape(3, 3)
        sigma = np.zeros((3, 3))
        sigma[UPPER] = read(rec, SIGMA, 6)
        sigma = sigma + np.triu(sigma, 1).T
        row(out, O_H, h.ravel())
        row(out, O_A, (h @ gain + np.array([[1, 0, 0], [0, 0, 0], [0, 0, 0]])).ravel())
        row(out, O_S, (h @ sigma @ h.T)[UPPER])
        moved = gain[:, 0] * (read(rec, OWN_OFFSET, 1)[0] - read(rec, OFFSET0, 1)[0])
        row(out, O_MU, np.append(read(rec, MU, 3) + moved, [0.0, 0.0]))
        row(w, W_E, e)
        numbers = np.array([0, 1, 0, 1, 0, *q, 1, 1, 1, 0.0])
        pair_kernel.invert(w, out, numbers, 0.0)
        pair_kernel.logarithm(w, w.view(np.int64))
        update_kernel.credit(w, v, out, 0.0, 1.0)
        absorbed(OfVt(), w, v, rec, out)
        update_kernel.correct(parts, w, rec, out)
        s = full @ cov @ full.T + np.diag(q)
        k = cov @ full.T @ np.linalg.inv(s)
        evidence = -0.5 * (e @ np.linalg.solve(s, e) + np.linalg.slogdet(s)[1] + 3 * np.log(2 * np.pi))
        mean, cov = mean + k @ e, cov - k @ s @ k.T
        assert read(v, V_WEIGHT, 1)[0] == pytest.approx(evidence, abs=1e-6)
    offset, variance = read(rec, OWN_OFFSET, 1)[0], read(rec, OWN_VARIANCE, 1)[0]
    assert (offset, variance) == pytest.approx((mean[3], cov[3, 3]), rel=1e-9)
    gain = read(rec, GAIN, 9).reshape(3, 3)[:, 0]
    assert np.allclose(read(rec, MU, 3) + gain * (offset - read(rec, OFFSET0, 1)[0]), mean[:3], atol=1e-9)
    sigma[UPPER] = read(rec, SIGMA, 6)
    sigma = np.triu(sigma) + np.triu(sigma, 1).T
    assert np.allclose(sigma + variance * np.outer(gain, gain), cov[:3, :3], atol=1e-9)


def test_noise_is_drawn_from_its_posterior_and_the_weight_takes_prior_over_proposal():
    """Two sightings of displacement and turn, many particles: mean and spread of what is drawn, and the mean weight."""
    setup = make_setup()
    particles = draw(setup, 64_000, 20.0, 1, np.random.default_rng(0))
    dt, information = 0.1, np.array([[4e4, 2e3], [2e3, 9e6]])
    y = np.array([30.0, -500.0])

    def sight(velocity: np.ndarray) -> np.ndarray:
        flat = np.array([*y, information[0, 0], information[0, 1], information[1, 1]])
        return np.broadcast_to(flat[:, None], (len(velocity), 5, LANES)).copy()

    odometry = np.array([1.0, 0, 0, 0.2, 0, 0])
    model = setup.odometry_model
    velocity = FromMeasurements()(particles, model, dt, odometry, sight, np.random.default_rng(1))
    prior = np.diag(model.noise_density[[0, 3]] ** 2 / dt) * dt**2
    posterior = np.linalg.inv(np.linalg.inv(prior) + information)
    drawn = (velocity[:, [0, 3]] - odometry[[0, 3]][:, None]) * dt
    drawn = np.swapaxes(drawn, 1, 2).reshape(-1, 2)
    assert np.allclose(drawn.mean(axis=0), posterior @ y, atol=5 * np.sqrt(np.diag(posterior) / len(drawn)))
    assert np.allclose(np.cov(drawn.T), posterior, rtol=0.05, atol=0.02 * np.sqrt(np.prod(np.diag(posterior))))
    likelihood = np.exp(drawn @ y - 0.5 * np.einsum("ni,ij,nj->n", drawn, information, drawn))
    evidence = np.exp(0.5 * y @ posterior @ y) / np.sqrt(np.linalg.det(np.eye(2) + prior @ information))
    assert np.mean(likelihood * np.exp(particles.log_weight.ravel())) == pytest.approx(evidence, rel=1e-3)
    again = FromMotion()(particles, model, dt, odometry, sight, np.random.default_rng(1))
    assert np.std(again[:, 0]) == pytest.approx(model.noise_density[0] / np.sqrt(dt), rel=0.02)


class FirstCome(NamedTuple):
    """An association of one's own: each measurement takes the track it likes best, whoever has it already."""


@overload(associate, jit_options={"error_model": "numpy"})
def _first_come(part, s, found, first, measured, link, turn, share):
    if getattr(part, "instance_class", None) is not FirstCome:
        return None

    def implementation(part, s, found, first, measured, link, turn, share):
        take_best(s, found, measured)

    return implementation


VARIANTS = {
    "sampled, Cartesian, an offset each, from measurements": (
        {
            "association": "sampled",
            "landmarks": "cartesian",
            "clock": "per-vt",
            "proposal": "measurements",
            "motion": "sampled",
        },
        {},
    ),
    "own object, bare distance, shared": (
        {"criterion": "mahalanobis", "sharing": "none", "clock": "sampled"},
        {"association": FirstCome()},
    ),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_filter_works_with_other_parts(variant):
    names, objects = VARIANTS[variant]
    options = FastSlamOptions(particles=64, vts_per_link=16, start_phase_s=0.0, **names)

    def once() -> tuple[list, np.ndarray]:
        filter_ = FastSlam(options, **objects)
        filter_.start(make_setup(offset_std=5.0), np.random.default_rng(1))
        return drive(filter_, VTS, [0, 0, 1, 1], 120, np.random.default_rng(2))

    estimates, poses = once()
    last = estimates[-1]
    assert np.hypot(*(last.pose[:2] - poses[-1, :2])) < 0.8
    assert len(last.vts.id) >= 4
    assert (last.association >= 0).mean() > 0.7
    for estimate in estimates:
        assert np.isfinite(estimate.pose).all()
        assert np.linalg.eigvalsh(estimate.covariance).min() > -1e-9
    again, _ = once()
    assert np.array_equal(again[-1].pose, last.pose)


def test_parts_are_named_and_pickle():
    with pytest.raises(TypeError, match="no part 'asociation'"):
        FastSlam(asociation=Nearest())
    options = FastSlamOptions(association="nearest", landmarks="cartesian", proposal="measurements")
    copy = pickle.loads(pickle.dumps(FastSlam(options, association=Hungarian())))
    assert copy.choice.parts == chosen(options).parts._replace(association=Hungarian())
