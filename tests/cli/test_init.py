"""`cellslam init`: what it writes works, places of files are where the globe has them, what cannot be is one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from cellslam.cli.cities import find_city
from cellslam.cli.commands.init import read_line, read_places
from cellslam.scenarios.loading import load
from cellslam.sim.city import City
from cellslam.sim.world import prepare
from tests.command_line import Run, refused

VILLAGE = Path(__file__).parents[2] / "docs" / "examples" / "village"
ALONG = [str(VILLAGE / "village.osm"), "--route", str(VILLAGE / "route.gpx")]
METRES_A_DEGREE = 111_229.0  # of latitude, at 50 degrees


@pytest.fixture(scope="module")
def village() -> City:
    return find_city(str(VILLAGE / "village.osm"))


def test_a_drawn_scenario_is_drawn_again_by_the_same_seed_and_works(cellslam: Run) -> None:
    for name in ("a.toml", "b.toml"):
        assert cellslam("init", "tiny", "--distance", 30, "--out", name, "--no-figures", "--quiet").status == 0
    assert Path("a.toml").read_text() == Path("b.toml").read_text()
    scenario = load("a.toml")
    assert [len(site.cells) for site in scenario.sites] == [3, 3]
    assert len({cell.cell_id for site in scenario.sites for cell in site.cells}) == 6
    world = prepare(scenario.world, 0, 0)
    assert np.hypot(*np.diff(world.drive.poses[:, :2], axis=0).T).sum() == pytest.approx(30.0, abs=0.5)
    assert scenario.city == load("tiny").city


def test_a_city_without_streets_far_above_the_sea_gets_a_route_between_its_buildings(cellslam: Run) -> None:
    corners = [(150_000.0 + 60 * i, 340_000.0 + 60 * k) for i in range(4) for k in range(4)]
    Path("blocks.obj").write_text("".join(box(x, y, 171.25, index) for index, (x, y) in enumerate(corners)))
    words = ("init", "blocks.obj", "--distance", 60, "--out", "blocks.toml", "--no-figures", "--quiet")
    assert cellslam(*words).status == 0
    scenario = load("blocks.toml")
    assert Path("blocks.toml").read_text().count("\n    [150") == len(scenario.vehicle.waypoints_m or ())
    world = prepare(scenario.world, 0, 0)
    assert world.scene.city.road_m == 171.2
    np.testing.assert_allclose(world.drive.poses[:, 2], 173.0, atol=0.3)
    sites = np.array([site.position_m for site in scenario.sites])
    assert (sites[:, 2] > 206.0).all()
    assert (sites[:, :2] >= (150_000.0, 340_000.0)).all() and (sites[:, :2] <= (150_210.0, 340_210.0)).all()
    way, houses = shapely.LineString(world.drive.poses[:, :2]), shapely.union_all(world.scene.city.footprints)
    assert shapely.distance(way, houses) > 1.2


def box(x: float, y: float, z: float, index: int) -> str:
    """Return a house of 30 x 30 x 15 m in the OBJ format."""
    corners = [(x + 30 * a, y + 30 * b, z + 15 * c) for c in (0, 1) for b in (0, 1) for a in (0, 1)]
    faces = [(1, 2, 6, 5), (2, 4, 8, 6), (4, 3, 7, 8), (3, 1, 5, 7), (5, 6, 8, 7), (1, 3, 4, 2)]
    lines = [f"o house{index}", *(f"v {a} {b} {c}" for a, b, c in corners)]
    return "\n".join([*lines, *("f " + " ".join(str(8 * index + n) for n in face) for face in faces), ""])


def test_a_city_on_its_side_is_noted_and_up_sets_it_upright(cellslam: Run) -> None:
    """Blocks of 12 m height on a square of 200 m, in a file whose y is up."""
    corners = [(x, z) for x in (0.0, 90.0, 180.0) for z in (0.0, 90.0, 180.0)]
    boxes = [trimesh.creation.box((20.0, 12.0, 20.0)).apply_translation((x, 6.0, z)) for x, z in corners]
    trimesh.util.concatenate(boxes).export("y-up.obj")
    line = ("init", "y-up.obj", "--distance", 40, "--no-figures")
    assert "if another axis is up" in cellslam("city", "inspect", "y-up.obj", "--no-figures").out
    done = cellslam(*line, "--up", "y", "--out", "upright.toml")
    assert done.status == 0 and "another axis" not in done.err, done.err
    scenario = load("upright.toml")
    assert scenario.city.kind == "mesh" and scenario.city.up == "y"
    height, length = np.ptp(prepare(scenario.world, 0, 0).scene.city.vertices, axis=0)[[2, 0]]
    assert (height, length) == pytest.approx((12.0, 200.0))


def test_a_route_beside_the_streets_is_noted(cellslam: Run) -> None:
    done = cellslam("init", *ALONG, "--out", "along.toml", "--no-figures")
    assert done.status == 0 and "more than 15 m from every street" not in done.err
    north = 50.0 + 45.0 / METRES_A_DEGREE  # behind the houses
    points = "".join(f'<trkpt lat="{north}" lon="{lon}"/>' for lon in (9.9990, 10.0005))
    Path("field.gpx").write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>")
    done = cellslam("init", ALONG[0], "--route", "field.gpx", "--out", "field.toml", "--no-figures")
    assert done.status == 0, done.err
    beside = "of the route are more than 15 m from every street, first at ("
    assert beside in done.err and beside in cellslam("record", "field.toml", "--out", "field.h5").err


def test_an_own_city_is_noted_where_it_is_used(cellslam: Run) -> None:
    assert cellslam("init", *ALONG, "--out", "field.toml", "--no-figures").status == 0
    assert "note: origin at longitude" in cellslam("show", "field.toml").err
    assert not cellslam("show", "field.toml", "--quiet").err
    text, old = Path("field.toml").read_text(), load("field.toml").vehicle.waypoints_m
    assert old is not None
    Path("wall.toml").write_text(text.replace(str(old[-1][1]), f"{old[-1][1] - 25.0:g}"))
    done = cellslam("show", "wall.toml")
    assert done.status == 0 and "note: the route runs through a wall of building" in done.err
    refused(cellslam("run", "wall.toml"), "the route runs through a wall of building")


def test_route_and_sites_of_files(cellslam: Run, village: City) -> None:
    words = ("init", *ALONG, "--sites", VILLAGE / "sites.geojson", "--out", "village.toml", "--quiet")
    assert cellslam(*words).status == 0
    scenario = load("village.toml")
    assert [site.name for site in scenario.sites] == ["north", "east"]
    line = read_line(str(VILLAGE / "route.gpx"), village)
    np.testing.assert_allclose(np.array(scenario.vehicle.waypoints_m)[[0, -1]], line[[0, -1]], atol=0.006)
    assert scenario.vehicle.distance_m > 140.0
    assert Path("village.png").stat().st_size > 10_000


def test_a_place_is_where_the_globe_has_it(tmp_path: Path, village: City) -> None:
    assert village.origin_deg is not None
    lon, lat = village.origin_deg
    point = {"type": "Point", "coordinates": [lon, lat + 50.0 / METRES_A_DEGREE]}
    file = tmp_path / "one.geojson"
    file.write_text(json.dumps({"type": "Feature", "properties": {"name": "up"}, "geometry": point}))
    ((name, position),) = read_places(str(file), village)
    assert name == "up" and np.isnan(position[2])
    np.testing.assert_allclose(position[:2], [0.0, 50.0], atol=0.02)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["tiny", "--route", str(VILLAGE / "route.gpx")], "does not say where on the globe it is"),
        (["anywhere"], "drawn anew in each trial"),
        ([str(VILLAGE / "village.osm"), "--route", str(VILLAGE / "village.osm")], "neither GPX"),
        ([*ALONG, "--sites", str(VILLAGE / "route.gpx")], "has no points"),
        ([*ALONG, "--sites", "far.geojson"], "is outside of city 'village'"),
    ],
)
def test_what_cannot_be_is_one_line(words: list[str], text: str, cellslam: Run) -> None:
    Path("far.geojson").write_text(json.dumps({"type": "Point", "coordinates": [11.0, 51.0]}))
    refused(cellslam("init", *words, "--quiet"), text)
    assert not Path("scenario.toml").exists()
