"""What stands in a block: a closed rim of houses round a courtyard, free-standing houses, or nothing.

What makes streets less smooth is optional: bays, and poles.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import shapely
from shapely import Polygon
from shapely.affinity import rotate, translate

from cellslam.sim.city.city import Floats
from cellslam.sim.city.city_config import ProceduralCityConfig

SMALLEST_AREA_M2 = 60.0
SMALLEST_WIDTH_M = 5.0
FREE_GAP_M = 7.0
POLE_HEIGHT_M, POLE_RADIUS_M, POLE_CORNERS = 8.0, 0.12, 6
KERB_M = 0.8
CLEAR_M = 0.5


def blocks_between(lines: list[shapely.LineString], widths_m: list[float]) -> list[Polygon]:
    """Return the polygons that streets of the given widths leave between them."""
    faces = shapely.get_parts(shapely.polygonize(lines))
    roads = shapely.unary_union(
        [line.buffer(w / 2, quad_segs=2, join_style="mitre") for line, w in zip(lines, widths_m, strict=True)]
    )
    left = [shapely.get_parts(face.difference(roads)) for face in faces]
    return [_clean(p) for parts in left for p in parts if _usable(p)]


def closed_block(block: Polygon, config: ProceduralCityConfig, rng: np.random.Generator) -> list[Polygon]:
    """Return houses along the rim of a block, wall to wall, some lots empty, some set back."""
    corners = np.asarray(shapely.normalize(block).reverse().exterior.coords)
    if not shapely.is_ccw(shapely.LinearRing(corners)):
        corners = corners[::-1]
    houses: list[Polygon] = []
    taken = Polygon()
    for start, end in itertools.pairwise(corners):
        length = float(np.hypot(*(end - start)))
        if length < 8.0:
            continue
        along = (end - start) / length
        inward = np.array([-along[1], along[0]])
        cuts = np.linspace(0.0, length, max(1, round(length / rng.uniform(14.0, 28.0))) + 1)
        for a, b in itertools.pairwise(cuts):
            empty = rng.random() < config.gap_share
            front = rng.choice([0.0, 0.0, rng.uniform(0.5, 3.0)])
            depth = rng.uniform(10.0, 15.0)
            if empty:
                continue
            quad = [start + a * along + front * inward, start + b * along + front * inward]
            quad += [quad[1] + depth * inward, quad[0] + depth * inward]
            house = Polygon(quad).intersection(block).difference(taken)
            fitting = [_clean(p) for p in shapely.get_parts(house) if _usable(p)]
            houses += fitting
            taken = taken.union(shapely.unary_union(fitting)) if fitting else taken
    return [h for h in houses if _usable(h)]


def open_block(block: Polygon, config: ProceduralCityConfig, rng: np.random.Generator) -> list[Polygon]:
    """Return free-standing houses of varied shape and orientation that keep their distance."""
    room = block.buffer(-2.0)
    if room.is_empty:
        return []
    corners = np.asarray(block.exterior.coords)
    sides = np.diff(corners, axis=0)
    weights = np.hypot(*sides.T)
    low, high = np.asarray(room.bounds[:2]), np.asarray(room.bounds[2:])
    houses: list[Polygon] = []
    covered = 0.0
    for _ in range(80):
        side = sides[rng.choice(len(sides), p=weights / weights.sum())]
        angle = np.arctan2(side[1], side[0]) if rng.random() < config.open_align else rng.uniform(0.0, np.pi)
        house = translate(rotate(_plan(rng), angle, origin=(0, 0), use_radians=True), *rng.uniform(low, high))
        if covered >= config.open_coverage * block.area:
            break
        if covered + house.area > 1.3 * config.open_coverage * block.area or not room.contains(house):
            continue
        if all(house.distance(other) >= FREE_GAP_M for other in houses):
            houses.append(_clean(house))
            covered += house.area
    return houses


def _plan(rng: np.random.Generator) -> Polygon:
    """Draw the plan of a free-standing house round the origin: a slab, a point house or an L."""
    length, width = rng.uniform(16.0, 46.0), rng.uniform(10.0, 16.0)
    kind = rng.random()
    if kind < 0.3:
        length = width * rng.uniform(1.0, 1.4)
    plan = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    if kind > 0.8:
        wing = rng.uniform(10.0, 20.0)
        plan = plan.union(shapely.box(-length / 2, -width / 2, -length / 2 + rng.uniform(9.0, 13.0), width / 2 + wing))
    return plan


def _usable(polygon: Polygon) -> bool:
    return (
        polygon.geom_type == "Polygon"
        and polygon.area >= SMALLEST_AREA_M2
        and not polygon.buffer(-SMALLEST_WIDTH_M / 2).is_empty
    )


def _clean(polygon: Polygon) -> Polygon:
    """Round to a millimetre grid and drop corners that are hardly any, so that no wall is a sliver."""
    return shapely.set_precision(polygon.simplify(0.15), 1e-3)


def with_bays(footprints: Sequence[Polygon], config: ProceduralCityConfig, rng: np.random.Generator) -> list[Polygon]:
    """Return footprints of which a share has bays: boxes 3 to 4 m wide that step 0.6 to 1.2 m out of long walls."""
    out = list(footprints)
    tree = shapely.STRtree(out)
    for index in np.flatnonzero(rng.random(len(out)) < config.bay_share):
        bays = _bays(out[index], rng)
        near = [out[i] for i in tree.query(out[index].buffer(3.0)) if i != index]
        free = [bay for bay in bays if all(other.distance(bay) >= CLEAR_M for other in near)]
        grown = shapely.set_precision(shapely.unary_union([out[index], *free]), 1e-3)
        if grown.geom_type == "Polygon":
            out[index] = grown
    return out


def _bays(plan: Polygon, rng: np.random.Generator) -> list[Polygon]:
    corners = np.asarray(shapely.orient_polygons(plan).exterior.coords)
    depth, width, pitch = rng.uniform(0.6, 1.2), rng.uniform(3.0, 4.0), rng.uniform(6.0, 9.0)
    bays = []
    for start, end in itertools.pairwise(corners):
        length = float(np.hypot(*(end - start)))
        count = int((length - 2.0) // pitch)
        along = (end - start) / max(length, 1e-9)
        # Counter-clockwise rings have the outside on their right.
        outward = np.array([along[1], -along[0]])
        for middle in (np.arange(count) + 0.5) * length / max(count, 1):
            low, high = start + (middle - width / 2) * along, start + (middle + width / 2) * along
            bays.append(
                Polygon([low - 0.1 * outward, high - 0.1 * outward, high + depth * outward, low + depth * outward])
            )
    return bays


def pole_plans(
    streets: Sequence[Floats], widths_m: Sequence[float], footprints: Sequence[Polygon], config: ProceduralCityConfig
) -> list[Polygon]:
    """Return the plans of lamp posts along both kerbs of all streets, clear of buildings.

    `streets` centre lines (n, 2) and `widths_m` of the streets, in m; the posts stand `pole_spacing_m` apart.
    """
    places = []
    for line, width in zip(streets, widths_m, strict=True):
        string = shapely.LineString(line)
        for side in (-1.0, 1.0):
            kerb = string.offset_curve(side * (width / 2 - KERB_M))
            at = np.arange(config.pole_spacing_m / 2, kerb.length, config.pole_spacing_m)
            places += [(p.x, p.y) for p in shapely.get_parts(shapely.line_interpolate_point(kerb, at))]
    if not places:
        return []
    points = shapely.points(np.round(places, 3))
    roads = shapely.unary_union(
        [
            shapely.LineString(s).buffer(w / 2 - 2 * KERB_M, cap_style="flat")
            for s, w in zip(streets, widths_m, strict=True)
        ]
    )
    free = ~shapely.intersects(points, shapely.unary_union([p.buffer(CLEAR_M) for p in footprints]))
    free &= ~shapely.contains(roads, points)
    turn = 2.0 * np.pi * np.arange(POLE_CORNERS) / POLE_CORNERS
    rim = POLE_RADIUS_M * np.column_stack([np.cos(turn), np.sin(turn)])
    return [Polygon(rim + np.array([p.x, p.y])) for p in points[free]]
