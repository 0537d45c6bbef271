"""Networks of ways: the middle of what buildings leave free, for files without streets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from shapely import Polygon

from cellslam.sim.city.city import Floats
from cellslam.sim.city.facets import connected

CLEAR_M = 3.0  # between a drawn way and the next wall, at the least
AROUND_M = 30.0  # from the outermost walls to a fence, along which ways lead around the city
STEP_M = 2.0  # between the points of outlines
SMOOTH_M = 1.0


def ways_between(footprints: Sequence[Polygon]) -> list[Floats]:
    """Return centre lines (n, 2) in m that keep the same distance from two blocks of buildings, all connected.

    They are edges of the Voronoi diagram of points on the blocks' outlines.
    """
    from scipy.spatial import Voronoi

    blocks = shapely.get_parts(shapely.union_all(shapely.buffer(footprints, CLEAR_M, quad_segs=2)))
    fence = shapely.box(*shapely.total_bounds(blocks)).buffer(AROUND_M, join_style="mitre")
    outlines = shapely.segmentize(shapely.get_exterior_ring([*blocks, fence]), STEP_M)
    points, block = shapely.get_coordinates(outlines, return_index=True)
    middle = points.mean(axis=0)
    diagram = Voronoi(points - middle)
    between = block[diagram.ridge_points[:, 0]] != block[diagram.ridge_points[:, 1]]
    ridges = np.array(diagram.ridge_vertices)[between & (np.min(diagram.ridge_vertices, axis=1) >= 0)]
    edges = shapely.linestrings(diagram.vertices[ridges] + middle)
    edges = edges[shapely.covered_by(edges, fence) & ~shapely.intersects(edges, shapely.union_all(blocks))]
    lines = shapely.get_parts(shapely.line_merge(shapely.union_all(edges, grid_size=0.01)))
    return largest_network([shapely.get_coordinates(line) for line in shapely.simplify(lines, SMOOTH_M)])


def largest_network(lines: Sequence[Floats]) -> list[Floats]:
    """Return the longest connected part of lines (n, 2) that share their ends."""
    if not lines:
        return []
    ends, end = np.unique([line[k] for line in lines for k in (0, -1)], axis=0, return_inverse=True)
    pairs = end.reshape(-1, 2)
    network = connected(pairs, len(ends))[pairs[:, 0]]
    length = np.bincount(network, [np.hypot(*np.diff(line, axis=0).T).sum() for line in lines])
    return [line for line, own in zip(lines, network, strict=True) if own == np.argmax(length)]
