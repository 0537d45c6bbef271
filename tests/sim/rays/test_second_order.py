"""Double reflections: corners and canyons by hand, reciprocity, and a slow tracer as a judge."""

import numpy as np
import pytest

from cellslam.sim.city import ProceduralCityConfig, build_city
from cellslam.sim.rays import trace
from cellslam.sim.rays.scene import prepare

TX = np.array([0.0, 0.0, 10.0])


@pytest.fixture(scope="module")
def yard(scenes):
    """Return four houses round a yard."""
    return scenes.city_of(
        scenes.box((-40, 20, 0), (-5, 30, 15)),
        scenes.box((3, 22, 0), (35, 28, 9)),
        scenes.box((-20, -60, 0), (10, -40, 25)),
        scenes.box((45, -30, 0), (60, 25, 18)),
    )


def test_a_corner_mirrors_the_transmitter_through_its_edge(scenes):
    city = scenes.city_of(
        scenes.rectangle((-50, 20, 0), (90, 0, 0), (0, 0, 30)), scenes.rectangle((40, -50, 0), (0, 70, 0), (0, 0, 30))
    )
    paths = trace(city, [TX], [[10.0, -20.0, 2.0]], max_order=2)
    assert paths.order.tolist() == [0, 1, 1, 2]
    np.testing.assert_allclose(paths.vt_position_m[3], [80.0, 40.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(paths.length_m[3], np.sqrt(70**2 + 60**2 + 8**2), atol=1e-12)
    # From (10, -20) towards (80, 40): the wall y = 20 at x = 56 lies behind x = 40, which comes first.
    np.testing.assert_allclose(paths.points_m[3, 1, :2], [40.0, -20.0 + 60.0 * 30.0 / 70.0], atol=1e-12)
    np.testing.assert_allclose(paths.points_m[3, 0, 1], 20.0, atol=1e-12)


def test_a_wall_that_passes_through_the_plane_of_the_other_counts(scenes):
    city = scenes.city_of(
        scenes.rectangle((-50, 20, 0), (90, 0, 0), (0, 0, 30)), scenes.rectangle((40, -50, 0), (0, 250, 0), (0, 0, 30))
    )
    assert trace(city, [TX], [[10.0, -20.0, 2.0]], max_order=2).order.tolist() == [0, 1, 1, 2]


@pytest.mark.parametrize("leg", [0, 1, 2], ids=["transmitter", "middle", "receiver"])
def test_an_obstacle_blocks_any_leg(scenes, leg):
    receiver = np.array([10.0, -20.0, 2.0])
    walls = (
        scenes.rectangle((-50, 20, 0), (90, 0, 0), (0, 0, 30)),
        scenes.rectangle((40, -50, 0), (0, 70, 0), (0, 0, 30)),
    )
    points = trace(scenes.city_of(*walls), [TX], [receiver], max_order=2).points_m[3]
    corners = np.array([TX, points[0], points[1], receiver])
    middle = corners[leg : leg + 2].mean(axis=0)
    screen = scenes.rectangle(middle - [0.5, 0.5, 0.5], (1, 1, 0), (0, 0, 1))
    crossed = scenes.rectangle(middle - [0.5, -0.5, 0.5], (1, -1, 0), (0, 0, 1))
    blocked = trace(scenes.city_of(*walls, screen, crossed), [TX], [receiver], max_order=2)
    assert 80.0 not in np.round(blocked.vt_position_m[blocked.order == 2, 0], 6)


def test_a_canyon_bounces_to_and_fro(scenes):
    city = scenes.city_of(
        scenes.rectangle((-99, 20, 0), (198, 0, 0), (0, 0, 50)),
        scenes.rectangle((-99, -10, 0), (198, 0, 0), (0, 0, 50)),
    )
    paths = trace(city, [TX], [[30.0, 5.0, 2.0]], max_order=2)
    # Mirrors at 20 and -10 in either order move the transmitter by twice their distance.
    np.testing.assert_allclose(np.sort(paths.vt_position_m[paths.order == 2, 1]), [-60.0, 60.0], atol=1e-12)


@pytest.mark.slow
def test_agrees_with_float64_brute_force(scenes, yard):
    rng = np.random.default_rng(4)
    receivers = np.column_stack([rng.uniform(-40, 42, 25), rng.uniform(-38, 18, 25), rng.uniform(1, 12, 25)])
    paths = trace(yard, [TX], receivers, max_order=2)
    assert (paths.order == 2).sum() > 20
    for r, receiver in enumerate(receivers):
        got = np.sort(np.round(paths.length_m[(paths.receiver == r) & (paths.order == 2)], 6))
        assert got.tolist() == scenes.brute_force_second(yard, TX, receiver), r


def test_reciprocity_and_geometry(yard):
    rng = np.random.default_rng(8)
    receivers = np.column_stack([rng.uniform(-60, 70, 150), rng.uniform(-70, 50, 150), rng.uniform(1, 30, 150)])
    there, back = trace(yard, [TX], receivers, max_order=2), trace(yard, receivers, [TX], max_order=2)
    there, back = there.take(there.order == 2), back.take(back.order == 2)
    assert len(there) > 60
    a = there.take(np.lexsort((there.facets[:, 1], there.facets[:, 0], there.receiver)))
    b = back.take(np.lexsort((back.facets[:, 0], back.facets[:, 1], back.transmitter)))
    np.testing.assert_array_equal(a.facets, b.facets[:, ::-1])
    np.testing.assert_allclose(a.points_m, b.points_m[:, ::-1], atol=1e-7)
    np.testing.assert_allclose(a.gain, np.swapaxes(b.gain, 1, 2), atol=1e-14)
    rx = receivers[a.receiver]
    legs = [TX - a.points_m[:, 0], a.points_m[:, 0] - a.points_m[:, 1], a.points_m[:, 1] - rx]
    np.testing.assert_allclose(a.length_m, sum(np.linalg.norm(leg, axis=1) for leg in legs), atol=1e-9)


def test_lower_orders_are_the_same(yard):
    receivers = np.column_stack([np.linspace(-30, 40, 50), np.full(50, 5.0), np.full(50, 2.0)])
    one, two = trace(yard, [TX], receivers), trace(yard, [TX], receivers, max_order=2)
    assert len(two) > len(one) > 0
    np.testing.assert_array_equal(two.take(two.order < 2).length_m, one.length_m)
    np.testing.assert_array_equal(two.take(two.order < 2).gain, one.gain)


def test_the_transmitter_lights_what_it_faces(scenes):
    scene = prepare(scenes.city_of(scenes.box((10, -5, 0), (20, 5, 15)), scenes.box((30, -4, 0), (40, 4, 12))))
    lit = scene.lit_facets(TX - scene.origin_m, scene.reflects)
    # The near house's front, and what touches that; its back and the whole other house are hidden.
    assert len(lit) == 4
    assert set(scene.city.facets.building[lit]) == {0}
    assert -1.0 in np.round(scene.table[lit, 0], 9) * np.sign(scene.table[lit, 3])


def test_nothing_that_is_seen_counts_as_hidden():
    city = build_city(ProceduralCityConfig(extent_m=240.0, block_size_m=80.0), np.random.default_rng(3))
    scene = prepare(city)
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), 40)
    for site in (np.array([5.0, 60.0, 25.0]), np.array([-70.0, -20.0, 60.0]), np.array([10.0, 0.0, 4.0])):
        lit = scene.lit_facets(site - scene.origin_m, scene.reflects)
        points = np.einsum("wc,kci->kwi", weights, scene.corners).reshape(-1, 3)
        facet = np.repeat(city.triangle_facet, len(weights))
        source = np.broadcast_to(site - scene.origin_m, points.shape)
        away = np.linalg.norm(points - source, axis=1)
        seen = scene.unobstructed(source, points, np.maximum(1.0 - 0.01 / away, 0.0))
        found = set(facet[seen & scene.reflects[facet]])
        assert found
        assert found <= set(lit)
        assert len(lit) < np.count_nonzero(scene.reflects)
