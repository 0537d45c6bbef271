"""Compiled growth of planar facets over triangles that touch."""

from __future__ import annotations

import numpy as np

from cellslam.sim.city.city import Floats, Ints
from cellslam.sim.compiling import njit


@njit(cache=True)
def grow_facets(
    seeds: Ints, corners: Floats, normals: Floats, first: Ints, neighbours: Ints, distance_tolerance_m: float,
    cos_tolerance: float, label: Ints,
) -> int:  # fmt: skip
    """Write into `label` (K,) the facet of each triangle and return the number of facets.

    `seeds` (K,) orders the triangles, largest first; `corners` (K, 3, 3) in m; `normals` (K, 3); triangle k
    touches `neighbours[first[k]:first[k + 1]]`. A neighbour joins if it has the seed's orientation up to sign
    and all its corners lie near the seed's plane.
    """
    label[:] = -1
    stack = np.empty(len(seeds), np.int64)
    count = 0
    for seed in seeds:
        if label[seed] >= 0:
            continue
        nx, ny, nz = normals[seed, 0], normals[seed, 1], normals[seed, 2]
        cx = (corners[seed, 0, 0] + corners[seed, 1, 0] + corners[seed, 2, 0]) / 3.0
        cy = (corners[seed, 0, 1] + corners[seed, 1, 1] + corners[seed, 2, 1]) / 3.0
        cz = (corners[seed, 0, 2] + corners[seed, 1, 2] + corners[seed, 2, 2]) / 3.0
        label[seed] = count
        stack[0] = seed
        size = 1
        while size > 0:
            size -= 1
            current = stack[size]
            for position in range(first[current], first[current + 1]):
                other = neighbours[position]
                if label[other] >= 0:
                    continue
                cosine = normals[other, 0] * nx + normals[other, 1] * ny + normals[other, 2] * nz
                if abs(cosine) < cos_tolerance:
                    continue
                near = True
                for i in range(3):
                    away = (
                        (corners[other, i, 0] - cx) * nx
                        + (corners[other, i, 1] - cy) * ny
                        + (corners[other, i, 2] - cz) * nz
                    )
                    if abs(away) > distance_tolerance_m:
                        near = False
                if near:
                    label[other] = count
                    stack[size] = other
                    size += 1
        count += 1
    return count
