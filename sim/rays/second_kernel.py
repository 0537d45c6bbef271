"""Compiled search for second-order specular points: pairs of facets, then the image method twice."""

from __future__ import annotations

import numpy as np
from numba import njit

from cellslam.sim.rays.kernel import INSIDE_M, _inside, _reaches


@njit(cache=True)
def sample_points(table, first, outline, reflects, step, owner, points):  # type: ignore[no-untyped-def]
    """Write points (3,) on every reflecting facet and its index; return their number, which may exceed the room.

    A grid no wider than `step` over the facet's box, at least three by three, and each triangle's centroid.
    """
    total = 0
    for f in range(len(table)):
        if not reflects[f]:
            continue
        row = table[f]
        across = max(3, int(np.ceil((row[11] - row[10]) / step)))
        up = max(3, int(np.ceil((row[13] - row[12]) / step)))
        triangles = first[f + 1] - first[f]
        for i in range(across * up + triangles):
            if i < triangles:
                k = first[f] + i
                u = (outline[k, 0] + outline[k, 2] + outline[k, 4]) / 3.0
                v = (outline[k, 1] + outline[k, 3] + outline[k, 5]) / 3.0
            else:
                cell = i - triangles
                u = row[10] + (cell % across + 0.5) * (row[11] - row[10]) / across
                v = row[12] + (cell // across + 0.5) * (row[13] - row[12]) / up
                if not _inside(outline, first[f], first[f + 1], u, v):
                    continue
            if total < len(owner):
                owner[total] = f
                for axis in range(3):
                    points[total, axis] = u * row[4 + axis] + v * row[7 + axis] + row[3] * row[axis]
            total += 1
    return total


@njit(cache=True)
def facet_pairs(table, boxes, reflects, lit, image, side, mirrored, around, pairs, second):  # type: ignore[no-untyped-def]
    """Write the pairs of facets that may carry a path; return their number, which may exceed the room.

    `boxes` (F, 6): centre and half size of each facet; `lit` (L,): facets that the transmitter sees; `image` (F, 3) and
    `side` (F,) as `kernel.images` writes them; `mirrored` (F, 3): the transmitter's image in each facet; `around` (6,):
    box of all receivers. Written per pair: `pairs` (first, second facet), `second`: (u, v, distance) of the first
    image in the second facet's coordinates, and its side.
    """
    total = 0
    x, y, z, hx, hy, hz = around[0], around[1], around[2], around[3], around[4], around[5]
    for a in lit:
        row = table[a]
        for b in range(len(table)):
            if b == a or not reflects[b]:
                continue
            ahead = side[a] * (row[0] * boxes[b, 0] + row[1] * boxes[b, 1] + row[2] * boxes[b, 2] - row[3])
            reach = abs(row[0]) * boxes[b, 3] + abs(row[1]) * boxes[b, 4] + abs(row[2]) * boxes[b, 5]
            if ahead + reach <= INSIDE_M:
                continue
            other = table[b]
            ix, iy, iz = mirrored[a, 0], mirrored[a, 1], mirrored[a, 2]
            d = other[0] * ix + other[1] * iy + other[2] * iz - other[3]
            if abs(d) <= INSIDE_M:
                continue
            if not _reaches(
                row, image[a], side[a], boxes[b, 0], boxes[b, 1], boxes[b, 2], boxes[b, 3], boxes[b, 4], boxes[b, 5]
            ):
                continue
            s = 1.0 if d > 0.0 else -1.0
            again = (
                other[4] * ix + other[5] * iy + other[6] * iz,
                other[7] * ix + other[8] * iy + other[9] * iz,
                abs(d),
            )
            if not _reaches(other, again, s, x, y, z, hx, hy, hz):
                continue
            if total < len(pairs):
                pairs[total, 0] = a
                pairs[total, 1] = b
                second[total, 0], second[total, 1], second[total, 2] = again
                second[total, 3] = s
            total += 1
    return total


@njit(cache=True)
def _cull(table, pairs, second, members, count, receivers, start, stop, kept):  # type: ignore[no-untyped-def]
    """Write into `kept` those of `members[:count]` that a receiver of rows start:stop can meet; return how many."""
    lx, ly, lz, hx, hy, hz = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for r in range(start, stop):
        x, y, z = receivers[r, 0], receivers[r, 1], receivers[r, 2]
        lx, ly, lz, hx, hy, hz = min(lx, x), min(ly, y), min(lz, z), max(hx, x), max(hy, y), max(hz, z)
    found = 0
    for i in range(count):
        e = members[i]
        if _reaches(
            table[pairs[e, 1]],
            second[e],
            second[e, 3],
            0.5 * (lx + hx),
            0.5 * (ly + hy),
            0.5 * (lz + hz),
            0.5 * (hx - lx) + INSIDE_M,
            0.5 * (hy - ly) + INSIDE_M,
            0.5 * (hz - lz) + INSIDE_M,
        ):
            kept[found] = e
            found += 1
    return found


@njit(cache=True)
def _hit(row, outline, start, stop, iu, iv, distance, side, x, y, z):  # type: ignore[no-untyped-def]
    """Return (d, u, v): distance of (x, y, z) from the facet, where its line to the image meets it; d < 0: none."""
    d = side * (row[0] * x + row[1] * y + row[2] * z - row[3])
    if d <= INSIDE_M:
        return -1.0, 0.0, 0.0
    t = d / (distance + d)
    u = row[4] * x + row[5] * y + row[6] * z
    u += t * (iu - u)
    v = row[7] * x + row[8] * y + row[9] * z
    v += t * (iv - v)
    if (
        u < row[10] - INSIDE_M
        or u > row[11] + INSIDE_M
        or v < row[12] - INSIDE_M
        or v > row[13] + INSIDE_M
        or not _inside(outline, start, stop, u, v)
    ):
        return -1.0, 0.0, 0.0
    return d, u, v


@njit(cache=True)
def second_candidates(  # type: ignore[no-untyped-def]
    table, first, outline, image, side, pairs, second, receivers, blocks, work, found, points
):
    """Write the double reflections of all receivers (N, 3); return how many, which may exceed the room.

    Written per candidate: `found` (receiver, pair) and `points` (2, 3), from the transmitter on. `work` (3, pairs):
    work space, its first row 0..pairs-1.
    """
    total = 0
    for outer in range(0, len(receivers), blocks[0]):
        outer_stop = min(outer + blocks[0], len(receivers))
        near = _cull(table, pairs, second, work[0], len(pairs), receivers, outer, outer_stop, work[1])
        for inner in range(outer, outer_stop, blocks[1]):
            inner_stop = min(inner + blocks[1], outer_stop)
            nearer = _cull(table, pairs, second, work[1], near, receivers, inner, inner_stop, work[2])
            for r in range(inner, inner_stop):
                for i in range(nearer):
                    e = work[2, i]
                    b = pairs[e, 1]
                    row = table[b]
                    d, u, v = _hit(
                        row, outline, first[b], first[b + 1], second[e, 0], second[e, 1], second[e, 2], second[e, 3],
                        receivers[r, 0], receivers[r, 1], receivers[r, 2],
                    )  # fmt: skip
                    if d < 0.0:
                        continue
                    x = u * row[4] + v * row[7] + row[3] * row[0]
                    y = u * row[5] + v * row[8] + row[3] * row[1]
                    z = u * row[6] + v * row[9] + row[3] * row[2]
                    a = pairs[e, 0]
                    row = table[a]
                    d, u, v = _hit(
                        row, outline, first[a], first[a + 1], image[a, 0], image[a, 1], image[a, 2], side[a], x, y, z
                    )
                    if d < 0.0:
                        continue
                    if total < len(found):
                        found[total, 0] = r
                        found[total, 1] = e
                        for axis in range(3):
                            points[total, 0, axis] = u * row[4 + axis] + v * row[7 + axis] + row[3] * row[axis]
                        points[total, 1, 0], points[total, 1, 1], points[total, 1, 2] = x, y, z
                    total += 1
    return total
