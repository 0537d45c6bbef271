"""From a soup of triangles to planar facets: weld, connect, grow, and fit one plane to each."""

from __future__ import annotations

import numpy as np

from cellslam.sim.city.city import Facets, Floats, Ints, Tolerances

WELD_M = 1e-4  # vertices of one object that are as close are one
# Below this height over its longest side a triangle has no usable normal; it still casts a shadow.
SLIVER_M = 1e-6


def weld(vertices: Floats, part: Ints) -> Ints:
    """Return labels (V,) of vertices (V, 3) of object `part` (V,): close ones of one object share theirs."""
    from scipy.spatial import cKDTree

    # Objects are set apart in a fourth dimension; exact copies go first, or pairs among them would explode.
    spread = np.column_stack([vertices - vertices.mean(axis=0), part * (10.0 * WELD_M)])
    _, unique, inverse = np.unique(np.round(spread / (WELD_M * 1e-2)), axis=0, return_index=True, return_inverse=True)
    pairs = cKDTree(spread[unique]).query_pairs(WELD_M, output_type="ndarray")
    return connected(pairs, len(unique))[inverse.ravel()]


def connected(pairs: Ints, count: int) -> Ints:
    """Return a label (count,) for each of so many items: those that pairs (P, 2) of them connect share theirs."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def edge_neighbours(triangles: Ints, group: Ints) -> tuple[Ints, Ints]:
    """Return (first (K + 1,), neighbours): triangles of the same group that share an edge with each.

    `triangles` (K, 3) hold welded labels; `group` (K,) separates what never joins. An edge with many
    triangles links them in a chain through all of them.
    """
    count = len(triangles)
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(count), 3)
    key = np.column_stack([ends, np.repeat(group, 3)])
    _, edge = np.unique(key, axis=0, return_inverse=True)
    edge = edge.ravel()
    order = np.argsort(edge, kind="stable")
    start = np.flatnonzero(np.r_[True, np.diff(edge[order]) > 0])
    sizes = np.diff(np.r_[start, len(order)])
    left, right = [], []
    # Edges of more than two triangles (fins, copies): link every pair within a bounded window.
    for step in range(1, int(min(sizes.max(initial=1), 9))):
        same = edge[order[:-step]] == edge[order[step:]]
        left.append(owner[order[:-step][same]])
        right.append(owner[order[step:][same]])
    a, b = (np.concatenate([np.empty(0, np.int64), *ends]) for ends in ((*left, *right), (*right, *left)))
    by_owner = np.argsort(a, kind="stable")
    return np.searchsorted(a[by_owner], np.arange(count + 1)).astype(np.int64), b[by_owner]


def triangle_normals(corners: Floats) -> tuple[Floats, Floats]:
    """Return unit normals (K, 3) and areas in m^2 (K,) of triangles (K, 3, 3); a sliver has a zero normal."""
    edges = corners - np.roll(corners, -1, axis=1)
    longest = np.sqrt((edges**2).sum(axis=2).max(axis=1, initial=0.0))
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    solid = length > SLIVER_M * np.maximum(longest, SLIVER_M)
    normals = np.divide(cross, length[:, None], out=np.zeros_like(cross), where=solid[:, None])
    return normals, np.where(solid, 0.5 * length, 0.0)


def merge_facets(
    vertices: Floats, triangles: Ints, part: Ints, material: Ints, building: Ints, tolerances: Tolerances
) -> tuple[Ints, Facets]:
    """Return (triangle_facet (K,), facets) of triangles that touch, lie in one plane and belong together.

    `vertices` (V, 3) in m; `triangles` (K, 3); `part`, `material`, `building` (K,): object, material and building
    of each triangle. `tolerances` are measured from the plane of the largest triangle of each facet.
    """
    from cellslam.sim.city.facets_kernel import grow_facets

    centred = vertices - vertices.mean(axis=0)
    corners = centred[triangles]
    normals, area = triangle_normals(corners)
    vertex_part = np.zeros(len(vertices), np.int64)
    vertex_part[triangles] = part[:, None]
    group = part * (material.max(initial=0) + 1) + material
    first, neighbours = edge_neighbours(weld(vertices, vertex_part)[triangles], group)
    label = np.empty(len(triangles), np.int64)
    # Rounded areas: the order must not hang on the last bit, which a translation of the city would change.
    seeds = np.argsort(-np.round(area, 6), kind="stable")
    count = grow_facets(
        seeds, corners, normals, first, neighbours, tolerances.plane_m, np.cos(np.radians(tolerances.angle_deg)), label
    )
    return label, _fit(vertices.mean(axis=0), corners, normals, area, label, count, seeds, material, building)


def _fit(
    origin: Floats, corners: Floats, normals: Floats, area: Floats, label: Ints, count: int, seeds: Ints,
    material: Ints, building: Ints,
) -> Facets:  # fmt: skip
    """Fit each facet's plane: area-weighted mean of its triangles' normals and centroids."""
    reverse = seeds[::-1]
    seed = np.empty(count, np.int64)
    seed[label[reverse]] = reverse
    sign = np.where(np.einsum("ki,ki->k", normals, normals[seed[label]]) < 0.0, -1.0, 1.0)
    weight = np.maximum(area, 1e-300)
    total = np.bincount(label, weight, count)
    normal = np.stack([np.bincount(label, weight * sign * normals[:, i], count) for i in range(3)], axis=1)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.tile([0.0, 0.0, 1.0], (count, 1)), where=length > 0.0)
    middle = corners.mean(axis=1)
    centroid = np.stack([np.bincount(label, weight * middle[:, i], count) for i in range(3)], axis=1) / total[:, None]
    offset = np.einsum("fi,fi->f", normal, centroid)
    away = np.abs(np.einsum("kci,ki->kc", corners, normal[label]) - offset[label][:, None]).max(axis=1)
    planarity = np.zeros(count)
    np.maximum.at(planarity, label, away)
    return Facets(
        normal=normal,
        offset=offset + normal @ origin,
        area_m2=np.bincount(label, area, count).astype(np.float64),
        material=material[seed],
        building=building[seed],
        planarity_m=planarity,
    )
