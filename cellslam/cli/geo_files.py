"""Routes and places of GPX and GeoJSON files: longitudes and latitudes, in the order of the file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from cellslam.sim.city.city import City, Floats
from cellslam.sim.city.files.osm import local_m
from cellslam.sim.errors import InputError

# A place: its name ("" if it has none), longitude and latitude in degrees, height in m (NaN: not given).
Place = tuple[str, float, float, float]


def read_line(path: str, city: City) -> Floats:
    """Return the corners (n, 2) in metres of the city of the first track, route or LineString. Raises InputError."""
    lines, _ = _read(Path(path))
    line = next((line for line in lines if len(line) > 1), None)
    if line is None:
        raise InputError(f"{path}: has no line of two points or more; give a GPX track or a GeoJSON LineString")
    return _metres(line, city, path)[:, :2]


def read_places(path: str, city: City) -> list[tuple[str, Floats]]:
    """Return names and positions (3,) in metres of the city, height NaN if not given. Raises InputError."""
    _, places = _read(Path(path))
    if not places:
        raise InputError(f"{path}: has no places; give GPX waypoints or GeoJSON Points")
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


def _read(path: Path) -> tuple[list[list[Place]], list[Place]]:
    """Return the lines and the single places of a file."""
    try:
        text = path.read_text("utf-8")
        if path.suffix == ".gpx":
            return _gpx(ElementTree.fromstring(text))
        return _geojson(json.loads(text))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, ElementTree.ParseError) as error:
        raise InputError(f"{path}: is neither GPX (named .gpx) nor GeoJSON ({error})") from None


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
