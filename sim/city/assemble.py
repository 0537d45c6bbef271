"""Puts parts (one mesh each, with material and building) together into a City with merged facets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cellslam.sim.city.city import TOLERANCES, City, Floats, Ints, Material, Tolerances
from cellslam.sim.city.facets import merge_facets
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from shapely import Polygon


@dataclass(frozen=True)
class Part:
    """One object of one material: `vertices` (V, 3) in metres, `triangles` (K, 3), building or -1, ground."""

    vertices: Floats
    triangles: Ints
    material: int
    building: int


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
    sizes = [len(part.vertices) for part in parts]
    counts = [len(part.triangles) for part in parts]
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    vertices = np.concatenate([part.vertices for part in parts]).astype(np.float64)
    triangles = np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=True)]).astype(
        np.int64
    )
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
