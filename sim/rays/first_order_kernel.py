"""Compiled search for first-order specular points: exact culls per block, then the image method.

A facet's plane coordinates are (u, v), in metres along its two unit vectors; the image of a transmitter lies at its own
(u, v), as far behind the plane as the transmitter is before it. Source: image method, which gives the virtual
transmitters of the extended FastSLAM paper, section III; culls per block: own, docs/explanation/rays.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import lean, njit, part

Array = NDArray[Any]
INSIDE_M = 1e-6
# What says forceinline is called in the innermost loops, where a call would cost more than what is done.


class FacetTable(NamedTuple):
    """Facets (F,): columns of `scene.Scene`, of the same names."""

    table: Array
    first: Array
    outline: Array
    clearance: Array


class Images(NamedTuple):
    """A transmitter mirrored in facets: `image` (F, 3) u, v and distance from the plane in m; `side` (F,) on which it
    stands, +1 or -1, 0 where no path is possible.
    """

    image: Array
    side: Array


class Box(NamedTuple):
    """Centre and half size along the axes, m."""

    x: float
    y: float
    z: float
    hx: float
    hy: float
    hz: float


class Candidates(NamedTuple):
    """Specular points, with rows to spare: `pair` (N, 2) receiver and facet, `point` (N, 3) in m, `reach` (N,) the
    share of the ray from receiver to point that must be free. Of successive ones of a facet the first is a probe:
    `probed` lists the probes' rows, `probe` (N,) is the place of each one's probe in that list.
    """

    pair: Array
    point: Array
    reach: Array
    probe: Array
    probed: Array


@lean(forceinline=True)
def shadow(row: Array, image: Any, side: float, box: Box) -> tuple[float, float, float, float]:
    """Return the window (low u, high u, low v, high v) in the plane of the facet `row` (14,) through which its `image`
    (u, v, distance) sees a box: all of the plane where the box crosses that, nothing where it lies behind.
    """
    middle = side * (row[0] * box.x + row[1] * box.y + row[2] * box.z - row[3])
    spread = abs(row[0]) * box.hx + abs(row[1]) * box.hy + abs(row[2]) * box.hz
    lu, hu, lv, hv = np.inf, -np.inf, np.inf, -np.inf
    if middle + spread <= 0.0:
        return lu, hu, lv, hv
    if middle - spread <= 0.0:
        return hu, lu, hv, lv
    # The box lies in front of the plane: its shadow there is the hull of its corners' projections.
    for corner in range(8):
        x = box.x + (box.hx if corner & 1 else -box.hx)
        y = box.y + (box.hy if corner & 2 else -box.hy)
        z = box.z + (box.hz if corner & 4 else -box.hz)
        d = side * (row[0] * x + row[1] * y + row[2] * z - row[3])
        t = image[2] / (image[2] + d)
        u = image[0] + t * (row[4] * x + row[5] * y + row[6] * z - image[0])
        v = image[1] + t * (row[7] * x + row[8] * y + row[9] * z - image[1])
        lu, hu, lv, hv = min(lu, u), max(hu, u), min(lv, v), max(hv, v)
    return lu, hu, lv, hv


@lean
def reaches(row: Array, image: Array, side: float, box: Box) -> bool:
    """Tell whether a receiver in the box can see the image (3,) through the box of the facet `row` (14,)."""
    lu, hu, lv, hv = shadow(row, image, side, box)
    return overlaps(row, lu, hu, lv, hv)


@lean(forceinline=True)
def overlaps(row: Array, lu: float, hu: float, lv: float, hv: float) -> bool:
    """Tell whether a window of its plane overlaps the box of the facet `row` (14,), or is within a micrometre of it."""
    return bool(
        hu >= row[10] - INSIDE_M and lu <= row[11] + INSIDE_M and hv >= row[12] - INSIDE_M and lv <= row[13] + INSIDE_M
    )


@lean
def inside(outline: Array, start: int, stop: int, u: float, v: float) -> bool:
    """Tell whether (u, v) lies in one of the triangles `outline[start:stop]`, or within a micrometre of it."""
    for k in range(start, stop):
        au, av = outline[k, 0] - u, outline[k, 1] - v
        bu, bv = outline[k, 2] - u, outline[k, 3] - v
        cu, cv = outline[k, 4] - u, outline[k, 5] - v
        ab, bc, ca = au * bv - av * bu, bu * cv - bv * cu, cu * av - cv * au
        turn = 1.0 if ab + bc + ca > 0.0 else -1.0
        if (
            turn * ab >= -INSIDE_M * np.hypot(bu - au, bv - av)
            and turn * bc >= -INSIDE_M * np.hypot(cu - bu, cv - bv)
            and turn * ca >= -INSIDE_M * np.hypot(au - cu, av - cv)
        ):
            return True
    return False


@lean(forceinline=True)
def hit(
    facets: FacetTable, f: int, images: Array, i: int, side: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return (d, u, v): distance of (x, y, z) from facet f, and where its line to the image `images[i]` meets the
    facet; d < 0: it does not.
    """
    table = facets.table
    d = side * (table[f, 0] * x + table[f, 1] * y + table[f, 2] * z - table[f, 3])
    if d <= INSIDE_M:
        return -1.0, 0.0, 0.0
    t = d / (images[i, 2] + d)
    ru = table[f, 4] * x + table[f, 5] * y + table[f, 6] * z
    u = ru + t * (images[i, 0] - ru)
    if u < table[f, 10] - INSIDE_M or u > table[f, 11] + INSIDE_M:
        return -1.0, 0.0, 0.0
    rv = table[f, 7] * x + table[f, 8] * y + table[f, 9] * z
    v = rv + t * (images[i, 1] - rv)
    if v < table[f, 12] - INSIDE_M or v > table[f, 13] + INSIDE_M:
        return -1.0, 0.0, 0.0
    if not inside(facets.outline, facets.first[f], facets.first[f + 1], u, v):
        return -1.0, 0.0, 0.0
    return d, u, v


@lean
def point_on(table: Array, f: int, u: float, v: float) -> tuple[float, float, float]:
    """Return the point of facet f at (u, v), in m."""
    x = u * table[f, 4] + v * table[f, 7] + table[f, 3] * table[f, 0]
    y = u * table[f, 5] + v * table[f, 8] + table[f, 3] * table[f, 1]
    return x, y, u * table[f, 6] + v * table[f, 9] + table[f, 3] * table[f, 2]


@njit(cache=True)
def bounds(receivers: Array, start: int, stop: int) -> Box:
    """Return the box of the receivers (N, 3) of rows start:stop, a micrometre wider."""
    lx, ly, lz, hx, hy, hz = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for r in range(start, stop):
        x, y, z = receivers[r, 0], receivers[r, 1], receivers[r, 2]
        lx, ly, lz, hx, hy, hz = min(lx, x), min(ly, y), min(lz, z), max(hx, x), max(hy, y), max(hz, z)
    return Box(
        0.5 * (lx + hx), 0.5 * (ly + hy), 0.5 * (lz + hz),
        0.5 * (hx - lx) + INSIDE_M, 0.5 * (hy - ly) + INSIDE_M, 0.5 * (hz - lz) + INSIDE_M,
    )  # fmt: skip


@part
def _cull(table: Array, images: Images, box: Box, members: Array, count: int, kept: Array) -> int:
    """Write into `kept` those of `members[:count]` that a receiver in the box can meet; return how many."""
    found = 0
    for i in range(count):
        f = members[i]
        if images.side[f] != 0.0 and reaches(table[f], images.image[f], images.side[f], box):
            kept[found] = f
            found += 1
    return found


@njit(cache=True)
def candidates(
    facets: FacetTable, images: Images, receivers: Array, blocks: Array, run: int, out: Candidates
) -> tuple[int, int]:
    """Write the specular points of all receivers (N, 3), in m; return their number, which may exceed the room, and the
    number of probes.

    `blocks`: sizes of the outer and the inner block of consecutive receivers; `run`: candidates of a facet that share
    a probe.
    """
    table, side = facets.table, images.side
    all_facets = np.arange(len(table))
    of_outer, of_inner = np.empty_like(all_facets), np.empty_like(all_facets)
    # Of each facet: how many candidates there were, and the place of the probe of the latest ones.
    count, latest = np.zeros(len(table), np.int64), np.zeros(len(table), np.int64)
    total, probes = 0, 0
    for outer in range(0, len(receivers), blocks[0]):
        outer_stop = min(outer + blocks[0], len(receivers))
        near = _cull(table, images, bounds(receivers, outer, outer_stop), all_facets, len(table), of_outer)
        for inner in range(outer, outer_stop, blocks[1]):
            inner_stop = min(inner + blocks[1], outer_stop)
            nearer = _cull(table, images, bounds(receivers, inner, inner_stop), of_outer, near, of_inner)
            for r in range(inner, inner_stop):
                x, y, z = receivers[r, 0], receivers[r, 1], receivers[r, 2]
                for i in range(nearer):
                    f = of_inner[i]
                    d, u, v = hit(facets, f, images.image, f, side[f], x, y, z)
                    if d < 0.0:
                        continue
                    if total < len(out.pair):
                        out.pair[total, 0], out.pair[total, 1] = r, f
                        out.point[total, 0], out.point[total, 1], out.point[total, 2] = point_on(table, f, u, v)
                        out.reach[total] = max(0.0, 1.0 - facets.clearance[f] / d)
                        if count[f] % run == 0:
                            latest[f] = probes
                            out.probed[probes] = total
                            probes += 1
                        count[f] += 1
                        out.probe[total] = latest[f]
                    total += 1
    return total, probes


@njit(cache=True)
def unblocked(total: int, receivers: Array, corners: Array, blocker: Array, found: Candidates, kept: Array) -> int:
    """Write into `kept` the candidates that the triangle which blocked their probe does not block; return how many.

    `corners` (K, 3, 3) of triangles in m; `blocker`: per probe a triangle's index, -1 none. Blocked is what crosses the
    triangle's inside, clear of its rim by a millionth. Source: Moeller and Trumbore, "Fast, minimum storage
    ray-triangle intersection", 1997.
    """
    left = 0
    for i in range(total):
        k = blocker[found.probe[i]]
        if k >= 0:
            r = found.pair[i, 0]
            ox, oy, oz = receivers[r, 0], receivers[r, 1], receivers[r, 2]
            dx, dy, dz = found.point[i, 0] - ox, found.point[i, 1] - oy, found.point[i, 2] - oz
            ax, ay, az = corners[k, 0, 0], corners[k, 0, 1], corners[k, 0, 2]
            bx, by, bz = corners[k, 1, 0] - ax, corners[k, 1, 1] - ay, corners[k, 1, 2] - az
            cx, cy, cz = corners[k, 2, 0] - ax, corners[k, 2, 1] - ay, corners[k, 2, 2] - az
            px, py, pz = dy * cz - dz * cy, dz * cx - dx * cz, dx * cy - dy * cx
            det = bx * px + by * py + bz * pz
            sx, sy, sz = ox - ax, oy - ay, oz - az
            u = sx * px + sy * py + sz * pz
            qx, qy, qz = sy * bz - sz * by, sz * bx - sx * bz, sx * by - sy * bx
            v = dx * qx + dy * qy + dz * qz
            t = cx * qx + cy * qy + cz * qz
            if det < 0.0:
                det, u, v, t = -det, -u, -v, -t
            rim = 1e-6 * det
            if u > rim and v > rim and u + v < det - rim and t > 0.0 and t < found.reach[i] * det:
                continue
        kept[left] = i
        left += 1
    return left
