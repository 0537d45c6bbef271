"""Maps of several cars as one: covariance intersection by hand and in full, shared errors, maps that do not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats
from cellslam.slam.model.map_joining import EXACT_M2, fused, join, join_maps, pairs_of
from cellslam.slam.model.vt_map import VtMap


def map_at(position_m: Floats, own_m2: Floats, common_m: Floats | None = None, site: str = "A") -> VtMap:
    """Return a map of VTs (V, 3) on one link, all seen from one street."""
    count, whole = len(position_m), np.zeros(len(position_m), np.int64)
    return VtMap(
        np.array([site] * count, np.str_), whole, whole, np.array(position_m), np.zeros((count, 3)), np.array(own_m2),
        np.zeros((count, 3, 1)) if common_m is None else common_m,
        np.tile([[0.0, 0.0], [50.0, 4.0]], (count, 1, 1)), whole + 9, whole,
    )  # fmt: skip


def drawn(count: int, rng: np.random.Generator) -> VtMap:
    """Return a map with own and common errors of about a metre, of VTs 40 m from each other."""
    root = 0.5 * rng.standard_normal((count, 3, 3))
    at = 40.0 * np.arange(1, count + 1)[:, None] + np.array([60.0, 0.0, 5.0])
    return map_at(at, root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(3), 0.4 * rng.standard_normal((count, 3, 4)))


def off(m: VtMap, rng: np.random.Generator) -> VtMap:
    """Return a map whose positions are as far off as it says."""
    error = rng.multivariate_normal(np.zeros(3 * len(m)), m.joint_covariance_m2)
    return replace(m, position_m=m.position_m + error.reshape(-1, 3))


def test_two_gaussians_by_hand() -> None:
    # Half of 1 + 1/4 and of 1/4 + 1 is 0.625: a variance of 1.6. Half of 1/4 of one metre, times 1.6, is 0.2 m.
    a = map_at([[100.0, 0.0, 5.0]], [np.diag([1.0, 4.0, 2.0])])
    b = map_at([[101.0, 0.0, 5.0]], [np.diag([4.0, 1.0, 2.0])])
    found = join(a, b)
    assert (found.same, found.apart) == (1, 0) and found.weight == pytest.approx(0.5, abs=1e-4)
    np.testing.assert_allclose(found.map.covariance_m2[0], np.diag([1.6, 1.6, 2.0]), atol=1e-3)
    np.testing.assert_allclose(found.map.position_m, [[100.2, 0.0, 5.0]], atol=1e-3)


@pytest.mark.parametrize("weight", [0.3, 0.5, 0.8])
def test_joint_covariances_are_intersected(weight: float) -> None:
    # VTs 0 to 3 of the first map, 2 to 5 of the second: information adds, and is zero of what a map does not have.
    rng = np.random.default_rng(3)
    six = drawn(6, rng)
    a = six.part(slice(0, 4))
    b = off(replace(six, common_m=rng.permutation(six.common_m)).part(slice(2, 6)), rng)
    found = fused(a, b, pairs_of(a, b), weight)
    information, total = np.zeros((18, 18)), np.zeros(18)
    for m, share, first in ((a, weight, 0), (b, 1.0 - weight, 6)):
        at = slice(first, first + 12)
        inverse = share * np.linalg.inv(m.joint_covariance_m2)
        information[at, at] += inverse
        total[at] += inverse @ m.position_m.ravel()
    order = np.array([2, 3, 0, 1, 4, 5])  # those of both come first
    covariance = np.linalg.inv(information).reshape(6, 3, 6, 3)[order][:, :, order].reshape(18, 18)
    position = np.linalg.solve(information, total).reshape(6, 3)[order]
    np.testing.assert_allclose(found.joint_covariance_m2, covariance, atol=2e-5)
    np.testing.assert_allclose(found.position_m, position, atol=2e-5)


def test_a_map_joined_with_itself_gains_nothing() -> None:
    a = drawn(8, np.random.default_rng(1))
    again = join_maps([a, a, a])
    np.testing.assert_allclose(again.joint_covariance_m2, a.joint_covariance_m2, atol=1e-5)
    np.testing.assert_allclose(again.position_m, a.position_m, atol=1e-9)
    assert again.hits.tolist() == a.hits.tolist()


@pytest.mark.parametrize("shared", [0.0, 0.5, 1.0])
def test_no_map_is_surer_than_it_is_right(shared: float) -> None:
    # Errors of which any share is the same in both maps: squared deviations per coordinate are 1 at most on average.
    rng = np.random.default_rng(7)
    true = drawn(5, rng)
    size, root = 15, np.linalg.cholesky(true.joint_covariance_m2)
    squares = []
    for _ in range(200):
        both, *each = rng.standard_normal((3, size))
        errors = (root @ (np.sqrt(shared) * both + np.sqrt(1.0 - shared) * own) for own in each)
        a, b = (replace(true, position_m=true.position_m + error.reshape(-1, 3)) for error in errors)
        found = fused(a, b, pairs_of(true, true), 0.5)
        error = (found.position_m - true.position_m).ravel()
        squares.append(error @ np.linalg.solve(found.joint_covariance_m2, error) / size)
    assert np.mean(squares) == pytest.approx(0.5 + 0.5 * shared, abs=0.06)


def test_a_pair_that_does_not_fit_is_kept_apart_and_said() -> None:
    a = drawn(6, np.random.default_rng(2))
    by = np.zeros((6, 3))
    by[3, 0] = 8.0
    small = replace(a, own_m2=0.05 * a.own_m2, common_m=0.2 * a.common_m)
    found = join(small, replace(small, position_m=small.position_m + by))
    assert (found.same, found.apart, len(found.map)) == (5, 1, 7)


def test_one_vt_is_not_two() -> None:
    a = map_at([[100.0, 0.0, 5.0]], [np.eye(3)])
    b = map_at([[100.3, 0.0, 5.0], [101.5, 0.0, 5.0]], [np.eye(3)] * 2)
    assert pairs_of(a, b).other.tolist() == [0]
    assert len(pairs_of(a, replace(b, site=np.array(["B", "B"])))[0]) == 0


@pytest.mark.parametrize("metres", [3.0, 5.0, 60.0])
def test_maps_that_do_not_fit_are_refused(metres: float) -> None:
    a = drawn(12, np.random.default_rng(6))
    with pytest.raises(InputError, match=r"the maps do not fit each other: .*(are the same|as far apart)"):
        join(a, replace(a, position_m=a.position_m + np.array([0.0, metres, 0.0])))


def test_maps_of_other_streets_are_kept_side_by_side() -> None:
    a = drawn(4, np.random.default_rng(8))
    b = replace(a, position_m=a.position_m + 500.0, seen_m=a.seen_m + 500.0, missed=a.missed + 1)
    found = join(a, b)
    assert (found.same, found.apart, len(found.map)) == (0, 0, 8)
    np.testing.assert_allclose(found.map.covariance_m2[:4], a.covariance_m2 / found.weight, atol=1e-5)
    assert found.map.missed.tolist() == [0] * 4 + [1] * 4


def test_what_both_have_is_seen_from_where_either_saw_it() -> None:
    a = map_at([[100.0, 0.0, 5.0]], [np.eye(3)])
    b = replace(a, seen_m=a.seen_m + 10.0, hits=a.hits + 5, missed=a.missed + 1)
    for both in (join(a, b).map, join(b, a).map):
        assert both.seen_m.tolist() == [[[0.0, 0.0], [60.0, 14.0]]]
        assert (both.hits.tolist(), both.missed.tolist()) == ([14], [0])


def test_exact_vts_may_be_joined() -> None:
    a = map_at([[100.0, 0.0, 5.0]], np.zeros((1, 3, 3)))
    least_m2 = 2.0 * EXACT_M2  # nothing is more exact than that
    np.testing.assert_allclose(join(a, a).map.covariance_m2, [least_m2 * np.eye(3)], atol=least_m2)
