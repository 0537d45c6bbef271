"""Compiled search for points of diffraction: exact culls by excess length per block, then Keller's law.

Source: the law of diffraction, Keller, "Geometrical theory of diffraction", 1962; culls: own derivation,
docs/explanation/rays.md.
"""

from __future__ import annotations

import numpy as np

from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints


@part
def _excess(
    start: Floats, along: Floats, length: float, tx: float, ty: float, tz: float, rx: float, ry: float, rz: float,
    clamp: bool,
) -> tuple[float, float]:  # fmt: skip
    """Return (excess length over the straight line, position along the edge) of the shortest way over an edge.

    The position is where both legs make the same angle with the edge; with `clamp` it is kept on the edge, else
    -1 tells that it is beyond the ends.
    """
    ax, ay, az = tx - start[0], ty - start[1], tz - start[2]
    bx, by, bz = rx - start[0], ry - start[1], rz - start[2]
    sa = ax * along[0] + ay * along[1] + az * along[2]
    sb = bx * along[0] + by * along[1] + bz * along[2]
    da = np.sqrt(max(ax * ax + ay * ay + az * az - sa * sa, 0.0))
    db = np.sqrt(max(bx * bx + by * by + bz * bz - sb * sb, 0.0))
    s = (sa * db + sb * da) / max(da + db, 1e-12)
    if s < 0.0 or s >= length:
        if not clamp:
            return np.inf, -1.0
        s = min(max(s, 0.0), length)
    over = np.sqrt(da * da + (sa - s) ** 2) + np.sqrt(db * db + (sb - s) ** 2)
    straight = np.sqrt((tx - rx) ** 2 + (ty - ry) ** 2 + (tz - rz) ** 2)
    return over - straight, s


@part
def _near(
    start: Floats, along: Floats, length: Floats, t: Floats, receivers: Floats, low: int, high: int, members: Ints,
    count: int, most: float, kept: Ints,
) -> int:  # fmt: skip
    """Write into `kept` those of `members[:count]` that may stay below `most` metres of excess; return how many."""
    x, y, z, n = 0.0, 0.0, 0.0, high - low
    for r in range(low, high):
        x, y, z = x + receivers[r, 0] / n, y + receivers[r, 1] / n, z + receivers[r, 2] / n
    radius = 0.0
    for r in range(low, high):
        away = (receivers[r, 0] - x) ** 2 + (receivers[r, 1] - y) ** 2 + (receivers[r, 2] - z) ** 2
        radius = max(radius, np.sqrt(away))
    found = 0
    for i in range(count):
        e = members[i]
        excess, _ = _excess(start[e], along[e], length[e], t[0], t[1], t[2], x, y, z, True)
        # Moving the receiver by the radius changes both lengths by the radius at most.
        if excess <= most + 2.0 * radius + 1e-6:
            kept[found] = e
            found += 1
    return found


@njit(cache=True)
def diffractions(
    start: Floats, along: Floats, length: Floats, into: Floats, t: Floats, receivers: Floats, most: float,
    blocks: Ints, found: Ints, position: Floats,
) -> int:  # fmt: skip
    """Write the candidates with at most `most` metres of excess length: (receiver, edge) into found (P, 2), their
    position on the edge (P,) in m; return their number, which may exceed the room.

    start (E, 3) in m, along (E, 3) unit vectors, length (E,) in m, into (E, 2, 3): of the edges; t (3,), receivers
    (R, 3) in m; blocks: of how many receivers edges are culled together, at first and then (2,). Both ends of a path
    lie outside the wedge of its edge.
    """
    total, every = 0, np.arange(len(start))
    of_outer, of_inner = np.empty_like(every), np.empty_like(every)
    for outer in range(0, len(receivers), blocks[0]):
        outer_stop = min(outer + blocks[0], len(receivers))
        near = _near(start, along, length, t, receivers, outer, outer_stop, every, len(start), most, of_outer)
        for inner in range(outer, outer_stop, blocks[1]):
            stop = min(inner + blocks[1], outer_stop)
            nearer = _near(start, along, length, t, receivers, inner, stop, of_outer, near, most, of_inner)
            for r in range(inner, stop):
                for i in range(nearer):
                    e = of_inner[i]
                    more, s = _excess(
                        start[e], along[e], length[e], t[0], t[1], t[2],
                        receivers[r, 0], receivers[r, 1], receivers[r, 2], False,
                    )  # fmt: skip
                    if more > most or _within(into[e], start[e], t) or _within(into[e], start[e], receivers[r]):
                        continue
                    if total < len(found):
                        found[total, 0], found[total, 1], position[total] = r, e, s
                    total += 1
    return total


@part
def _within(into: Floats, start: Floats, point: Floats) -> bool:
    """Tell whether a point lies in the wedge between the two facets of an edge; a single facet has none."""
    if np.isnan(into[1, 0]):
        return False
    a0, a1, b0, b1, cross = 0.0, 0.0, 0.0, 0.0, 0.0
    aa, bb = 0.0, 0.0
    for axis in range(3):
        away = point[axis] - start[axis]
        a0 += away * into[0, axis]
        b0 += away * into[1, axis]
        cross += into[0, axis] * into[1, axis]
        aa += into[0, axis] * into[0, axis]
        bb += into[1, axis] * into[1, axis]
    # away = a1 into0 + b1 into1 + (along the edge)
    denominator = aa * bb - cross * cross
    a1 = (a0 * bb - b0 * cross) / denominator
    b1 = (b0 * aa - a0 * cross) / denominator
    return a1 > 0.0 and b1 > 0.0
