"""Compiled search for first-order specular points: exact culls per block, then the image method."""

from __future__ import annotations

import numpy as np
from numba import njit

INSIDE_M = 1e-6


@njit(cache=True)
def images(table, reflects, tx, ty, tz, image, side):  # type: ignore[no-untyped-def]
    """Write per facet the transmitter's (u, v, distance) into `image` (F, 3) and its side (+1, -1, 0: no
    path) into `side`.
    """
    for f in range(len(table)):
        d = table[f, 0] * tx + table[f, 1] * ty + table[f, 2] * tz - table[f, 3]
        image[f, 0] = table[f, 4] * tx + table[f, 5] * ty + table[f, 6] * tz
        image[f, 1] = table[f, 7] * tx + table[f, 8] * ty + table[f, 9] * tz
        image[f, 2] = abs(d)
        side[f] = 0.0
        if reflects[f] and abs(d) > INSIDE_M:
            side[f] = 1.0 if d > 0.0 else -1.0


@njit(cache=True)
def _reaches(row, image, side, cx, cy, cz, hx, hy, hz):  # type: ignore[no-untyped-def]
    """Tell whether a receiver in the box (centre c, half size h) can see the image through the facet's own
    box.
    """
    middle = side * (row[0] * cx + row[1] * cy + row[2] * cz - row[3])
    spread = abs(row[0]) * hx + abs(row[1]) * hy + abs(row[2]) * hz
    if middle + spread <= 0.0:
        return False
    if middle - spread <= 0.0:
        return True
    # The box lies in front of the plane: its shadow there is the hull of its corners' projections.
    lu, hu, lv, hv = np.inf, -np.inf, np.inf, -np.inf
    for corner in range(8):
        x = cx + (hx if corner & 1 else -hx)
        y = cy + (hy if corner & 2 else -hy)
        z = cz + (hz if corner & 4 else -hz)
        d = side * (row[0] * x + row[1] * y + row[2] * z - row[3])
        t = image[2] / (image[2] + d)
        u = image[0] + t * (row[4] * x + row[5] * y + row[6] * z - image[0])
        v = image[1] + t * (row[7] * x + row[8] * y + row[9] * z - image[1])
        lu, hu, lv, hv = min(lu, u), max(hu, u), min(lv, v), max(hv, v)
    return (
        hu >= row[10] - INSIDE_M and lu <= row[11] + INSIDE_M and hv >= row[12] - INSIDE_M and lv <= row[13] + INSIDE_M
    )


@njit(cache=True)
def _inside(outline, start, stop, u, v):  # type: ignore[no-untyped-def]
    """Tell whether (u, v) lies in one of the triangles, or within a micrometre of it."""
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


@njit(cache=True)
def _cull(table, image, side, members, count, receivers, start, stop, kept):  # type: ignore[no-untyped-def]
    """Write into `kept` those of `members[:count]` that a receiver of rows start:stop can meet; return how
    many.
    """
    lx, ly, lz, hx, hy, hz = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for r in range(start, stop):
        x, y, z = receivers[r, 0], receivers[r, 1], receivers[r, 2]
        lx, ly, lz, hx, hy, hz = min(lx, x), min(ly, y), min(lz, z), max(hx, x), max(hy, y), max(hz, z)
    found = 0
    for i in range(count):
        f = members[i]
        if side[f] != 0.0 and _reaches(
            table[f],
            image[f],
            side[f],
            0.5 * (lx + hx),
            0.5 * (ly + hy),
            0.5 * (lz + hz),
            0.5 * (hx - lx) + INSIDE_M,
            0.5 * (hy - ly) + INSIDE_M,
            0.5 * (hz - lz) + INSIDE_M,
        ):
            kept[found] = f
            found += 1
    return found


@njit(cache=True)
def candidates(  # type: ignore[no-untyped-def]
    table,
    first,
    outline,
    clearance,
    image,
    side,
    receivers,
    blocks,
    run,
    work,
    state,
    pair,
    point,
    reach,
    probe,
    probed,
):
    """Write the specular points of all receivers (N, 3); return their number, which may exceed the room, and the
    number of probes.

    `blocks`: sizes of the outer and the inner block of consecutive receivers; `work` (3, F): work space, its
    first row 0..F-1; `state` (2, F): zeros. Written per candidate: `pair` (receiver, facet), `point` (3), and `reach`,
    the share of the ray from the receiver to the point that must be free. Of `run` successive candidates of a facet
    the first is a probe: `probed` lists the probes' rows, `probe` holds the probe of each candidate.
    """
    total, probes = 0, 0
    for outer in range(0, len(receivers), blocks[0]):
        outer_stop = min(outer + blocks[0], len(receivers))
        near = _cull(table, image, side, work[0], len(table), receivers, outer, outer_stop, work[1])
        for inner in range(outer, outer_stop, blocks[1]):
            inner_stop = min(inner + blocks[1], outer_stop)
            nearer = _cull(table, image, side, work[1], near, receivers, inner, inner_stop, work[2])
            for r in range(inner, inner_stop):
                x, y, z = receivers[r, 0], receivers[r, 1], receivers[r, 2]
                for i in range(nearer):
                    f = work[2, i]
                    d = side[f] * (table[f, 0] * x + table[f, 1] * y + table[f, 2] * z - table[f, 3])
                    if d <= INSIDE_M:
                        continue
                    t = d / (image[f, 2] + d)
                    ru = table[f, 4] * x + table[f, 5] * y + table[f, 6] * z
                    u = ru + t * (image[f, 0] - ru)
                    if u < table[f, 10] - INSIDE_M or u > table[f, 11] + INSIDE_M:
                        continue
                    rv = table[f, 7] * x + table[f, 8] * y + table[f, 9] * z
                    v = rv + t * (image[f, 1] - rv)
                    if v < table[f, 12] - INSIDE_M or v > table[f, 13] + INSIDE_M:
                        continue
                    if not _inside(outline, first[f], first[f + 1], u, v):
                        continue
                    if total < len(pair):
                        pair[total, 0] = r
                        pair[total, 1] = f
                        for axis in range(3):
                            point[total, axis] = (
                                u * table[f, 4 + axis] + v * table[f, 7 + axis] + table[f, 3] * table[f, axis]
                            )
                        reach[total] = max(0.0, 1.0 - clearance[f] / d)
                        if state[0, f] % run == 0:
                            state[1, f] = probes
                            probed[probes] = total
                            probes += 1
                        state[0, f] += 1
                        probe[total] = state[1, f]
                    total += 1
    return total, probes


@njit(cache=True)
def unblocked(total, receivers, corners, blocker, pair, point, reach, probe, kept):  # type: ignore[no-untyped-def]
    """Write into `kept` the candidates that the triangle which blocked their probe does not block; return how many.

    `corners` (K, 3, 3): triangles; `blocker`: per probe a triangle, -1 none. Blocked is what crosses the triangle's
    inside, clear of its rim by a millionth (Moeller and Trumbore 1997).
    """
    found = 0
    for i in range(total):
        k = blocker[probe[i]]
        if k >= 0:
            r = pair[i, 0]
            ox, oy, oz = receivers[r, 0], receivers[r, 1], receivers[r, 2]
            dx, dy, dz = point[i, 0] - ox, point[i, 1] - oy, point[i, 2] - oz
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
            if u > rim and v > rim and u + v < det - rim and t > 0.0 and t < reach[i] * det:
                continue
        kept[found] = i
        found += 1
    return found
