"""What tracing needs of a city, built once: centred facet tables in float64, an embree tree in float32.

Source: own derivation; why it is centred, and where shadow rays end: docs/explanation/rays.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import GROUND, City, Floats, Ints
from cellslam.sim.described import Described

if TYPE_CHECKING:
    from cellslam.sim.rays.diffracting_edges import Edges

# Shadow rays end this far from a wall's plane; float32 would hit the wall itself at less.
CLEARANCE_M = 1e-3
CONVEX_SHARE = 1e-6


@dataclass(frozen=True, repr=False)
class Scene(Described):
    """A prepared city. All coordinates are relative to `origin_m` (3,), the middle of the city's bounds.

    `table` (F, 14): normal, offset, two unit vectors in the plane, and the facet's box in these two coordinates
    (low u, high u, low v, high v); facet f has the triangles `first[f]:first[f + 1]` of `outline` (K, 6) (u, v of
    three corners); `boxes` (F, 6): each facet's centre and half size; `clearance_m` (F,): how far from its plane
    shadow rays end; `reflects` (F,): it has an area and is not ground.
    """

    city: City
    origin_m: Floats
    table: Floats
    boxes: Floats
    first: Ints
    outline: Floats
    clearance_m: Floats
    reflects: NDArray[np.bool_]
    corners: Floats
    embree: Any

    @cached_property
    def convex(self) -> NDArray[np.bool_]:
        """Which facets (F,) fill their convex hull."""
        import shapely

        flat = self.outline.reshape(-1, 3, 2)
        a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
        facet = np.repeat(np.arange(len(self.table)), np.diff(self.first))
        area = np.bincount(facet, np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2.0, len(self.table))
        hull = shapely.area(shapely.convex_hull(shapely.multipoints(flat.reshape(-1, 2), indices=np.repeat(facet, 3))))
        return np.asarray(hull - area <= CONVEX_SHARE * hull, np.bool_)

    @cached_property
    def edges(self) -> Edges:
        """The edges that diffract; found when first asked for."""
        from cellslam.sim.rays.diffracting_edges import find_edges

        return find_edges(self.city, self.origin_m)


def prepare(city: City) -> Scene:
    """Return the scene of a city. Takes well under a second for 50 000 triangles."""
    origin = city.bounds.mean(axis=0)
    facets = city.facets
    corners = city.vertices[city.triangles] - origin
    offset = facets.offset - facets.normal @ origin
    u, v = plane_basis(facets.normal)
    order = np.argsort(city.triangle_facet, kind="stable")
    facet = city.triangle_facet[order]
    first = np.searchsorted(facet, np.arange(len(facets) + 1)).astype(np.int64)
    flat = np.stack([np.einsum("kci,ki->kc", corners[order], axis[facet]) for axis in (u, v)], axis=2)
    low, high = flat.min(axis=1), flat.max(axis=1)
    box = np.stack(
        [f.reduceat(side[:, i], first[:-1]) for i in (0, 1) for f, side in ((np.minimum, low), (np.maximum, high))]
    )
    corner_low, corner_high = corners[order].min(axis=1), corners[order].max(axis=1)
    lower = np.minimum.reduceat(corner_low, first[:-1], axis=0)
    upper = np.maximum.reduceat(corner_high, first[:-1], axis=0)
    radius = float(np.abs(corners).max())
    return Scene(
        city=city,
        origin_m=origin,
        table=np.ascontiguousarray(np.column_stack([facets.normal, offset, u, v, box.T])),
        boxes=np.ascontiguousarray(np.column_stack([(lower + upper) / 2, (upper - lower) / 2])),
        first=first,
        outline=np.ascontiguousarray(flat.reshape(-1, 6)),
        clearance_m=CLEARANCE_M + 2.0 * facets.planarity_m + 4.0 * np.finfo(np.float32).eps * radius,
        reflects=(facets.area_m2 > 0.0) & (facets.building != GROUND),
        corners=np.ascontiguousarray(corners),
        embree=_embree(corners),
    )


def plane_basis(normal: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors u, v (F, 3) with u x v = normal, chosen by the normal alone."""
    steep = np.abs(normal[:, 2]) > 0.9
    helper = np.where(steep[:, None], [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    u = np.cross(helper, normal)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(normal, u)


def _embree(corners: Floats) -> Any:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    # The mesh must outlive the call; embree holds no reference to it.
    mesh = TriangleMesh(scene, np.ascontiguousarray(corners, dtype=np.float32))
    return scene, mesh
