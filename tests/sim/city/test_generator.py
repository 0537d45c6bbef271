"""The generated city: reproducible, connected streets, houses apart from streets and from each other."""

import networkx as nx
import numpy as np
import pytest
import shapely

from cellslam.sim.city import ProceduralCityConfig, build_city
from cellslam.sim.city.inside import enclosing

KINDS = {
    "default": {},
    "open": {"open_share": 1.0, "square_share": 0.0, "height_min_m": 10.0, "height_max_m": 25.0, "tower_share": 0.0},
    "canyon": {"open_share": 0.0, "block_size_m": 80.0, "gap_share": 0.0, "square_share": 0.0},
}


@pytest.fixture(scope="module", params=KINDS, ids=KINDS.keys())
def city(request):
    return build_city(ProceduralCityConfig(extent_m=400.0, **KINDS[request.param]), np.random.default_rng(7))


def test_same_seed_same_city():
    config = ProceduralCityConfig(extent_m=300.0)
    a, b, c = (build_city(config, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.triangles, b.triangles)
    assert a.vertices.shape != c.vertices.shape or not np.array_equal(a.vertices, c.vertices)


def test_streets_are_connected_without_dead_ends(city):
    graph = nx.Graph((tuple(line[0]), tuple(line[-1])) for line in city.streets)
    assert nx.is_connected(graph)
    assert min(dict(graph.degree).values()) >= 2
    assert all(shapely.LineString(line).is_simple for line in city.streets)


def test_houses_leave_the_streets_free(city):
    houses = shapely.union_all(city.footprints)
    streets = shapely.MultiLineString(list(city.streets))
    assert houses.distance(streets) > 5.0
    total = sum(p.area for p in city.footprints)
    assert total - houses.area < 1e-4 * total  # corners are rounded to a decimetre
    assert all(p.is_valid and p.area > 50.0 for p in city.footprints)


def test_every_wall_and_roof_is_one_facet(city):
    walls = sum(len(ring.coords) - 1 for p in city.footprints for ring in (p.exterior, *p.interiors))
    # Corners of a fraction of a degree merge: a few walls fewer, not one more.
    assert 0.99 * walls <= len(city.facets) - len(city.footprints) - 1 <= walls
    assert (city.facets.building == -1).sum() == 1
    vertical = np.abs(city.facets.normal[:, 2]) < 1e-9
    assert vertical.sum() == len(city.facets) - len(city.footprints) - 1
    assert city.heights_m.min() >= 8.0 and (city.heights_m <= 35.0).mean() > 0.9
    area = sum(p.length * h for p, h in zip(city.footprints, city.heights_m, strict=True))
    assert city.facets.area_m2[vertical].sum() == pytest.approx(area, rel=1e-9)


TINY = {"extent_m": 100, "block_size_m": 50, "street_width_m": 30, "open_share": 1.0, "open_coverage": 0.02}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"height_min_m": 30.0, "height_max_m": 20.0}, "below height_min_m"),
        ({"street_width_m": 60.0, "block_size_m": 80.0}, "leaves no block"),
        ({"material_weights": {}}, "at least one material"),
        ({"extent_m": 200, "material_weights": {"brik": 1.0}}, "unknown material 'brik'; did you mean 'brick'"),
        (TINY, "no building"),
    ],
)
def test_impossible_cities_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        build_city(ProceduralCityConfig(**values), np.random.default_rng(0))


def test_details_are_added_to_the_same_city():
    plain = ProceduralCityConfig(extent_m=300.0, block_size_m=100.0)
    rich = plain.model_copy(update={"bay_share": 1.0, "shop_share": 0.5, "pole_spacing_m": 40.0})
    a, b = (build_city(c, np.random.default_rng(4)) for c in (plain, rich))
    houses = len(a.footprints)
    np.testing.assert_array_equal(b.heights_m[:houses], a.heights_m)
    grown = np.array([with_.area - without.area for with_, without in zip(b.footprints, a.footprints, strict=False)])
    assert (grown >= -0.01).all()
    assert np.mean(grown > 1.0) > 0.5
    poles = b.footprints[houses:]
    assert len(poles) > 20
    assert all(pole.area < 0.1 for pole in poles)
    assert (enclosing(b, [(*p.centroid.coords[0], 1.0) for p in poles]) >= houses).all()
    assert {"glass", "metal"} <= {b.materials[m].name for m in np.unique(b.facets.material)}
