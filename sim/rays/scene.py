"""What tracing needs of a city, built once: centred facet tables in float64, an embree tree in float32.

Source: own derivation; why it is centred, and where shadow rays end: docs/explanation/rays.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import GROUND, City, Floats, Ints
from cellslam.sim.described import Described
from cellslam.sim.rays.diffracting_edges import Edges, find_edges

# Shadow rays end this far from a wall's plane; float32 would hit the wall itself at less.
CLEARANCE_M = 1e-3
# A corner counts as hidden if what hides it stands at least this far in front of it.
HIDDEN_M = 0.01
CONVEX_SHARE = 1e-6


@dataclass(frozen=True, repr=False)
class Scene(Described):
    """A prepared city. All coordinates are relative to `origin_m` (3,), the middle of the city's bounds.

    `table` (F, 14): normal, offset, two unit vectors in the plane, and the facet's box in these two coordinates
    (low u, high u, low v, high v); facet f has the triangles `first[f]:first[f + 1]` of `outline` (K, 6) (u, v of
    three corners); `boxes` (F, 6): each facet's centre and half size; `clearance_m` (F,): how far from its plane
    shadow rays end; `reflects` (F,): it has an area and is not ground; `corners` (K, 3, 3): of the city's triangles.
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
    def planes(self) -> Floats:
        """Normal, offset and unit vectors of the facets (10, F): columns of `table`, quicker to go through as rows."""
        return np.ascontiguousarray(self.table[:, :10].T)

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
        return find_edges(self.city, self.origin_m)

    def unobstructed(self, origins: Floats, targets: Floats, reach: Floats) -> NDArray[np.bool_]:
        """Tell of rays (N, 3) -> (N, 3), centred coordinates in m, if their first `reach` (N,), 0 to 1, is free."""
        return np.asarray(self._cast(origins, targets, reach, "OCCLUDED") == -1, np.bool_)

    def first_hits(self, origins: Floats, targets: Floats, reach: Floats) -> Ints:
        """Return the index of the triangle that each of these rays meets first within its `reach`, -1 none."""
        return self._cast(origins, targets, reach, "INTERSECT")

    def free(self, start_m: Floats, end_m: Floats) -> NDArray[np.bool_]:
        """Return whether no building is between points (n, 3) and (n, 3) of the world, in m; the last millimetre is
        left out."""
        away = np.linalg.norm(end_m - start_m, axis=1)
        reach = np.maximum(1.0 - CLEARANCE_M / np.maximum(away, CLEARANCE_M), 0.0)
        return self.unobstructed(start_m - self.origin_m, end_m - self.origin_m, reach)

    def _cast(
        self, origins: Floats, targets: Floats, reach: Floats, query: Literal["OCCLUDED", "INTERSECT"]
    ) -> NDArray[np.int64]:
        if not len(origins):
            return np.empty(0, np.int64)
        rays = (np.ascontiguousarray(part, np.float32) for part in (origins, targets - origins, reach))
        start, direction, share = rays
        return np.asarray(self.embree[0].run(start, direction, dists=share, query=query), np.int64)

    def illuminated_facets(self, transmitter: Floats, reflects: NDArray[np.bool_]) -> Ints:
        """Return the facets (L,) of which the transmitter (3,), centred, in m, may see a part; none is missing."""
        rows = np.flatnonzero(reflects)
        table = self.table[rows]
        u, v = table[:, [10, 11, 11, 10]], table[:, [12, 12, 13, 13]]
        corners = u[:, :, None] * table[:, None, 4:7] + v[:, :, None] * table[:, None, 7:10]
        corners += (table[:, 3:4] * table[:, :3])[:, None]
        height = np.abs(table[:, :3] @ transmitter - table[:, 3])
        clearance = self.clearance_m[rows] / np.maximum(height, 1e-12)
        start = np.broadcast_to(transmitter, corners.shape)
        return np.asarray(rows[~self.hidden(start, corners, np.repeat(clearance, 4))], np.int64)

    def hidden(self, origins: Floats, targets: Floats, clearance: Floats | float = 0.0) -> NDArray[np.bool_]:
        """Tell which windows (N, 4, 3) stand wholly behind one convex facet, as seen from a point.

        The rays `origins` -> `targets` lie on lines through that point. If all four end on one convex facet before they
        reach the window, so do all between them: no window of which a part is seen counts as hidden. What hides
        it meets the rays before the last centimetre and the last share `clearance` (4 N,) of them.
        """
        away = (targets - origins).reshape(-1, 3)
        last = np.maximum(HIDDEN_M / np.maximum(np.linalg.norm(away, axis=1), HIDDEN_M), clearance)
        reach = np.maximum(1.0 - last, 0.0)
        triangle = self.first_hits(origins.reshape(-1, 3), targets.reshape(-1, 3), reach)
        by = np.where(triangle >= 0, self.city.triangle_facet[triangle], -1).reshape(-1, 4)
        return np.asarray((by[:, 0] >= 0) & (by == by[:, :1]).all(axis=1) & self.convex[by[:, 0]], np.bool_)


def prepare(city: City) -> Scene:
    """Return the scene of a city. Takes well under a second for 50 000 triangles."""
    origin = city.bounds.mean(axis=0)
    facets = city.facets
    corners = city.vertices[city.triangles] - origin
    offset = facets.offset - facets.normal @ origin
    u, v = _plane_basis(facets.normal)
    order = np.argsort(city.triangle_facet, kind="stable")
    facet = city.triangle_facet[order]
    first = np.searchsorted(facet, np.arange(len(facets) + 1)).astype(np.int64)
    flat = np.stack([np.einsum("kci,ki->kc", corners[order], axis[facet]) for axis in (u, v)], axis=2)
    low, high = np.minimum.reduceat(flat.min(axis=1), first[:-1]), np.maximum.reduceat(flat.max(axis=1), first[:-1])
    lower = np.minimum.reduceat(corners[order].min(axis=1), first[:-1])
    upper = np.maximum.reduceat(corners[order].max(axis=1), first[:-1])
    radius = float(np.abs(corners).max())
    box = (low[:, 0], high[:, 0], low[:, 1], high[:, 1])
    return Scene(
        city=city,
        origin_m=origin,
        table=np.ascontiguousarray(np.column_stack([facets.normal, offset, u, v, *box])),
        boxes=np.ascontiguousarray(np.column_stack([(lower + upper) / 2, (upper - lower) / 2])),
        first=first,
        outline=np.ascontiguousarray(flat.reshape(-1, 6)),
        clearance_m=CLEARANCE_M + 2.0 * facets.planarity_m + 4.0 * np.finfo(np.float32).eps * radius,
        reflects=(facets.area_m2 > 0.0) & (facets.building != GROUND),
        corners=np.ascontiguousarray(corners),
        embree=_embree(corners),
    )


def _plane_basis(normal: Floats) -> tuple[Floats, Floats]:
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
