"""Edges of buildings that diffract: where two facets meet and bulge outwards, or where a facet ends.

Source: own derivation; what is computed at them, ITU-R P.526-15, section 4.1 (docs/explanation/rays.md).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import GROUND, City, Floats, Ints
from cellslam.sim.city.facets import weld
from cellslam.sim.city.inside import OUTSIDE, enclosing

# An edge between facets that meet at an angle flatter than this is none.
FLAT_DEG = 10.0
PROBE_M = 0.02


@dataclass(frozen=True)
class Edges:
    """Straight edges (E,), centred coordinates: `start` (E, 3), unit `along` (E, 3), `length_m` (E,).

    `into` (E, 2, 3): unit vectors in the two facets, away from the edge and at right angles to it; the second one is
    NaN where a facet ends freely. `facets` (E, 2): which facets meet, -1 none.
    """

    start: Floats
    along: Floats
    length_m: Floats
    into: Floats
    facets: Ints

    def __len__(self) -> int:
        return len(self.length_m)


def find_edges(city: City, origin_m: Floats) -> Edges:
    """Return the diffracting edges of a city, relative to `origin_m` (3,), in m.

    Concave corners may be among them: they see both ends inside.

    Left out: ground, seams within a facet, nearly flat seams, lower rims of walls, and edges where another building
    adjoins.
    """
    rows = np.flatnonzero(city.facets.building[city.triangle_facet] != GROUND)
    triangles = city.triangles[rows]
    facet = city.triangle_facet[rows]
    owner = np.zeros(len(city.vertices), np.int64)
    owner[triangles] = city.facets.building[facet][:, None] + 1
    label = weld(city.vertices, owner)
    ends = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    third = triangles[:, [2, 0, 1]].reshape(-1)
    key = np.sort(label[ends], axis=1)
    usable = np.flatnonzero((key[:, 0] != key[:, 1]) & (np.repeat(city.facets.area_m2[facet], 3) > 0.0))
    side = np.column_stack([key, np.repeat(facet, 3)])[usable]
    _, first, uses = np.unique(side, axis=0, return_index=True, return_counts=True)
    # A facet's own seam has the facet on both sides.
    rim = usable[first[uses == 1]]
    rim = rim[np.lexsort((key[rim, 1], key[rim, 0]))]
    new = np.r_[True, (np.diff(key[rim], axis=0) != 0).any(axis=1)][: len(rim)]
    begin = np.flatnonzero(new)
    count = np.diff(np.r_[begin, len(rim)])
    edges = _edges(city, origin_m, ends, third, np.repeat(facet, 3), rim, begin[count <= 2], count[count <= 2])
    kept = _diffracts(city, origin_m, edges)
    return Edges(*(getattr(edges, column.name)[kept] for column in fields(Edges)))


def _edges(
    city: City, origin_m: Floats, ends: Ints, third: Ints, facet: Ints, rim: Ints, begin: Ints, count: Ints
) -> Edges:
    """Build the edges whose one or two sides start at `begin` in `rim`."""
    one = rim[begin]
    other = rim[np.minimum(begin + 1, len(rim) - 1)]
    start = city.vertices[ends[one, 0]] - origin_m
    along = city.vertices[ends[one, 1]] - origin_m - start
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    into = np.full((len(one), 2, 3), np.nan)
    for column, sides in enumerate((one, other)):
        away = city.vertices[third[sides]] - origin_m - start
        away -= np.einsum("ei,ei->e", away, along)[:, None] * along
        into[:, column] = away / np.maximum(np.linalg.norm(away, axis=1), 1e-12)[:, None]
    into[count == 1, 1] = np.nan
    facets = np.column_stack([facet[one], np.where(count == 2, facet[other], -1)])
    return Edges(start, along, length, into, facets)


def _diffracts(city: City, origin_m: Floats, edges: Edges) -> NDArray[np.bool_]:
    """Tell the edges that stand free and are not flat."""
    cosine = np.einsum("ei,ei->e", edges.into[:, 0], edges.into[:, 1])
    open_edge = edges.facets[:, 1] < 0
    kept = open_edge | (cosine > -np.cos(np.radians(FLAT_DEG)))
    # The lower rim of a wall stands on the ground.
    kept &= ~(open_edge & (np.abs(edges.along[:, 2]) < 0.1) & (edges.into[:, 0, 2] > 0.5))
    middle = edges.start + 0.5 * edges.length_m[:, None] * edges.along + origin_m
    for own, far in ((0, 1), (1, 0)):
        a, b = edges.into[:, own], edges.into[:, far]
        outward = -(b - np.einsum("ei,ei->e", a, b)[:, None] * a)
        outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
        probe = middle + PROBE_M * (a + outward)
        rows = np.flatnonzero(kept & ~open_edge)
        kept[rows[enclosing(city, probe[rows]) != OUTSIDE]] = False
    return np.asarray(kept, np.bool_)
