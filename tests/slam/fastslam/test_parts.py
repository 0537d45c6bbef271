"""The replaceable parts of FastSLAM: each does what it says, by name and as an object, and the filter works with it."""

from __future__ import annotations

import itertools
import pickle
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts.association import (
    FromTruth,
    Hungarian,
    Sampled,
    associate,
    hashed,
    may_be_born,
    take_best,
)
from cellslam.slam.fastslam.parts.choice import chosen
from cellslam.slam.fastslam.parts.murty_kernel import best_assignments, murty
from cellslam.slam.fastslam.parts.part_types import variant
from cellslam.slam.fastslam.parts.proposal import FromMeasurements, FromMotion
from cellslam.slam.fastslam.path_particles import PathParticles
from cellslam.slam.fastslam.state.layout import BOUND, LANES, OUT, V_WEIGHT, W_ROWS, Link, Scratch, sums_of
from cellslam.slam.fastslam.state.particles import draw
from cellslam.slam.model.assignment_kernel import LEFT_OUT

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
def born(part, k):
    return may_be_born(part, k)


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


def test_hungarian_does_not_take_the_best_pair_first():
    """The best pair leaves the other measurement a bad one: together the others are worth more."""
    s = scratch(np.array([[5.0, 4.0], [4.5, 0.5]]))
    associated(Hungarian(), s, 2, 2, link_of(2))
    assert s.row_of.tolist() == [[1] * LANES, [0] * LANES]


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
    assert [born(first, k) for k in range(3)] == [True, False, True]


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


@variant(associate, FirstCome)
def _first_come(part, s, found, first, measured, link, turn, share):
    take_best(s, found, measured)


def test_what_a_part_has_no_variant_of_is_as_by_default():
    s = scratch(np.array([[5.0, 4.0], [4.5, 0.5]]))
    associated(FirstCome(), s, 2, 2, link_of(2))
    assert s.row_of.tolist() == [[0] * LANES, [0] * LANES]
    assert born(FirstCome(), 0)


OTHER_PARTS = {
    "association": "sampled", "proposal": "measurements", "motion": "sampled", "criterion": "mahalanobis",
    "sharing": "none", "clock": "sampled",
}  # fmt: skip


def test_filter_works_with_other_parts():
    options = FastSlamOptions(errors="counted", particles=64, vts_per_link=16, start_phase_s=0.0, **OTHER_PARTS)

    def once() -> tuple[list, np.ndarray]:
        filter_ = PathParticles(options)
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
        PathParticles(asociation=Hungarian())
    options = FastSlamOptions(errors="counted", association="sampled", criterion="mahalanobis", proposal="measurements")
    copy = pickle.loads(pickle.dumps(PathParticles(options, association=Hungarian())))
    assert copy.choice.parts == chosen(options).parts._replace(association=Hungarian())
