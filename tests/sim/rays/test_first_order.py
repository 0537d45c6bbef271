"""Lines of sight and single reflections: scenes worked by hand, properties, and a slow tracer as a judge."""

from dataclasses import replace

import numpy as np
import pytest

from cellslam.sim.city import ProceduralCityConfig, build_city
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
    receivers = points[small_city.buildings_at(points) < 0]
    return np.array([[10.3, -20.7, 31.0], [-61.2, 43.1, 18.0]]), receivers


def test_one_wall_by_hand(scenes):
    # Wall y = 20: the image of (0, 0, 10) is (0, 40, 10), and the point halves the way to (30, 0, 2).
    city = scenes.city_of(scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30)))
    paths = trace(city, [TX], [[30.0, 0.0, 2.0]])
    assert paths.order.tolist() == [0, 1]
    np.testing.assert_allclose(paths.vt_position_m, [TX, [0.0, 40.0, 10.0]], atol=1e-12)
    np.testing.assert_allclose(paths.length_m, [np.hypot(30, 8), np.sqrt(30**2 + 40**2 + 8**2)], atol=1e-12)
    np.testing.assert_allclose(paths.points_m[1, 0], [15.0, 20.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(paths.azimuth_rad, [np.pi, np.arctan2(40, -30)], atol=1e-12)
    np.testing.assert_allclose(paths.elevation_rad, [np.arctan2(8, 30), np.arctan2(8, 50)], atol=1e-12)
    np.testing.assert_allclose(paths.departure_azimuth_rad, [0.0, np.arctan2(20, 15)], atol=1e-12)
    np.testing.assert_allclose(paths.departure_elevation_rad, [-np.arctan2(8, 30), -np.arctan2(4, 25)], atol=1e-12)
    assert np.isnan(paths.points_m[0]).all()
    assert np.isnan(paths.points_m[1, 1]).all()


def test_a_corner_gives_one_path_per_wall(scenes):
    city = scenes.city_of(
        scenes.rectangle((-50, 20, 0), (90, 0, 0), (0, 0, 30)), scenes.rectangle((40, -50, 0), (0, 70, 0), (0, 0, 30))
    )
    paths = trace(city, [TX], [[30.0, 0.0, 2.0]])
    np.testing.assert_allclose(paths.vt_position_m[1:], [[0, 40, 10], [80, 0, 10]], atol=1e-12)


@pytest.mark.parametrize("at", [0.2, 0.8], ids=["transmitter leg", "receiver leg"])
def test_an_obstacle_blocks_either_leg(scenes, at):
    receiver = np.array([30.0, 0.0, 2.0])
    wall = scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30))
    middle = TX + (np.array([30.0, 40.0, 2.0]) - TX) * at
    middle[1] = min(middle[1], 40.0 - middle[1])
    screen = scenes.rectangle(middle - [1, 0, 1], (2, 0, 0), (0, 0, 2))
    assert trace(scenes.city_of(wall), [TX], [receiver]).order.tolist() == [0, 1]
    assert trace(scenes.city_of(wall, screen), [TX], [receiver]).order.tolist() == [0]


def test_a_vt_ends_where_its_facet_ends(scenes):
    # Specular point x_rx / 2: the wall ends at x = 20, so the VT ends at x_rx = 40; a millimetre tells.
    city = scenes.city_of(scenes.rectangle((-50, 20, 0), (70, 0, 0), (0, 0, 30)))
    x = np.array([39.0, 39.999, 40.001, 41.0])
    paths = trace(city, [TX], np.column_stack([x, 0 * x, 0 * x + 10.0]))
    assert paths.receiver[paths.order == 1].tolist() == [0, 1]
    # The wall's top hides the point too: its height is half way between 10 m and the receiver's.
    top = trace(city, [TX], [[10.0, 0.0, 49.9], [10.0, 0.0, 50.1]])
    assert top.receiver[top.order == 1].tolist() == [0]


def test_receivers_behind_the_wall_get_nothing(scenes):
    city = scenes.city_of(scenes.rectangle((-50, 20, -50), (100, 0, 0), (0, 0, 100)))
    assert len(trace(city, [TX], [[0.0, 30.0, 5.0], [10.0, 50.0, 8.0]])) == 0


@pytest.mark.slow
def test_agrees_with_float64_brute_force(scenes, small_city, places):
    transmitters, receivers = places
    paths = trace(small_city, transmitters, receivers, ground_reflection=True)
    for t, transmitter in enumerate(transmitters):
        for r, receiver in enumerate(receivers[:25]):
            mine = (paths.receiver == r) & (paths.transmitter == t)
            got = sorted(zip(paths.order[mine].tolist(), np.round(paths.length_m[mine], 6).tolist(), strict=True))
            assert got == scenes.brute_force(small_city, transmitter, receiver), (t, r)
    assert (paths.order == 1).sum() > 100


def test_reciprocity(small_city, places):
    transmitters, receivers = places
    there = trace(small_city, transmitters, receivers)
    back = trace(small_city, receivers, transmitters)
    forward = np.lexsort((there.facets[:, 0], there.transmitter, there.receiver))
    reverse = np.lexsort((back.facets[:, 0], back.receiver, back.transmitter))
    a, b = there.take(forward), back.take(reverse)
    np.testing.assert_array_equal(a.facets, b.facets)
    np.testing.assert_allclose(a.length_m, b.length_m, atol=1e-9)
    np.testing.assert_allclose(a.points_m, b.points_m, atol=1e-7)
    np.testing.assert_allclose(a.azimuth_rad, b.departure_azimuth_rad, atol=1e-9)
    np.testing.assert_allclose(a.gain, np.swapaxes(b.gain, 1, 2), atol=1e-14)


def test_geometry_of_every_path(small_city, places):
    transmitters, receivers = places
    p = trace(small_city, transmitters, receivers)
    p = p.take(p.order == 1)
    tx, rx, point = transmitters[p.transmitter], receivers[p.receiver], p.points_m[:, 0]
    legs = np.linalg.norm(point - tx, axis=1) + np.linalg.norm(point - rx, axis=1)
    np.testing.assert_allclose(p.length_m, legs, atol=1e-9)
    np.testing.assert_allclose(p.length_m, np.linalg.norm(p.vt_position_m - rx, axis=1), atol=1e-12)
    normal = small_city.facets.normal[p.facets[:, 0]]
    cos_in = np.einsum("pi,pi->p", tx - point, normal) / np.linalg.norm(tx - point, axis=1)
    cos_out = np.einsum("pi,pi->p", rx - point, normal) / np.linalg.norm(rx - point, axis=1)
    np.testing.assert_allclose(cos_in, cos_out, atol=1e-9)
    # Mirroring the image again leads back to the transmitter.
    offset = small_city.facets.offset[p.facets[:, 0]]
    distance = np.einsum("pi,pi->p", p.vt_position_m, normal) - offset
    np.testing.assert_allclose(p.vt_position_m - 2 * distance[:, None] * normal, tx, atol=1e-9)


def test_flipped_and_split_facets_change_nothing(scenes):
    rng = np.random.default_rng(2)
    receivers = np.column_stack(
        [rng.uniform(-60, 60, (400, 1)), rng.uniform(-30, 15, (400, 1)), rng.uniform(1, 20, (400, 1))]
    )
    boxes = [
        scenes.box((-40, 20, 0), (-5, 30, 15)),
        scenes.box((3, 22, 0), (35, 28, 9)),
        scenes.box((-20, -60, 0), (10, -40, 25)),
    ]
    plain = trace(scenes.city_of(*boxes), [TX], receivers)
    flipped = trace(scenes.city_of(*[(v, t[:, ::-1]) for v, t in boxes]), [TX], receivers)
    one_flipped = trace(scenes.city_of(*[(v, np.r_[t[:1, ::-1], t[1:]]) for v, t in boxes]), [TX], receivers)
    split = trace(scenes.city_of(*[_split(v, t) for v, t in boxes]), [TX], receivers)
    assert (plain.order == 1).sum() > 100
    for other in (flipped, one_flipped, split):
        np.testing.assert_array_equal(other.receiver, plain.receiver)
        np.testing.assert_allclose(other.length_m, plain.length_m, atol=1e-9)
        np.testing.assert_allclose(other.gain, plain.gain, atol=1e-12)


def _split(vertices, triangles):
    """Cut every triangle into three at its centroid."""
    centre = len(vertices) + np.arange(len(triangles))
    pieces = [np.column_stack([triangles[:, i], triangles[:, (i + 1) % 3], centre]) for i in range(3)]
    return np.concatenate([vertices, vertices[triangles].mean(axis=1)]), np.concatenate(pieces)


def test_geometry_that_is_there_twice_counts_once(scenes):
    wall = scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30))
    receivers = np.column_stack([np.linspace(-40, 40, 50), np.zeros(50), np.full(50, 2.0)])
    once, twice = (
        trace(scenes.city_of(wall), [TX], receivers),
        trace(scenes.city_of(wall, wall, wall), [TX], receivers),
    )
    np.testing.assert_array_equal(once.receiver, twice.receiver)
    np.testing.assert_allclose(once.length_m, twice.length_m, atol=1e-12)


def test_coordinates_far_from_the_origin_cost_nothing(small_city, places):
    transmitters, receivers = places
    shift = np.array([691_000.0, 5_334_000.0, 520.0])
    table = small_city.facets
    far = replace(
        small_city,
        vertices=small_city.vertices + shift,
        facets=replace(table, offset=table.offset + table.normal @ shift),
    )
    near, away = (trace(small_city, transmitters, receivers), trace(far, transmitters + shift, receivers + shift))
    np.testing.assert_array_equal(near.facets, away.facets)
    np.testing.assert_allclose(near.length_m, away.length_m, atol=1e-7)
    np.testing.assert_allclose(near.azimuth_rad, away.azimuth_rad, atol=1e-8)
    np.testing.assert_allclose(near.vt_position_m + shift, away.vt_position_m, atol=1e-6)


def test_leaving_hidden_facets_out_changes_nothing(scenes, small_city, places, monkeypatch):
    transmitters, receivers = places
    plain = trace(small_city, transmitters, receivers)
    monkeypatch.setattr("cellslam.sim.rays.tracing.LIT_FROM", 0)
    quick = trace(small_city, transmitters, receivers)
    np.testing.assert_array_equal(quick.facets, plain.facets)
    np.testing.assert_array_equal(quick.length_m, plain.length_m)
    # A wall with a window hides all corners of the wall behind it, but not its middle.
    outer = np.array([[10, -10, 0], [10, 10, 0], [10, 10, 20], [10, -10, 20]], float)
    inner = np.array([[10, -1, 9], [10, 1, 9], [10, 1, 11], [10, -1, 11]], float)
    quads = [[i, (i + 1) % 4, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    frame = np.concatenate([outer, inner]), np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])
    city = scenes.city_of(frame, scenes.rectangle((20, -6, 4), (0, 12, 0), (0, 0, 12)))
    assert len(city.facets) == 2
    assert trace(city, [TX], [[15.0, 0.2, 10.0]]).order.tolist() == [0, 1]


def test_block_size_and_chunks_do_not_matter(small_city, places, monkeypatch):
    transmitters, receivers = places
    line = np.repeat(receivers, 3, axis=0) + np.random.default_rng(0).normal(0, 0.5, (3 * len(receivers), 3))
    whole = trace(small_city, transmitters, line)
    monkeypatch.setattr("cellslam.sim.rays.first_order.BLOCKS", np.array([3, 1]))
    monkeypatch.setattr("cellslam.sim.rays.tracing.CHUNK", 37)
    pieces = trace(small_city, transmitters, line)
    np.testing.assert_array_equal(whole.facets, pieces.facets)
    np.testing.assert_array_equal(whole.receiver, pieces.receiver)
    np.testing.assert_array_equal(whole.length_m, pieces.length_m)


def test_sorted_and_ground_is_optional(small_city, places):
    transmitters, receivers = places
    p = trace(small_city, transmitters, receivers)
    key = np.lexsort((p.facets[:, 0], p.order, p.transmitter, p.receiver))
    np.testing.assert_array_equal(key, np.arange(len(p)))
    assert (small_city.facets.building[p.facets[p.order == 1, 0]] >= 0).all()
    with_ground = trace(small_city, transmitters, receivers, ground_reflection=True)
    below = with_ground.vt_position_m[:, 2] < 0
    assert below.sum() > 20
    np.testing.assert_array_equal(with_ground.take(~below).facets, p.facets)


def test_no_receivers_and_bad_requests(scenes):
    scene = prepare(scenes.city_of(scenes.rectangle((-50, 20, 0), (100, 0, 0), (0, 0, 30))))
    assert len(trace(scene, [TX], np.empty((0, 3)))) == 0
    assert len(trace(scene, np.empty((0, 3)), [TX])) == 0
    assert trace(scene, [TX], [[30.0, 0.0, 2.0]], max_order=0).order.tolist() == [0]
    with pytest.raises(InputError, match=r"row 1.*not finite"):
        trace(scene, [TX], [TX, [np.nan, 0.0, 0.0]])
    with pytest.raises(InputError, match="expected \\(n, 3\\)"):
        trace(scene, TX, [TX])
    with pytest.raises(InputError, match="max_order 7"):
        trace(scene, [TX], [TX], max_order=7)
    with pytest.raises(InputError, match="carrier_hz"):
        trace(scene, [TX], [TX], carrier_hz=2.66)
