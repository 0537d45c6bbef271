"""Compiled search for second-order specular points: pairs of facets, then the image method twice.

Source: image method as in `first_order_kernel`; culls per pair: own derivation, docs/explanation/rays.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.rays.first_order_kernel import (
    INSIDE_M,
    Array,
    Box,
    FacetTable,
    Images,
    bounds,
    hit,
    overlaps,
    point_on,
    reaches,
    shadow,
)

GROUP = 16  # facets that are culled together


@part
def _beam_reaches(table: Array, images: Images, a: int, b: int, again: Any, box: Box) -> bool:
    """Tell whether the box may be illuminated over the facets a and then b.

    The box is projected from the second image `again` (u, v, distance, side) onto facet b, what that leaves of b's box
    from the first image onto facet a; each step can only be too large.
    """
    row = table[b]
    lu, hu, lv, hv = shadow(row, again, again[3], box)
    if lu == -np.inf:
        return True  # the box crosses the plane of b
    lu, hu = max(lu, row[10]) - INSIDE_M, min(hu, row[11]) + INSIDE_M
    lv, hv = max(lv, row[12]) - INSIDE_M, min(hv, row[13]) + INSIDE_M
    if lu > hu or lv > hv:
        return False
    other, image, side = table[a], images.image[a], images.side[a]
    lp, hp, lq, hq = np.inf, -np.inf, np.inf, -np.inf
    behind = 0
    for corner in range(4):
        u = hu if corner & 1 else lu
        v = hv if corner & 2 else lv
        x, y, z = point_on(table, b, u, v)
        d = side * (other[0] * x + other[1] * y + other[2] * z - other[3])
        if d <= 0.0:
            behind += 1
            continue
        t = image[2] / (image[2] + d)
        p = image[0] + t * (other[4] * x + other[5] * y + other[6] * z - image[0])
        q = image[1] + t * (other[7] * x + other[8] * y + other[9] * z - image[1])
        lp, hp, lq, hq = min(lp, p), max(hp, p), min(lq, q), max(hq, q)
    if behind:
        return behind < 4  # where the window crosses the plane it is not projected
    return overlaps(other, lp, hp, lq, hq)


@njit(cache=True)
def facet_pairs(
    table: Array, boxes: Array, order: Array, groups: Array, first: Array, images: Images, mirrored: Array, around: Box,
    pairs: Array, second: Array,
) -> int:  # fmt: skip
    """Write the pairs of facets that may carry a path; return their number, which may exceed the room.

    `boxes` (F, 6): centre and half size of each facet in m; `order` (R,): the facets that reflect, neighbours together;
    `groups` (G, 6): boxes of each `GROUP` of them; `first` (L,): facets that the transmitter sees; `mirrored` (F, 3):
    the transmitter's image in each facet, m; `around`: box of all receivers. Written per pair: `pairs` (P, 2) first and
    second facet, `second` (P, 4): u, v, distance of the first image in the second facet's coordinates, and its side.
    """
    total = 0
    for a in first:
        row, image, side = table[a], images.image[a], images.side[a]
        ix, iy, iz = mirrored[a, 0], mirrored[a, 1], mirrored[a, 2]
        for g in range(len(groups)):
            if not reaches(row, image, side, _box(groups[g])):
                continue
            for b in order[g * GROUP : (g + 1) * GROUP]:
                other, box = table[b], _box(boxes[b])
                d = other[0] * ix + other[1] * iy + other[2] * iz - other[3]
                if b == a or abs(d) <= INSIDE_M or not _ahead(row, side, box) or not reaches(row, image, side, box):
                    continue
                u = other[4] * ix + other[5] * iy + other[6] * iz
                v = other[7] * ix + other[8] * iy + other[9] * iz
                again = (u, v, abs(d), 1.0 if d > 0.0 else -1.0)
                if not _beam_reaches(table, images, a, b, again, around):
                    continue
                if total < len(pairs):
                    pairs[total, 0], pairs[total, 1] = a, b
                    second[total, 0], second[total, 1], second[total, 2], second[total, 3] = again
                total += 1
    return total


@part
def _box(row: Array) -> Box:
    return Box(row[0], row[1], row[2], row[3], row[4], row[5])


@part
def _ahead(row: Array, side: float, box: Box) -> bool:
    """Tell whether the box stands before the plane of a facet, in part by more than a micrometre."""
    middle = side * (row[0] * box.x + row[1] * box.y + row[2] * box.z - row[3])
    return bool(middle + abs(row[0]) * box.hx + abs(row[1]) * box.hy + abs(row[2]) * box.hz > INSIDE_M)


@njit(cache=True)
def windows(table: Array, images: Images, mirrored: Array, pairs: Array, part: Array, start: Array, end: Array) -> None:
    """Write what two legs of each pair may use: four corners each, seen from a point, in m.

    `part` (P, 4, 3): the rectangle of the first facet through which its image sees the second facet's box; `start` and
    `end` (P, 4, 3): the corners of the second facet's box, and where their lines to the image meet the first facet's
    plane. Where the box is not wholly in front of that plane, `part` is the first facet's own box and `start` NaN.
    """
    for p in range(len(pairs)):
        a, b = pairs[p, 0], pairs[p, 1]
        row, other = table[a], table[b]
        lu, hu, lv, hv = np.inf, -np.inf, np.inf, -np.inf
        ahead = True
        for corner in range(4):
            u = other[11] if corner == 1 or corner == 2 else other[10]
            v = other[13] if corner >= 2 else other[12]
            x, y, z = point_on(table, b, u, v)
            end[p, corner, 0], end[p, corner, 1], end[p, corner, 2] = x, y, z
            d = images.side[a] * (row[0] * x + row[1] * y + row[2] * z - row[3])
            if d <= INSIDE_M:
                ahead = False
                continue
            t = images.image[a, 2] / (images.image[a, 2] + d)
            for axis in range(3):
                start[p, corner, axis] = mirrored[a, axis] + t * (end[p, corner, axis] - mirrored[a, axis])
            u = images.image[a, 0] + t * (row[4] * x + row[5] * y + row[6] * z - images.image[a, 0])
            v = images.image[a, 1] + t * (row[7] * x + row[8] * y + row[9] * z - images.image[a, 1])
            lu, hu, lv, hv = min(lu, u), max(hu, u), min(lv, v), max(hv, v)
        lu, hu, lv, hv = max(lu, row[10]), min(hu, row[11]), max(lv, row[12]), min(hv, row[13])
        if not ahead:
            lu, hu, lv, hv = row[10], row[11], row[12], row[13]
            start[p] = np.nan
        for corner in range(4):
            u = hu if corner == 1 or corner == 2 else lu
            v = hv if corner >= 2 else lv
            part[p, corner, 0], part[p, corner, 1], part[p, corner, 2] = point_on(table, a, u, v)


@part
def _cull(
    table: Array, images: Images, pairs: Array, second: Array, box: Box, members: Array, count: int, kept: Array
) -> int:
    """Write into `kept` those of `members[:count]` that a receiver in the box can meet; return how many."""
    found = 0
    for i in range(count):
        e = members[i]
        if _beam_reaches(table, images, pairs[e, 0], pairs[e, 1], second[e], box):
            kept[found] = e
            found += 1
    return found


@njit(cache=True)
def second_candidates(
    facets: FacetTable, images: Images, pairs: Array, second: Array, receivers: Array, blocks: Array, found: Array,
    points: Array,
) -> int:  # fmt: skip
    """Write the double reflections of all receivers (N, 3), in m; return how many, which may exceed the room.

    `pairs` (P, 2) and `second` (P, 4) as `facet_pairs` writes them; `blocks` (B,): successive receivers that are culled
    together, each a divisor of the one before. Written per candidate: `found` (n, 2) receiver and pair, `points`
    (n, 2, 3) in m, from the transmitter on.
    """
    table = facets.table
    # Of each level of blocks, the pairs that are left, and their number.
    near = np.full(len(blocks) + 1, len(pairs))
    work = np.empty((len(blocks) + 1, len(pairs)), np.int64)
    work[0] = np.arange(len(pairs))
    total = 0
    for begin in range(0, len(receivers), blocks[-1]):
        for level in range(len(blocks)):
            if begin % blocks[level] == 0:
                box = bounds(receivers, begin, min(begin + blocks[level], len(receivers)))
                near[level + 1] = _cull(table, images, pairs, second, box, work[level], near[level], work[level + 1])
        for r in range(begin, min(begin + blocks[-1], len(receivers))):
            for e in work[-1, : near[-1]]:
                a, b = pairs[e, 0], pairs[e, 1]
                x, y, z = receivers[r, 0], receivers[r, 1], receivers[r, 2]
                d, u, v = hit(facets, b, second, e, second[e, 3], x, y, z)
                if d < 0.0:
                    continue
                x, y, z = point_on(table, b, u, v)
                d, u, v = hit(facets, a, images.image, a, images.side[a], x, y, z)
                if d < 0.0:
                    continue
                if total < len(found):
                    found[total, 0], found[total, 1] = r, e
                    points[total, 0, 0], points[total, 0, 1], points[total, 0, 2] = point_on(table, a, u, v)
                    points[total, 1, 0], points[total, 1, 1], points[total, 1, 2] = x, y, z
                total += 1
    return total
