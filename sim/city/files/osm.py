"""OpenStreetMap extracts: footprints to blocks with the heights that their tags tell, streets, in local metres."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely import Polygon

from cellslam.sim.city.assemble import assemble, cap, prism
from cellslam.sim.city.city import GROUND, City, Floats, Material, Tolerances
from cellslam.sim.city.materials import THICKNESS_M, itu_material
from cellslam.sim.city.ways import largest_network
from cellslam.sim.errors import InputError, one_line
from cellslam.sim.plausible import RANGES

Tags = Mapping[str, str]

STOREY_M = 3.0
UNKNOWN_HEIGHT_M = 9.0
GROUND_MARGIN_M = 100.0
SMALLEST_M2 = 2.0
REMAINDER_M = 0.5
DRIVABLE = re.compile(
    r"(motorway|trunk|primary|secondary|tertiary)(_link)?|unclassified|residential|living_street|pedestrian"
)
# Values of building:material, as taginfo counts them, by ITU-R P.2040 name.
MATERIALS = {
    "brick": "brick", "bricks": "brick", "concrete": "concrete", "cement_block": "concrete", "reinforced_concrete":
    "concrete", "glass": "glass", "mirror": "glass", "metal": "metal", "metal_plates": "metal", "steel": "metal",
    "wood": "wood", "timber_framing": "wood", "marble": "marble",
}  # fmt: skip
_LENGTH = re.compile(r"\s*(\d+(?:[.,]\d+)?(?:e\d+)?)\s*(m|ft|')?", re.IGNORECASE)
# WGS 84: semi-major axis, first eccentricity squared.
_SEMI_MAJOR_M, _ECCENTRICITY2 = 6378137.0, 6.69437999014e-3


@dataclass(frozen=True)
class _Block:
    """A prism: plan in local metres, bottom and top above ground; top or material None: the tags do not tell."""

    plan: Polygon
    bottom_m: float
    top_m: float | None
    material: str | None


def load_osm(path: Path, material: str, roughness_m: float, tolerances: Tolerances) -> City:
    """Return the city of a .osm or .pbf extract. Raises InputError for what cannot be read or has no building."""
    areas, lines = _read(path)
    if not areas:
        raise InputError(f"OpenStreetMap extract '{path}' has no building: no closed way or area tagged 'building'")
    centres = np.array([rings[0].mean(axis=0) for rings, _ in areas])
    origin = np.asarray(np.round(centres.mean(axis=0), 4), np.float64)
    found = [(_is_part(tags), _blocks(rings, tags, origin)) for rings, tags in areas]
    outlines, parts = ([b for part, some in found if part == wanted for b in some] for wanted in (False, True))
    blocks, replaced = _without_parts(outlines, parts)
    if not blocks:
        raise InputError(f"OpenStreetMap extract '{path}' has no building of at least {SMALLEST_M2:g} m2")
    unknown, unnamed = (sum(getattr(b, name) is None for b in blocks) for name in ("top_m", "material"))
    left_out = sum(not some for _, some in found)
    known = [b.top_m for b in blocks if b.top_m is not None]
    height_m = float(np.median(known)) if known else UNKNOWN_HEIGHT_M
    counts = [
        (replaced, "outlines made way for their building parts"),
        (left_out, "areas left out: under the ground, below 2 m2, or no higher than their bottom"),
        (unknown, f"of {len(blocks)} blocks tell neither height nor levels: {height_m:g} m assumed"),
        (unnamed, f"of {len(blocks)} blocks tell no known material: {material} assumed"),
    ]
    notes = [f"origin at longitude {origin[0]:.4f}, latitude {origin[1]:.4f}"]
    notes += [f"{count} {text}" for count, text in counts if count]
    streets = _streets([local_m(line, origin) for line in lines], blocks)
    name = path.stem.removesuffix(".osm")
    city = _extruded(name, blocks, height_m, material, roughness_m, streets, notes, tolerances)
    return replace(city, origin_deg=(float(origin[0]), float(origin[1])))


def _is_part(tags: Tags) -> bool:
    return tags.get("building:part", "no") != "no"


def _read(path: Path) -> tuple[list[tuple[list[Floats], Tags]], list[Floats]]:
    """Return buildings and their parts (rings, the first one outside, and tags) and street lines of a file, all (n, 2)
    in longitude and latitude.
    """
    try:
        import osmium
    except ModuleNotFoundError:
        raise InputError(f"'{path}' is OpenStreetMap data, which needs osmium: pip install 'cellslam[osm]'") from None
    areas: list[tuple[list[Floats], Tags]] = []
    lines: list[Floats] = []
    wanted = osmium.filter.KeyFilter("building", "building:part")
    try:
        found: Iterable[Any] = osmium.FileProcessor(str(path)).with_areas(wanted)
        for item in found:
            tags = item.tags
            if item.is_area() and ("building" in tags or "building:part" in tags):
                for outer in item.outer_rings():
                    rings = [outer, *item.inner_rings(outer)]
                    areas.append(([np.array([(n.lon, n.lat) for n in ring], np.float64) for ring in rings], dict(tags)))
            elif item.is_way() and DRIVABLE.fullmatch(tags.get("highway", "")) and tags.get("tunnel", "no") == "no":
                line = [(n.lon, n.lat) for n in item.nodes if n.location.valid()]
                lines += [np.array(line)] if len(line) > 1 else []
    except Exception as error:  # libosmium's errors are of many kinds
        text = one_line(error, 160) or type(error).__name__
        raise InputError(f"cannot read OpenStreetMap extract '{path}': {text}") from None
    return [(rings, tags) for rings, tags in areas if tags.get("building", "no") != "no" or _is_part(tags)], lines


def local_m(lonlat_deg: Floats, origin_deg: Floats | tuple[float, float]) -> Floats:
    """Return east and north (n, 2) in metres of longitudes and latitudes (n, 2), in degrees, about an origin (2,).

    On the plane that touches the WGS 84 ellipsoid at the origin.
    """
    points, centre = (_geocentric(np.radians(p)) for p in (lonlat_deg, origin_deg))
    (sin_lon, sin_lat), (cos_lon, cos_lat) = np.sin(np.radians(origin_deg)), np.cos(np.radians(origin_deg))
    east = np.array([-sin_lon, cos_lon, 0.0])
    north = np.array([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat])
    return np.asarray((points - centre) @ np.column_stack([east, north]), np.float64)


def _geocentric(lonlat: Floats) -> Floats:
    lon, lat = lonlat[..., 0], lonlat[..., 1]
    radius = _SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY2 * np.sin(lat) ** 2)
    flat = radius * np.cos(lat)
    z = radius * (1.0 - _ECCENTRICITY2) * np.sin(lat)
    return np.stack([flat * np.cos(lon), flat * np.sin(lon), z], axis=-1)


def _blocks(rings: list[Floats], tags: Tags, origin_deg: Floats) -> list[_Block]:
    """Return the prisms of one area; none if it is underground or too small."""
    plan = shapely.Polygon(local_m(rings[0], origin_deg), [local_m(ring, origin_deg) for ring in rings[1:]])
    plan = shapely.set_precision(shapely.make_valid(plan), 1e-3)
    bottom = _metres(tags, "min_height", "building:min_level") or 0.0
    top = _metres(tags, "height", "building:levels")
    name = MATERIALS.get(tags.get("building:material", ""))
    if tags.get("location") == "underground" or (top is not None and top <= bottom):
        return []
    pieces = [p for p in shapely.get_parts(plan) if p.geom_type == "Polygon" and p.area >= SMALLEST_M2]
    return [_Block(piece, bottom, top, name) for piece in pieces]


def _metres(tags: Tags, length_key: str, level_key: str) -> float | None:
    """Read a height: in metres, in feet, or as a number of storeys; None if no tag tells."""
    for key, unit_m in ((length_key, 1.0), (level_key, STOREY_M)):
        found = _LENGTH.match(tags.get(key, ""))
        if found:
            height = float(found[1].replace(",", ".")) * (0.3048 if found[2] in ("ft", "'") else unit_m)
            RANGES["height"].check(height, f"OpenStreetMap tag {key}={one_line(tags[key], 40)}")
            return height
    return None


def _without_parts(outlines: list[_Block], parts: list[_Block]) -> tuple[list[_Block], int]:
    """Return parts, and of each outline what its parts leave of it (Simple 3D Buildings: nothing should remain)."""
    tree = shapely.STRtree([p.plan for p in parts])
    left, replaced = [], 0
    for outline in outlines:
        inside = [i for i in tree.query(outline.plan) if outline.plan.intersects(parts[i].plan.buffer(-0.1))]
        if not inside:
            left.append(outline)
            continue
        replaced += 1
        rest = outline.plan.difference(shapely.unary_union([parts[i].plan for i in inside]))
        rest = rest.buffer(-REMAINDER_M, join_style="mitre").buffer(REMAINDER_M, join_style="mitre")
        rest = shapely.set_precision(rest.intersection(outline.plan), 1e-3)
        pieces = [p for p in shapely.get_parts(rest) if p.geom_type == "Polygon" and p.area >= SMALLEST_M2]
        left += [_Block(p, outline.bottom_m, outline.top_m, outline.material) for p in pieces]
    return [*left, *parts], replaced


def _streets(lines: list[Floats], blocks: list[_Block]) -> list[Floats]:
    """Return the largest connected part of the streets within the city's extent, clear of buildings."""
    plans = [b.plan for b in blocks if b.bottom_m < STOREY_M]
    extent = shapely.box(*shapely.total_bounds([b.plan for b in blocks])).buffer(GROUND_MARGIN_M / 2)
    free = shapely.unary_union([shapely.LineString(line) for line in lines]).intersection(extent)
    free = free.difference(shapely.unary_union(plans).buffer(1.0))
    pieces = [np.round(np.asarray(g.coords), 2) for g in shapely.get_parts(free) if g.geom_type == "LineString"]
    return largest_network(pieces)


def _extruded(
    name: str, blocks: list[_Block], unknown_m: float, default: str, roughness_m: float,
    streets: list[Floats], notes: list[str], tolerances: Tolerances,
) -> City:  # fmt: skip
    """Put blocks on a flat ground. A block in the air gets a floor."""
    names = sorted({b.material or default for b in blocks} | {default})
    materials: list[Material] = [itu_material(n, THICKNESS_M.get(n), roughness_m) for n in names]
    materials.append(itu_material("medium_dry_ground", None, roughness_m))
    extent = shapely.box(*shapely.total_bounds([b.plan for b in blocks])).buffer(GROUND_MARGIN_M, join_style="mitre")
    parts = [cap(extent, 0.0, len(names), GROUND)]
    heights = np.array([(b.bottom_m + unknown_m if b.top_m is None else b.top_m) - b.bottom_m for b in blocks])
    for building, (block, height) in enumerate(zip(blocks, heights, strict=True)):
        material, top = names.index(block.material or default), block.bottom_m + float(height)
        parts += prism(block.plan, block.bottom_m, top, material, material, building)
        if block.bottom_m > 0.0:
            parts.append(cap(block.plan, block.bottom_m, material, building))
    return assemble(name, parts, materials, [b.plan for b in blocks], heights, streets, notes, tolerances)
