"""Polygons to walls, roofs and ground."""

from __future__ import annotations

import mapbox_earcut
import numpy as np
import shapely
from shapely import Polygon

from cellslam.sim.city.city import Floats, Ints


def walls(footprint: Polygon, base_m: float, top_m: float) -> tuple[Floats, Ints]:
    """Return vertices (V, 3) and triangles (K, 3) of the walls of all rings, in m, normals outwards."""
    vertices, triangles = [], []
    count = 0
    oriented = shapely.orient_polygons(footprint)
    for ring in [oriented.exterior, *oriented.interiors]:
        plan = np.asarray(ring.coords)[:-1, :2]
        n = len(plan)
        vertices += [np.column_stack([plan, np.full(n, base_m)]), np.column_stack([plan, np.full(n, top_m)])]
        a = np.arange(n)
        b = (a + 1) % n
        triangles += [count + np.column_stack([a, b, b + n]), count + np.column_stack([a, b + n, a + n])]
        count += 2 * n
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int64)


def cap(footprint: Polygon, height_m: float) -> tuple[Floats, Ints]:
    """Return vertices (V, 3) and triangles (K, 3) of a footprint at one height, in m, normal up, holes open."""
    oriented = shapely.orient_polygons(footprint)
    rings = [np.asarray(ring.coords)[:-1, :2] for ring in (oriented.exterior, *oriented.interiors)]
    plan = np.concatenate(rings)
    ends = np.cumsum([len(ring) for ring in rings]).astype(np.uint32)
    triangles = mapbox_earcut.triangulate_float64(plan, ends).reshape(-1, 3).astype(np.int64)
    a, b, c = (plan[triangles[:, i]] for i in range(3))
    down = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) < (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles[down] = triangles[down][:, ::-1]
    return np.column_stack([plan, np.full(len(plan), height_m)]), triangles
