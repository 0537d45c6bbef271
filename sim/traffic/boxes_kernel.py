"""Compiled: which segments of paths meet which boxes, exactly; where their long sides mirror a transmitter.

Source: slabs of a box, Kay and Kajiya 1986; image method, as for walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import njit, part

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Point = tuple[float, float, float]
LONGEST_STEP_M = 25.0  # who is farther off after one step has left the lane's end and comes in at its beginning


class Lines(NamedTuple):
    """Paths (P,), sorted by snapshot: `step` (P,) between the boxes' poses; `corners` (P, 4, 3) in m, of which the
    first `used` (P,) count, the last of these being the receiver; `own` (P,): the vehicle that a path is reflected
    by, -1 none.
    """

    step: Floats
    corners: Floats
    used: Ints
    own: Ints


@njit(cache=True)
def place(poses: Floats, step: float, out: Floats) -> None:
    """Write the poses (N, 4), in m and rad, between those of whole steps (K, N, 4). Who is farther off than
    `LONGEST_STEP_M` after a step has come in again, and is there already."""
    last = len(poses) - 1
    at = min(max(step, 0.0), float(last))
    k = min(int(at), max(last - 1, 0))
    part = at - k
    after = min(k + 1, last)
    for n in range(poses.shape[1]):
        jump = abs(poses[after, n, 0] - poses[k, n, 0]) + abs(poses[after, n, 1] - poses[k, n, 1])
        share = part if jump <= LONGEST_STEP_M else 1.0
        for c in range(4):
            out[n, c] = poses[k, n, c] + share * (poses[after, n, c] - poses[k, n, c])


@part
def in_box(point: Point, pose: Floats) -> Point:
    """Return a point in the frame of a box with pose [x, y, ground, yaw]: along, to the left, above ground, m."""
    x, y = point[0] - pose[0], point[1] - pose[1]
    c, s = np.cos(pose[3]), np.sin(pose[3])
    return c * x + s * y, c * y - s * x, point[2] - pose[2]


@part
def meets(start: Point, end: Point, size: Floats) -> bool:
    """Return whether a segment meets a box [length, width, height] in m, both in the frame of the box."""
    low, high = (-0.5 * size[0], -0.5 * size[1], 0.0), (0.5 * size[0], 0.5 * size[1], size[2])
    enter, leave = 0.0, 1.0
    for axis in range(3):
        step = end[axis] - start[axis]
        if step == 0.0:
            if not low[axis] <= start[axis] <= high[axis]:
                return False
            continue
        one, other = (low[axis] - start[axis]) / step, (high[axis] - start[axis]) / step
        enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
    return enter <= leave


@part
def _point(corners: Floats, row: int) -> Point:
    return corners[row, 0], corners[row, 1], corners[row, 2]


@njit(cache=True)
def blocking_pairs(lines: Lines, poses: Floats, size_m: Floats) -> Ints:
    """Return (path, vehicle) (B, 2), each once, sorted by path: vehicles (N,) with poses (K, N, 4) and sizes
    (N, 3), in m and rad. A vehicle that holds the receiver blocks nothing: it stands where ours does.
    """
    vehicles = len(size_m)
    now, noted = np.empty((vehicles, 4)), np.full(vehicles, -1)
    reach = 0.5 * np.sqrt(size_m[:, 0] ** 2 + size_m[:, 1] ** 2)
    out = np.empty((1024, 2), np.int64)
    found, step, top = 0, np.nan, 0.0
    for p in range(len(lines.step)):
        if lines.step[p] != step:
            step = lines.step[p]
            place(poses, step, now)
            top = np.max(now[:, 2] + size_m[:, 2])
        corners, last = lines.corners[p], lines.used[p] - 1
        for k in range(last):
            x, y, half = _below(_point(corners, k), _point(corners, k + 1), top)
            if half < 0.0:
                continue
            for n in range(vehicles):
                dx, dy, far = x - now[n, 0], y - now[n, 1], half + reach[n]
                if dx * dx + dy * dy > far * far or n == lines.own[p] or noted[n] == p:
                    continue
                if _blocks(corners, k, last, now[n], size_m[n]):
                    if found == len(out):
                        out = np.concatenate((out, np.empty_like(out)))
                    out[found, 0], out[found, 1] = p, n
                    found += 1
                    noted[n] = p
    return out[:found].copy()


@part
def _below(start: Point, end: Point, top: float) -> Point:
    """Return the middle (x, y) of the part of a segment that is below `top`, and half of the part's length and a little
    more, as seen from above; below zero where there is none."""
    first, last = 0.0, 1.0
    if start[2] > top or end[2] > top:
        if start[2] > top and end[2] > top:
            return 0.0, 0.0, -1.0
        share = (top - start[2]) / (end[2] - start[2])
        first, last = (share, 1.0) if start[2] > top else (0.0, share)
    x, y = end[0] - start[0], end[1] - start[1]
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    return start[0] + middle * x, start[1] + middle * y, half * np.sqrt(x * x + y * y) + 1e-6


@part
def _blocks(corners: Floats, k: int, last: int, pose: Floats, size: Floats) -> bool:
    """Return whether a box blocks segment k of a path, and does not hold the path's last corner."""
    if not meets(in_box(_point(corners, k), pose), in_box(_point(corners, k + 1), pose), size):
        return False
    receiver = in_box(_point(corners, last), pose)
    return not meets(receiver, receiver, size)


@njit(cache=True)
def mirror_points(
    transmitter: Floats, receivers: Floats, steps: Floats, poses: Floats, size_m: Floats,
    mirrors: Ints,
) -> tuple[Ints, Floats, Floats]:  # fmt: skip
    """Return (receiver, vehicle) (C, 2), point (C, 3) and normal (C, 3) of all reflections of a transmitter (3,) for
    receivers (R, 3), in m, at `steps` (R,) between the poses (K, N, 4): by the left and right sides of vehicles
    `mirrors` (n,), whatever stands in between.
    """
    now = np.empty((len(size_m), 4))
    rows, places = np.empty((1024, 2), np.int64), np.empty((1024, 6))
    found = 0
    for r in range(len(receivers)):
        place(poses, steps[r], now)
        end_m = (receivers[r, 0], receivers[r, 1], receivers[r, 2])
        for n in mirrors:
            start = in_box((transmitter[0], transmitter[1], transmitter[2]), now[n])
            end = in_box(end_m, now[n])
            for side in (-1.0, 1.0):
                # Distances from the plane of the side, outwards.
                out, back = side * start[1] - 0.5 * size_m[n, 1], side * end[1] - 0.5 * size_m[n, 1]
                if out <= 0.0 or back <= 0.0:
                    continue
                share = back / (out + back)
                along, up = end[0] + share * (start[0] - end[0]), end[2] + share * (start[2] - end[2])
                if abs(along) > 0.5 * size_m[n, 0] or not 0.0 <= up <= size_m[n, 2]:
                    continue
                if found == len(rows):
                    rows = np.concatenate((rows, np.empty_like(rows)))
                    places = np.concatenate((places, np.empty_like(places)))
                c, s, across = np.cos(now[n, 3]), np.sin(now[n, 3]), side * 0.5 * size_m[n, 1]
                rows[found, 0], rows[found, 1] = r, n
                places[found, 0] = now[n, 0] + c * along - s * across
                places[found, 1] = now[n, 1] + s * along + c * across
                places[found, 2] = now[n, 2] + up
                places[found, 3], places[found, 4], places[found, 5] = -s * side, c * side, 0.0
                found += 1
    return rows[:found].copy(), places[:found, :3].copy(), places[:found, 3:].copy()
