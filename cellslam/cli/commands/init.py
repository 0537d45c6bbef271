"""`cellslam init`: a commented scenario file of a city, with a route and sites, which works at once."""

from __future__ import annotations

import math
import re
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cellslam.benchmarks.trials.output_files import check_file, write_text
from cellslam.cli.arguments import add, number
from cellslam.cli.cities import MESH_OPTIONS, add_mesh, city_of, note_oddities
from cellslam.cli.output import note
from cellslam.progress_bars import bars
from cellslam.scenarios.loading import from_tables, load, preset_names
from cellslam.sim.city.city import City, Floats
from cellslam.sim.city.files.osm import local_m
from cellslam.sim.city.inside import roof_height
from cellslam.sim.city.ways import ways_between
from cellslam.sim.data_files import json_of, text_of
from cellslam.sim.errors import InputError, one_line
from cellslam.sim.lte.sites import ABOVE_ROOF_M, LOWEST_M, CellConfig, SiteConfig, place_sites
from cellslam.sim.vehicle.route import MARGIN_M, Route, plan_route
from cellslam.sim.vehicle.vehicle_config import VehicleConfig

# A place: its name ("" if it has none), longitude and latitude in degrees, height in m (NaN: not given).
Place = tuple[str, float, float, float]
EXAMPLES = (
    "init lund-530 --out mine.toml",
    "init berlin.osm --route drive.gpx --sites sites.geojson --out berlin.toml",
)
SECTORS, APART_DEG = 3, 120.0
STOP_EVERY_M, STOP_S, STAND_FIRST_S, SPEED_MPS = 150.0, 8.0, 3.0, 1.1
DISTANCE_M, DRAWS = 300.0, 20
STRAIGHT_M = 0.5  # corners of a route from a file are as few as keep this close to it
SHOWN_EVERY_M = 4.0
SITES = ("A", "B")
_NUMBERS = re.compile(r"\[((?:\s*-?[\d.]+,)+)\s*\]")  # TOML's writer gives each a line
TEXT = """\
# A drive through {name}, written by `cellslam init`. `cellslam run` drives it;
# `cellslam show` lists every other key, with its unit, range and meaning.

# The buildings. A file is looked for from the folder in which cellslam is run.
{city}
# The base stations: x (east), y (north) and height of the antennas in m, and of each cell its identity
# and where its antenna points, in degrees counter-clockwise from east. Without position_m each trial draws
# another place near the route.
{sites}
# The drive. waypoints_m are the corners of the route, which is rounded there; it must be at least as long as
# distance_m. duration_s includes the stops.
{vehicle}"""


def add_arguments(parser: ArgumentParser) -> None:
    add_mesh(parser, "CITY")
    add(parser, "--out", metavar="FILE.toml", default="scenario.toml", help="file to write (default: scenario.toml)")
    distance_help = "distance driven in m (default: 300, or all of --route)"
    parser.add_argument("--distance", metavar="M", type=number, help=distance_help)
    route_help = "the route: a GPX track or a GeoJSON LineString (default: drawn)"
    parser.add_argument("--route", metavar="FILE", help=route_help)
    sites_help = "the sites: GPX waypoints or GeoJSON Points (default: two, drawn)"
    parser.add_argument("--sites", metavar="FILE", help=sites_help)
    add(parser, "--seed", default=1, help="seed that route and sites are drawn with (default: 1)")
    add(parser, "--no-figures", help="do not draw the plan")


def command(arguments: Namespace) -> None:
    out = Path(arguments.out)
    check_file(out)
    if out.exists():
        raise InputError(f"--out {out}: is there already; give another name")
    with bars(arguments.quiet) as progress, progress("drawing route and sites", 3) as advance:
        city = city_of(arguments)
        given = city
        if not city.streets:
            city = replace(city, streets=tuple(ways_between(city.footprints)))
        advance(1)
        rng = np.random.default_rng(arguments.seed)
        route, vehicle = _drive(arguments, city, rng)
        advance(1)
        sites = _sites(arguments, city, route, rng)
    tables = {"city": _city_table(arguments), "sites": sites, "vehicle": vehicle}
    from_tables({"name": out.stem, **tables})
    write_text(out, _written(arguments.mesh, tables))
    written = [out]
    if not arguments.no_figures:
        written.append(out.with_suffix(".png"))
        _draw(written[-1], city, route, np.array([site["position_m"] for site in sites]))
    note_oddities(arguments, given, route)
    note(arguments, f"wrote {', '.join(map(str, written))}; drive in it: cellslam run {out}")


def _city_table(arguments: Namespace) -> dict[str, Any]:
    name = arguments.mesh
    if name not in preset_names() and not name.endswith(".toml"):
        options = {key: value for key in MESH_OPTIONS if (value := getattr(arguments, key)) is not None}
        return {"kind": "mesh", "path": name, **options}
    city = load(name, code=False).city
    table = city.model_dump(mode="json", exclude_defaults=True)
    if table.get("seed") == "trial":
        raise InputError(f"city '{name}' is drawn anew in each trial; give a scenario whose city.seed is a number")
    return {"kind": city.kind, **table}


def _drive(arguments: Namespace, city: City, rng: np.random.Generator) -> tuple[Route, dict[str, Any]]:
    """Return the route and the table [vehicle] that gives it again."""
    if arguments.route:
        import shapely

        line = shapely.LineString(read_line(arguments.route, city)).simplify(STRAIGHT_M)
        distance = arguments.distance or math.floor(0.98 * line.length - MARGIN_M)
        vehicle = _vehicle_table(np.asarray(line.coords), distance)
        return plan_route(city, VehicleConfig.model_validate(vehicle), rng), vehicle
    distance = DISTANCE_M if arguments.distance is None else arguments.distance
    for _ in range(DRAWS):
        drawn = plan_route(city, VehicleConfig(route=int(rng.integers(2**31)), distance_m=distance), rng)
        vehicle = _vehicle_table(drawn.corners_m, distance)
        try:
            return plan_route(city, VehicleConfig.model_validate(vehicle), rng), vehicle
        except InputError as error:  # a corner as tight as can be, which written in centimetres is too tight
            problem = error
    raise problem


def _vehicle_table(corners_m: Floats, distance_m: float) -> dict[str, Any]:
    stops = round(distance_m / STOP_EVERY_M)
    return {
        "waypoints_m": [[round(float(x), 2), round(float(y), 2)] for x, y in corners_m],
        "distance_m": float(distance_m),
        "duration_s": float(math.ceil(distance_m / SPEED_MPS + stops * STOP_S + STAND_FIRST_S)),
        "stops": stops,
        "stop_s": STOP_S,
        "stand_first_s": STAND_FIRST_S,
    }


def _sites(arguments: Namespace, city: City, route: Route, rng: np.random.Generator) -> list[dict[str, Any]]:
    if not arguments.sites:
        import shapely

        extent = np.reshape(shapely.total_bounds(city.footprints), (2, 2))  # of all buildings; NaN without any
        configs = [SiteConfig(name=name, cells=(CellConfig(cell_id=0),)) for name in SITES]
        try:
            drawn = place_sites(city, route, configs, rng, extent)
        except InputError:  # the city is too small for two
            drawn = place_sites(city, route, configs, rng)
        return [_site(index, *found) for index, found in enumerate(zip(SITES, drawn, strict=True))]
    sites = []
    for index, (name, (x, y, height)) in enumerate(read_places(arguments.sites, city)):
        lowest = max(city.road_m + LOWEST_M, roof_height(city, x, y) + ABOVE_ROOF_M)
        known = height if math.isfinite(height) else lowest
        sites.append(_site(index, name, np.array([x, y, known])))
    return sites


def _site(index: int, name: str, position_m: Floats) -> dict[str, Any]:
    cells = [{"cell_id": SECTORS * index + k, "azimuth_deg": APART_DEG * k} for k in range(SECTORS)]
    return {"name": name, "position_m": [round(float(x), 1) for x in position_m], "cells": cells}


def _written(city: str, tables: dict[str, Any]) -> str:
    """Return the text of the scenario file."""
    import tomli_w

    parts = {name: tomli_w.dumps({name: table}) for name, table in tables.items()}
    return _NUMBERS.sub(
        lambda some: f"[{', '.join(some[1].replace(',', '').split())}]", TEXT.format(name=city, **parts)
    )


def _draw(path: Path, city: City, route: Route, sites_m: Floats) -> None:
    from cellslam.benchmarks.figures.city_pictures import draw_plan
    from cellslam.sim.rays import trace
    from cellslam.sim.rays.exchange import Traced

    step = max(round(SHOWN_EVERY_M * len(route.points_m) / route.length_m), 1)
    foot = route.points_m[::step]
    receivers = np.column_stack([foot, np.full(len(foot), city.road_m + VehicleConfig().array_height_m)])
    draw_plan(path, city, Traced(trace(city, sites_m, receivers), sites_m, receivers))


def read_line(path: str, city: City) -> Floats:
    """Return the corners (n, 2) in metres of the city of the first track, route or LineString. Raises InputError."""
    lines, _ = _read_geo_file(Path(path))
    line = next((line for line in lines if len(line) > 1), None)
    if line is None:
        raise InputError(f"{path}: has no line of two points or more; give a GPX track or a GeoJSON LineString")
    return _metres(line, city, path)[:, :2]


def read_places(path: str, city: City) -> list[tuple[str, Floats]]:
    """Return names and positions (3,) in metres of the city, height NaN if not given. Raises InputError."""
    _, places = _read_geo_file(Path(path))
    if not places:
        raise InputError(f"{path}: has no points; give GPX waypoints or GeoJSON Points")
    positions = _metres(places, city, path)
    return [
        (place[0] or f"site-{i + 1}", position)
        for i, (place, position) in enumerate(zip(places, positions, strict=True))
    ]


def _metres(places: list[Place], city: City, path: str) -> Floats:
    if city.origin_deg is None:
        raise InputError(
            f"{path}: city '{city.name}' does not say where on the globe it is, as OpenStreetMap extracts do; "
            "write positions in metres into the scenario file"
        )
    lonlat, height = np.array([p[1:3] for p in places]), np.array([p[3] for p in places])
    metres = np.column_stack([local_m(lonlat, city.origin_deg), height])
    low, high = city.bounds[:, :2]
    far = np.flatnonzero(((metres[:, :2] < low) | (metres[:, :2] > high)).any(axis=1))
    if len(far):
        lon, lat = lonlat[far[0]]
        raise InputError(f"{path}: longitude {lon:g}, latitude {lat:g} is outside of city '{city.name}'")
    return metres


def _read_geo_file(path: Path) -> tuple[list[list[Place]], list[Place]]:
    """Return the lines and the single places of a file."""
    try:
        text = text_of(path)
        if path.suffix == ".gpx":
            return _gpx(ElementTree.fromstring(text))
        return _geojson(json_of(text))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, ElementTree.ParseError) as error:
        raise InputError(f"{path}: is neither GPX (named .gpx) nor GeoJSON ({one_line(error, 160)})") from None


def _gpx(root: ElementTree.Element) -> tuple[list[list[Place]], list[Place]]:
    """Source: https://www.topografix.com/GPX/1/1/."""
    space = root.tag.partition("}")[0] + "}" if root.tag.startswith("{") else ""

    def place(point: ElementTree.Element) -> Place:
        height = point.findtext(f"{space}ele")
        name = point.findtext(f"{space}name") or ""
        return name, float(point.attrib["lon"]), float(point.attrib["lat"]), float(height) if height else np.nan

    lines = [
        [place(p) for p in s.iter(f"{space}{point}")]
        for of, point in (("trk", "trkpt"), ("rte", "rtept"))
        for s in root.iter(f"{space}{of}")
    ]
    return lines, [place(p) for p in root.iter(f"{space}wpt")]


def _geojson(data: dict[str, Any]) -> tuple[list[list[Place]], list[Place]]:
    """Source: RFC 7946."""

    def place(at: list[float], name: str = "") -> Place:
        return name, float(at[0]), float(at[1]), float(at[2]) if len(at) > 2 else np.nan

    def features() -> Iterator[tuple[str, dict[str, Any]]]:
        for feature in data["features"] if data["type"] == "FeatureCollection" else [data]:
            yield str((feature.get("properties") or {}).get("name", "")), feature.get("geometry", feature)

    found = list(features())
    lines = [[place(at) for at in g["coordinates"]] for _, g in found if g["type"] == "LineString"]
    return lines, [place(g["coordinates"], name) for name, g in found if g["type"] == "Point"]
