"""CityJSON: scale and translate, parts of a building, holes, the most detailed geometry; bad files are refused."""

import copy
import json

import numpy as np
import pytest
import shapely

from cellslam.sim.city import MeshCityConfig, build_city
from cellslam.sim.errors import InputError

# A house of 10 x 8 x 6 m round a yard of 4 x 2 m, in millimetres from (85000, 446000, 3).
OUTER, INNER = [(0, 0), (10, 0), (10, 8), (0, 8)], [(3, 3), (3, 5), (7, 5), (7, 3)]
VERTICES = [[x * 1000, y * 1000, z * 1000] for z in (0, 6) for x, y in OUTER + INNER]
WALLS = [[[a + i, a + (i + 1) % 4, a + (i + 1) % 4 + 8, a + i + 8]] for a in (0, 4) for i in range(4)]
ROOF, FLOOR = [[8, 9, 10, 11], [12, 13, 14, 15]], [[3, 2, 1, 0], [7, 6, 5, 4]]
HOUSE = {
    "type": "CityJSON",
    "version": "2.0",
    "transform": {"scale": [0.001, 0.001, 0.001], "translate": [85000.0, 446000.0, 3.0]},
    "CityObjects": {
        "house": {"type": "Building", "children": ["part"]},
        "part": {
            "type": "BuildingPart",
            "parents": ["house"],
            "geometry": [
                {"type": "MultiSurface", "lod": "0", "boundaries": [FLOOR]},
                {"type": "Solid", "lod": "2.2", "boundaries": [[*WALLS, ROOF, FLOOR]]},
            ],
        },
    },
    "vertices": VERTICES,
}


def load(path):
    return build_city(MeshCityConfig(path=str(path)), np.random.default_rng(0))


HEAD = {**HOUSE, "CityObjects": {}, "vertices": []}
FEATURE = {"type": "CityJSONFeature", "CityObjects": HOUSE["CityObjects"], "vertices": VERTICES}


@pytest.mark.parametrize("documents", [[HOUSE], [HEAD, FEATURE]], ids=["file", "sequence of features"])
def test_a_house_with_a_yard(documents, tmp_path):
    path = tmp_path / f"house.city.json{'l' if len(documents) > 1 else ''}"
    path.write_text("\n".join(json.dumps(document) for document in documents))
    city = load(path)
    assert len(city.facets) == 10
    np.testing.assert_allclose(city.bounds, [[85000, 446000, 3], [85010, 446008, 9]], atol=1e-9)
    plan = shapely.box(85000, 446000, 85010, 446008) - shapely.box(85003, 446003, 85007, 446005)
    assert city.footprints[0].symmetric_difference(plan).area < 1e-3
    assert city.heights_m.tolist() == [6.0]
    level = np.abs(city.facets.normal[:, 2]) > 0.9
    np.testing.assert_allclose(city.facets.area_m2[level], 72.0)
    # Walls look away from the house, into the street or the yard.
    for facet in np.flatnonzero(~level):
        corners = city.vertices[city.triangles[city.triangle_facet == facet]]
        outside = corners.mean(axis=(0, 1)) + 0.01 * city.facets.normal[facet]
        assert not plan.contains(shapely.Point(outside[:2]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("type"), "is no CityJSON"),
        (lambda d: d.pop("vertices"), "does not keep to its specification"),
        (lambda d: d["vertices"].pop(), "vertex 15 of 15"),
        (lambda d: d["CityObjects"].clear(), "no triangles"),
        (lambda d: d["transform"].update(scale=[0.001, float("nan"), 0.001]), "not finite"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, change, message):
    document = copy.deepcopy(HOUSE)
    change(document)
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=message) as error:
        load(path)
    assert "\n" not in str(error.value)


def test_triangles_are_taken_and_rings_of_two_corners_left(tmp_path):
    document = copy.deepcopy(HOUSE)
    boundaries = document["CityObjects"]["part"]["geometry"][1]["boundaries"][0]
    wall = boundaries[0][0]  # as two triangles
    boundaries[:1] = [[wall[:3]], [[wall[0], *wall[2:]]], [wall[:2]]]
    (tmp_path / "house.city.json").write_text(json.dumps(document))
    assert len(load(tmp_path / "house.city.json").facets) == 10
