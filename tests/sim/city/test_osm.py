"""OpenStreetMap extracts: holes, heights, parts, streets, local metres; what is wrong is said in a line."""

import numpy as np
import pytest

from cellslam.sim.city import MeshCityConfig, build_city
from cellslam.sim.city.inside import OUTSIDE, enclosing

LON, LAT = 11.5, 48.1
# Metres per degree at this latitude: radii of curvature of WGS 84, by hand.
EAST_M, NORTH_M = 74475.0, 111197.0


class Extract:
    """Writes an .osm file from corners in metres."""

    def __init__(self):
        self.nodes, self.ways, self.relations = [], [], []

    def way(self, corners, closed=True, **tags):
        first = len(self.nodes) + 1
        self.nodes += [(LON + x / EAST_M, LAT + y / NORTH_M) for x, y in corners]
        refs = [*range(first, len(self.nodes) + 1), *([first] if closed else [])]
        self.ways.append((refs, {key.replace("building_", "building:"): value for key, value in tags.items()}))
        return len(self.ways)

    def write(self, path):
        lines = ['<osm version="0.6">']
        lines += [f'<node id="{i}" lat="{y:.9f}" lon="{x:.9f}" version="1"/>' for i, (x, y) in enumerate(self.nodes, 1)]
        for i, (refs, tags) in enumerate(self.ways, 1):
            inner = "".join(f'<nd ref="{r}"/>' for r in refs) + "".join(
                f'<tag k="{k}" v="{v}"/>' for k, v in tags.items()
            )
            lines.append(f'<way id="{i}" version="1">{inner}</way>')
        for i, (outer, inner, tags) in enumerate(self.relations, 1):
            members = f'<member type="way" ref="{outer}" role="outer"/><member type="way" ref="{inner}" role="inner"/>'
            tagged = "".join(f'<tag k="{k}" v="{v}"/>' for k, v in {"type": "multipolygon", **tags}.items())
            lines.append(f'<relation id="{i}" version="1">{members}{tagged}</relation>')
        path.write_text("\n".join([*lines, "</osm>"]))
        return str(path)


def square(x, y, side):
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]


@pytest.fixture
def town(tmp_path):
    extract = Extract()
    extract.way(square(0, 0, 20), building="yes", height="12.5 m", building_material="bricks")
    extract.way(square(40, 0, 20), building="yes", building_levels="4")
    extract.way(square(80, 0, 20), building="yes")
    outer, inner = extract.way(square(0, 40, 40)), extract.way(square(10, 50, 20))
    extract.relations.append((outer, inner, {"building": "yes", "height": "10"}))
    extract.way(square(80, 40, 20), building="yes", height="6")
    extract.way(square(80, 40, 10), **{"building_part": "yes"}, height="30")
    extract.way([(90, 40), (100, 40), (100, 50), (90, 50)], **{"building_part": "yes"}, height="8", min_height="5")
    extract.way(square(110, 0, 1), building="yes", height="9")
    extract.way([(-10, -10), (120, -10)], closed=False, highway="residential")
    extract.way([(-10, 30), (120, 30)], closed=False, highway="footway")
    return build_city(MeshCityConfig(path=extract.write(tmp_path / "town.osm")), np.random.default_rng(0))


def test_heights_holes_and_parts(town):
    area = np.array([plan.area for plan in town.footprints])
    by_height = sorted(zip(np.round(town.heights_m, 2).tolist(), np.round(area, -1).tolist(), strict=True))
    # 12.5 as given, 4 storeys of 3 m, the ring, part and floating part, the rest of the outline.
    assert {(12.5, 400.0), (12.0, 400.0), (10.0, 1200.0), (30.0, 100.0), (3.0, 100.0), (6.0, 200.0)} <= set(by_height)
    for said in ("1 outlines", "1 of 7 blocks tell neither", "6 of 7 blocks tell no known mat", "1 areas left out"):
        assert any(said in note for note in town.notes), said
    assert {town.materials[m].name for m in town.facets.material} == {"concrete", "brick", "medium_dry_ground"}


def test_courtyard_passage_and_roof(town):
    ring = next(p for p in town.footprints if p.interiors)
    x, y = ring.centroid.coords[0]
    part = next(p for p, h in zip(town.footprints, town.heights_m, strict=True) if abs(h - 3.0) < 1e-6)
    px, py = part.centroid.coords[0]
    # In the yard, over the roof, below the floating part: outside. In the ring, in the part: inside. Below ground: -2.
    places = [[x, y, 2.0], [x - 15.0, y, 11.0], [px, py, 2.0], [x - 15.0, y, 2.0], [px, py, 6.0], [x, y, -1.0]]
    where = enclosing(town, places)
    assert (where[:3] == OUTSIDE).all() and where[5] == -2
    assert town.footprints[where[3]] is ring and town.footprints[where[4]] is part


def test_streets_are_those_for_cars_in_local_metres(town):
    assert len(town.streets) == 1
    assert abs(np.hypot(*np.diff(town.streets[0], axis=0).T).sum() - 130.0) < 0.1
