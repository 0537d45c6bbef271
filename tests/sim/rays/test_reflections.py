"""Lines of sight, single and double reflections: scenes worked by hand, properties, and a slow tracer as a judge."""

from itertools import pairwise

import numpy as np
import pytest

from cellslam.sim.city import ProceduralCityConfig, build_city
from cellslam.sim.city.inside import OUTSIDE, enclosing
from cellslam.sim.errors import InputError
from cellslam.sim.rays import prepare, trace

TX = np.array([0.0, 0.0, 10.0])


@pytest.fixture(scope="module")
def small_city():
    config = ProceduralCityConfig(
        extent_m=240.0, block_size_m=80.0, open_share=0.6, height_min_m=6.0, height_max_m=22.0
    )
    return build_city(config, np.random.default_rng(5))


@pytest.fixture(scope="module")
def places(small_city):
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-120, 120, (300, 2)), rng.uniform(1.5, 3.0, 300)])
    receivers = points[enclosing(small_city, points) == OUTSIDE]
    return np.array([[10.3, -20.7, 31.0], [-61.2, 43.1, 18.0]]), receivers


@pytest.fixture(scope="module")
def yard(scenes):
    """Return four houses round a yard."""
    return scenes.city_of(
        scenes.box((-40, 20, 0), (-5, 30, 15)),
        scenes.box((3, 22, 0), (35, 28, 9)),
        scenes.box((-20, -60, 0), (10, -40, 25)),
        scenes.box((45, -30, 0), (60, 25, 18)),
    )


@pytest.fixture(scope="module")
def wall(scenes):
    return scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30))


def test_one_wall_by_hand(scenes, wall):
    # Wall y = 20: the image of (0, 0, 10) is (0, 40, 10), and the point halves the way to (30, 0, 2).
    paths = trace(scenes.city_of(wall), [TX], [[30.0, 0.0, 2.0]])
    assert paths.order.tolist() == [0, 1]
    np.testing.assert_allclose(paths.vt_position_m, [TX, [0.0, 40.0, 10.0]], atol=1e-12)
    np.testing.assert_allclose(paths.length_m, [np.hypot(30, 8), np.sqrt(30**2 + 40**2 + 8**2)], atol=1e-12)
    np.testing.assert_allclose(paths.points_m[1, 0], [15.0, 20.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(paths.azimuth_rad, [np.pi, np.arctan2(40, -30)], atol=1e-12)
    np.testing.assert_allclose(paths.elevation_rad, [np.arctan2(8, 30), np.arctan2(8, 50)], atol=1e-12)
    np.testing.assert_allclose(paths.departure_azimuth_rad, [0.0, np.arctan2(20, 15)], atol=1e-12)
    np.testing.assert_allclose(paths.departure_elevation_rad, [-np.arctan2(8, 30), -np.arctan2(4, 25)], atol=1e-12)
    assert np.isnan(paths.points_m[0]).all() and np.isnan(paths.points_m[1, 1]).all()


def test_a_corner_mirrors_the_transmitter_through_its_edge(scenes):
    walls = [scenes.rectangle(*w, (0, 0, 30)) for w in (((-50, 20, 0), (90, 0, 0)), ((40, -50, 0), (0, 70, 0)))]
    paths = trace(scenes.city_of(*walls), [TX], [[10.0, -20.0, 2.0]], max_order=2)
    assert paths.order.tolist() == [0, 1, 1, 2]
    np.testing.assert_allclose(paths.vt_position_m[1:], [[0, 40, 10], [80, 0, 10], [80, 40, 10]], atol=1e-12)
    np.testing.assert_allclose(paths.length_m[3], np.sqrt(70**2 + 60**2 + 8**2), atol=1e-12)
    # From (10, -20) towards (80, 40): the wall y = 20 at x = 56 lies behind x = 40, which comes first.
    np.testing.assert_allclose(paths.points_m[3, 1, :2], [40.0, -20.0 + 60.0 * 30.0 / 70.0], atol=1e-12)
    np.testing.assert_allclose(paths.points_m[3, 0, 1], 20.0, atol=1e-12)


def test_a_vt_ends_where_its_facet_ends(scenes):
    # Specular point x_rx / 2: the wall ends at x = 20, so the VT ends at x_rx = 40; a millimetre tells.
    city = scenes.city_of(scenes.rectangle((-50, 20, 0), (70, 0, 0), (0, 0, 30)))
    x = np.array([39.0, 39.999, 40.001, 41.0])
    paths = trace(city, [TX], np.column_stack([x, 0 * x, 0 * x + 10.0]))
    assert paths.receiver[paths.order == 1].tolist() == [0, 1]
    # The wall's top hides the point too: its height is half way between 10 m and the receiver's.
    top = trace(city, [TX], [[10.0, 0.0, 49.9], [10.0, 0.0, 50.1]])
    assert top.receiver[top.order == 1].tolist() == [0]


@pytest.mark.slow
def test_agrees_with_float64_brute_force(scenes, small_city, places, yard):
    rng = np.random.default_rng(4)
    around = np.column_stack([rng.uniform(-40, 42, 10), rng.uniform(-38, 18, 10), rng.uniform(1, 12, 10)])
    transmitters, receivers = places
    for city, sites, ends, order in ((small_city, transmitters, receivers[:10], 1), (yard, TX[None], around, 2)):
        paths = trace(city, sites, ends, order, ground_reflection=True)
        assert (paths.order == order).sum() > 5
        for t, transmitter in enumerate(sites):
            for r, receiver in enumerate(ends):
                mine = (paths.receiver == r) & (paths.transmitter == t)
                got = sorted(zip(paths.order[mine].tolist(), np.round(paths.length_m[mine], 6).tolist(), strict=True))
                assert got == scenes.brute_force(city, transmitter, receiver, order), (t, r)


def test_reciprocity_and_geometry(yard):
    rng = np.random.default_rng(8)
    receivers = np.column_stack([rng.uniform(-60, 70, 150), rng.uniform(-70, 50, 150), rng.uniform(1, 30, 150)])
    there, back = trace(yard, [TX], receivers, max_order=2), trace(yard, receivers, [TX], max_order=2)
    assert (there.order == 1).sum() > 100 and (there.order == 2).sum() > 60
    for order in (1, 2):
        a, b = there.take(there.order == order), back.take(back.order == order)
        a = a.take(np.lexsort((a.facets[:, order - 1], a.facets[:, 0], a.receiver)))
        b = b.take(np.lexsort((b.facets[:, 0], b.facets[:, order - 1], b.transmitter)))
        np.testing.assert_array_equal(a.facets[:, :order], b.facets[:, :order][:, ::-1])
        np.testing.assert_allclose(a.points_m[:, :order], b.points_m[:, :order][:, ::-1], atol=1e-7)
        np.testing.assert_allclose(a.azimuth_rad, b.departure_azimuth_rad, atol=1e-9)
        np.testing.assert_allclose(a.gain, np.swapaxes(b.gain, 1, 2), atol=1e-14)
        ends = [np.broadcast_to(TX, (len(a), 3)), *np.moveaxis(a.points_m[:, :order], 1, 0), receivers[a.receiver]]
        legs = sum(np.linalg.norm(end - start, axis=1) for start, end in pairwise(ends))
        np.testing.assert_allclose(a.length_m, legs, atol=1e-9)
    one = trace(yard, [TX], receivers)
    np.testing.assert_array_equal(there.take(there.order < 2).length_m, one.length_m)


def test_flipped_split_and_repeated_facets_change_nothing(scenes):
    rng = np.random.default_rng(2)
    receivers = np.column_stack([rng.uniform(-60, 60, 400), rng.uniform(-30, 15, 400), rng.uniform(1, 20, 400)])
    corners = ((-40, 20, 0), (-5, 30, 15)), ((3, 22, 0), (35, 28, 9)), ((-20, -60, 0), (10, -40, 25))
    boxes = [scenes.box(*pair) for pair in corners]
    plain = trace(scenes.city_of(*boxes), [TX], receivers)
    one_flipped = [(v, np.r_[t[:1, ::-1], t[1:]]) for v, t in boxes]
    assert (plain.order == 1).sum() > 100
    for meshes in (one_flipped, [_split(v, t) for v, t in boxes], boxes * 3):
        other = trace(scenes.city_of(*meshes), [TX], receivers)
        np.testing.assert_array_equal(other.receiver, plain.receiver)
        np.testing.assert_allclose(other.length_m, plain.length_m, atol=1e-9)
        np.testing.assert_allclose(other.gain, plain.gain, atol=1e-12)


def _split(vertices, triangles):
    """Cut every triangle into three at its centroid."""
    centre = len(vertices) + np.arange(len(triangles))
    pieces = [np.column_stack([triangles[:, i], triangles[:, (i + 1) % 3], centre]) for i in range(3)]
    return np.concatenate([vertices, vertices[triangles].mean(axis=1)]), np.concatenate(pieces)


def test_blocks_chunks_and_hidden_facets_do_not_matter(small_city, places, monkeypatch):
    transmitters, receivers = places
    line = np.repeat(receivers, 3, axis=0) + np.random.default_rng(0).normal(0, 0.5, (3 * len(receivers), 3))
    whole = trace(small_city, transmitters, line)
    monkeypatch.setattr("cellslam.sim.rays.first_order.BLOCKS", np.array([3, 1]))
    monkeypatch.setattr("cellslam.sim.rays.tracing.CHUNK", 37)
    monkeypatch.setattr("cellslam.sim.rays.tracing.ILLUMINATED_FROM", 0)
    pieces = trace(small_city, transmitters, line)
    np.testing.assert_array_equal(whole.facets, pieces.facets)
    np.testing.assert_array_equal(whole.receiver, pieces.receiver)
    np.testing.assert_array_equal(whole.length_m, pieces.length_m)
    with_ground = trace(small_city, transmitters, line, ground_reflection=True)
    below = with_ground.vt_position_m[:, 2] < 0
    assert below.sum() > 20
    np.testing.assert_array_equal(with_ground.take(~below).facets, whole.facets)


def test_a_wall_with_a_window_hides_corners_but_not_what_is_between(scenes, monkeypatch):
    monkeypatch.setattr("cellslam.sim.rays.tracing.ILLUMINATED_FROM", 0)
    outer = np.array([[10, -10, 0], [10, 10, 0], [10, 10, 20], [10, -10, 20]], float)
    inner = np.array([[10, -1, 9], [10, 1, 9], [10, 1, 11], [10, -1, 11]], float)
    quads = [[i, (i + 1) % 4, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    frame = np.concatenate([outer, inner]), np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])
    city = scenes.city_of(frame, scenes.rectangle((20, -6, 4), (0, 12, 0), (0, 0, 12)))
    assert len(city.facets) == 2
    assert trace(city, [TX], [[15.0, 0.2, 10.0]]).order.tolist() == [0, 1]


def test_no_receivers_and_bad_requests(scenes, wall):
    scene = prepare(scenes.city_of(wall))
    assert len(trace(scene, [TX], np.empty((0, 3)))) == 0
    assert len(trace(scene, np.empty((0, 3)), [TX])) == 0
    assert len(trace(scene, [TX], [[0.0, 30.0, 5.0], [10.0, 50.0, 8.0]])) == 0  # behind the wall
    assert trace(scene, [TX], [[30.0, 0.0, 2.0]], max_order=0).order.tolist() == [0]
    for transmitters, receivers, keys, message in (
        ([TX], [TX, [np.nan, 0.0, 0.0]], {}, r"row 1.*not finite"),
        (TX, [TX], {}, r"expected \(n, 3\)"),
        ([TX], [TX], {"max_order": 7}, "max_order 7"),
        ([TX], [TX], {"carrier_hz": 2.66}, "carrier_hz"),
    ):
        with pytest.raises(InputError, match=message):
            trace(scene, transmitters, receivers, **keys)
