"""Which triangles are ground, which building the others belong to, and each building's plan and height."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from cellslam.sim.city.city import GROUND, Floats, Ints
from cellslam.sim.city.facets import triangle_normals

# A triangle this steep (cosine of its slope) shows no area in plan.
STEEP = 0.02
GROUND_EXTENT = 0.8
CLOSING_M = 0.05
SMALLEST_M2 = 0.5


def ground_objects(corners: Floats, part: Ints) -> Ints:
    """Return the objects that are ground: they face up mostly and span most of the city both ways.

    `corners` (K, 3, 3) of all triangles in m; `part` (K,): object of each.
    """
    normals, area = triangle_normals(corners)
    count = int(part.max(initial=-1)) + 1
    total = np.bincount(part, area, count)
    level = np.bincount(part, area * np.abs(normals[:, 2]), count)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    plan = corners[:, :, :2]
    np.minimum.at(low, part, plan.min(axis=1))
    np.maximum.at(high, part, plan.max(axis=1))
    extent = np.ptp(plan.reshape(-1, 2), axis=0)
    wide = ((high - low) >= GROUND_EXTENT * extent).all(axis=1)
    return np.flatnonzero(wide & (level > 0.7 * np.maximum(total, 1e-300)))


def buildings(corners: Floats, group: Ints, is_ground: NDArray[np.bool_]) -> tuple[tuple[Polygon, ...], Floats, Ints]:
    """Return (footprints, heights_m (B,), building (K,)) from triangles (K, 3, 3) in metres.

    `group` (K,) says which triangles were modelled as one building; a group in several pieces becomes several
    buildings.
    """
    building = np.full(len(corners), GROUND, np.int64)
    footprints: list[Polygon] = []
    heights: list[float] = []
    order = np.flatnonzero(~is_ground)[np.argsort(group[~is_ground], kind="stable")]
    pieces = np.split(order, np.flatnonzero(np.diff(group[order])) + 1) if len(order) else []
    for rows in pieces:
        plans = _plans(corners[rows])
        owner = _nearest(plans, corners[rows].mean(axis=1)[:, :2])
        for index, plan in enumerate(plans):
            own = rows[owner == index]
            if len(own):
                building[own] = len(footprints)
                footprints.append(plan)
                heights.append(float(np.ptp(corners[own, :, 2])))
    return tuple(footprints), np.array(heights), building


def _plans(corners: Floats) -> list[Polygon]:
    """Return the pieces of the plan of one group: its roofs from above, or the hull of roofless walls."""
    flat = corners[:, :, :2]
    normals, area = triangle_normals(corners)
    shown = (np.abs(normals[:, 2]) > STEEP) & (area > 0.0)
    plan = shapely.union_all(shapely.make_valid(shapely.polygons(flat[shown]))) if shown.any() else Polygon()
    plan = plan.buffer(CLOSING_M, join_style="mitre").buffer(-CLOSING_M, join_style="mitre")
    found = [p for p in shapely.get_parts(plan) if p.geom_type == "Polygon" and p.area >= SMALLEST_M2]
    if found:
        return found
    hull = shapely.convex_hull(shapely.multipoints(flat.reshape(-1, 2)))
    return [hull if hull.geom_type == "Polygon" else hull.buffer(CLOSING_M)]


def _nearest(plans: list[Polygon], points: Floats) -> Ints:
    if len(plans) == 1:
        return np.zeros(len(points), np.int64)
    return np.asarray(shapely.STRtree(plans).nearest(shapely.points(points)), np.int64)
