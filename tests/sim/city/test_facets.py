"""Triangles that touch and lie in one plane become one facet, and nothing else does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellslam.sim.city.city import Tolerances
from cellslam.sim.city.facets import merge_facets


def grid(n, size, height=lambda x, y: 0 * x):
    """Return a sheet of 2 n^2 triangles with its own three vertices each."""
    line = np.linspace(0.0, size, n + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    soup = np.concatenate(
        [np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], axis=2).reshape(-1, 3, 3)]
    )
    return soup.reshape(-1, 3), np.arange(3 * len(soup)).reshape(-1, 3)


def merged(vertices, triangles, **tolerances):
    zero = np.zeros(len(triangles), np.int64)
    return merge_facets(vertices, triangles, zero, zero, zero, Tolerances(**tolerances))


@pytest.mark.parametrize(
    ("sag_m", "tolerances", "count"),
    [
        (0.0019, {}, 1), (0.0021, {}, 2), (0.05, {}, 2), (0.05, {"plane_m": 0.1}, 1),
        (0.05, {"plane_m": 0.1, "angle_deg": 0.1}, 2),
    ],
)  # fmt: skip
def test_tolerances_decide_over_a_bent_wall(sag_m, tolerances, count):
    vertices, triangles = grid(1, 10.0)
    # Lift the corner that only the second triangle has.
    vertices[vertices[:, 1] - vertices[:, 0] > 9.0, 2] = sag_m
    _, facets = merged(vertices, triangles, **tolerances)
    assert len(facets) == count
    assert facets.planarity_m.max() <= tolerances.get("plane_m", 0.002)


def test_a_gentle_curve_does_not_become_one_facet():
    """Neighbour after neighbour within a degree must not creep round a bend."""
    _, facets = merged(*grid(40, 40.0, lambda x, y: 1e-3 * x**2))
    assert len(facets) > 3
    assert facets.planarity_m.max() < 0.004


def test_planes_that_do_not_touch_stay_apart_and_close_ones_weld():
    v, t = grid(1, 10.0)
    apart = np.concatenate([v, v + np.array([10.001, 0, 0])])
    touching = np.concatenate([v, v + np.array([10.00005, 0, 0])])
    both = np.concatenate([t, t + len(v)])
    assert len(merged(apart, both)[1]) == 2
    assert len(merged(touching, both)[1]) == 1


def test_copies_flips_and_slivers_do_no_harm():
    v, t = grid(2, 10.0)
    sliver = np.array([[0, 0, 0], [5, 0, 0], [10, 0, 0]], float)
    vertices = np.concatenate([v, v, sliver])
    triangles = np.concatenate([t, t[:, ::-1] + len(v), [[2 * len(v), 2 * len(v) + 1, 2 * len(v) + 2]]])
    label, facets = merged(vertices, triangles)
    assert len(set(label[:-1])) == 1
    assert np.isfinite(facets.normal).all()
    assert (facets.area_m2 > 0).sum() == 1


def test_materials_and_objects_separate():
    v, t = grid(2, 10.0)
    zero = np.zeros(len(t), np.int64)
    material = np.r_[0, np.ones(len(t) - 1, np.int64)]
    assert len(merge_facets(v, t, zero, material, zero, Tolerances())[1]) == 2


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_moving_a_city_moves_its_facets(seed):
    rng = np.random.default_rng(seed)
    v, t = grid(4, 12.0, lambda x, y: np.where(x > 6, 0.3 * (x - 6), 0.0))
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    label, facets = merged(v, t)
    turned, moved = merged(v @ q.T + rng.uniform(-1e5, 1e5, 3), t)
    assert len(facets) == len(moved) == 2
    np.testing.assert_array_equal(label, turned)
    for area_m2 in (facets.area_m2, moved.area_m2):
        np.testing.assert_allclose(np.sort(area_m2), [72.0, 72.0 * np.hypot(1.0, 0.3)], rtol=1e-6)
    np.testing.assert_allclose(np.abs(np.einsum("fi,fi->f", facets.normal @ q.T, moved.normal)), 1.0, atol=1e-9)
