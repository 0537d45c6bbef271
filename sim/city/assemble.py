"""Parts (one mesh each, with material and building), made of polygons too, and the City with facets made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mapbox_earcut
import numpy as np
import shapely
from shapely import Polygon

from cellslam.sim.city.city import TOLERANCES, City, Floats, Ints, Material, Tolerances
from cellslam.sim.city.facets import merge_facets
from cellslam.sim.errors import InputError


@dataclass(frozen=True)
class Part:
    """One object of one material: `vertices` (V, 3) in metres, `triangles` (K, 3), building or -1, ground."""

    vertices: Floats
    triangles: Ints
    material: int
    building: int


def prism(plan: Polygon, bottom_m: float, top_m: float, material: int, roof: int, building: int) -> list[Part]:
    """Return the walls, and the roof, of a building of one height; materials by index."""
    return [walls(plan, bottom_m, top_m, material, building), cap(plan, top_m, roof, building)]


def walls(plan: Polygon, bottom_m: float, top_m: float, material: int, building: int) -> Part:
    """Return the walls of all rings of a plan, normals outwards."""
    vertices, triangles = [], []
    count = 0
    for ring in _rings(plan):
        n = len(ring)
        vertices += [np.column_stack([ring, np.full(n, bottom_m)]), np.column_stack([ring, np.full(n, top_m)])]
        a = np.arange(n)
        b = (a + 1) % n
        triangles += [count + np.column_stack([a, b, b + n]), count + np.column_stack([a, b + n, a + n])]
        count += 2 * n
    return Part(np.concatenate(vertices), np.concatenate(triangles).astype(np.int64), material, building)


def cap(plan: Polygon, height_m: float, material: int, building: int) -> Part:
    """Return a plan at one height, normal up, holes open."""
    rings = _rings(plan)
    corners = np.concatenate(rings)
    triangles = ear_cut(corners, [len(ring) for ring in rings])
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    down = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) < (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles[down] = triangles[down][:, ::-1]
    return Part(np.column_stack([corners, np.full(len(corners), height_m)]), triangles, material, building)


def _rings(plan: Polygon) -> list[Floats]:
    """Return the corners (n, 2) of the rings of a plan, the outer one first and counter-clockwise."""
    oriented = shapely.orient_polygons(plan)
    return [np.asarray(ring.coords)[:-1, :2] for ring in (oriented.exterior, *oriented.interiors)]


def ear_cut(corners: Floats, sizes: Sequence[int]) -> Ints:
    """Return triangles (K, 3) that fill a plane polygon: corners (V, 2) of all its rings, how many each ring has."""
    ends = np.cumsum(sizes).astype(np.uint32)
    return np.asarray(mapbox_earcut.triangulate_float64(corners, ends).reshape(-1, 3), np.int64)


def assemble(
    name: str,
    parts: Sequence[Part],
    materials: Sequence[Material],
    footprints: Sequence[Polygon],
    heights_m: Floats,
    streets: Sequence[Floats] = (),
    notes: Sequence[str] = (),
    tolerances: Tolerances = TOLERANCES,
) -> City:
    """Return the city made of `parts`; `heights_m` (B,) of the buildings, `streets` centre lines (n, 2) in m.

    Raises InputError for no triangles, no area, or vertices that are not finite.
    """
    parts = [part for part in parts if len(part.triangles)]
    if not parts:
        raise InputError(f"city '{name}' has no triangles: give a mesh with at least one face")
    counts = [len(part.triangles) for part in parts]
    starts = np.concatenate([[0], np.cumsum([len(part.vertices) for part in parts])[:-1]])
    vertices = np.concatenate([part.vertices for part in parts]).astype(np.float64)
    triangles = np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=True)])
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(f"city '{name}': vertex {bad[0]} of {len(vertices)} is not finite; repair the mesh")
    if np.abs(vertices).max() > 1e8:
        raise InputError(f"city '{name}' has coordinates beyond 1e8 m: expected metres")
    label, facets = merge_facets(
        vertices,
        triangles,
        part=np.repeat(np.arange(len(parts)), counts),
        material=np.repeat([part.material for part in parts], counts),
        building=np.repeat([part.building for part in parts], counts),
        tolerances=tolerances,
    )
    if facets.area_m2.sum() <= 0.0:
        raise InputError(f"city '{name}' has zero area: all {len(triangles)} triangles are degenerate")
    return City(
        name=name,
        vertices=vertices,
        triangles=triangles,
        triangle_facet=label,
        facets=facets,
        materials=tuple(materials),
        footprints=tuple(footprints),
        heights_m=np.asarray(heights_m, np.float64),
        streets=tuple(streets),
        notes=tuple(notes),
        tolerances=tolerances,
    )
