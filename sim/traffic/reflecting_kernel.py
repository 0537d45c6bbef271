"""Compiled: where the long sides of boxes mirror a transmitter for a receiver.

Source: image method, as for walls.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import njit
from cellslam.sim.traffic.blocking_kernel import in_box, place

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True)
def mirror_points(
    transmitter: Floats, receivers: Floats, steps: Floats, poses: Floats, longest_m: float, size_m: Floats,
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
        place(poses, steps[r], longest_m, now)
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
