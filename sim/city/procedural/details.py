"""What makes generated streets less smooth, all of it optional: bays, shop fronts, poles."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import shapely
from shapely import Polygon

from cellslam.sim.city.city import Floats
from cellslam.sim.city.city_config import ProceduralCityConfig

SHOP_HEIGHT_M = 4.0
POLE_HEIGHT_M, POLE_RADIUS_M, POLE_CORNERS = 8.0, 0.12, 6
KERB_M = 0.8
CLEAR_M = 0.5


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
