"""The replaceable parts of FastSLAM: each does what it says, by name and as an object, and the filter works with it."""

from __future__ import annotations

import pickle
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts.association import (
    FromTruth,
    Hungarian,
    associate,
    may_be_born,
    take_best,
)
from cellslam.slam.fastslam.parts.choice import chosen
from cellslam.slam.fastslam.parts.part_types import variant
from cellslam.slam.fastslam.path_particles import PathParticles
from cellslam.slam.fastslam.state.layout import BOUND, LANES, OUT, W_ROWS, Link, Scratch, sums_of

from .test_fastslam import VTS, drive, make_setup, make_snapshot


@njit
def born(part, k):
    return may_be_born(part, k)


@njit
def associated(part, s, found, measured, link):
    associate(part, s, found, 0, measured, link)


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


def test_told_association_is_the_truth():
    truth = FromTruth(np.array([4, -1, 9, 9, 4]))
    first = truth.for_snapshot(make_snapshot(0, [(0, 1.0, 0.0, 0.0)] * 3), 0)
    assert first.vt.tolist() == [4, -1, 9]
    s = scratch(np.full((3, 3), -1.0))
    associated(first, s, 3, 3, link_of(3))
    assert s.row_of[:, 0].tolist() == [0, -1, 2]
    assert [born(first, k) for k in range(3)] == [True, False, True]


class FirstCome(NamedTuple):
    """An association of one's own: each measurement takes the track it likes best, whoever has it already."""


@variant(associate, FirstCome)
def _first_come(part, s, found, first, measured, link):
    take_best(s, found, measured)


def test_what_a_part_has_no_variant_of_is_as_by_default():
    s = scratch(np.array([[5.0, 4.0], [4.5, 0.5]]))
    associated(FirstCome(), s, 2, 2, link_of(2))
    assert s.row_of.tolist() == [[0] * LANES, [0] * LANES]
    assert born(FirstCome(), 0)


OTHER_PARTS = {"motion": "sampled", "criterion": "mahalanobis", "sharing": "none", "clock": "sampled"}


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
    options = FastSlamOptions(errors="counted", criterion="mahalanobis")
    copy = pickle.loads(pickle.dumps(PathParticles(options, association=Hungarian())))
    assert copy.choice.parts == chosen(options).parts._replace(association=Hungarian())
