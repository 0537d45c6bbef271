"""Lines of sight and single reflections of one transmitter: candidates, then shadow rays on both legs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.model import Floats, Ints
from cellslam.sim.rays.scene import CLEARANCE_M, Scene

BLOCKS = np.array([512, 64])


def unobstructed(scene: Scene, origins: Floats, targets: Floats, reach: Floats) -> NDArray[np.bool_]:
    """Tell of rays (N, 3) -> (N, 3), centred coordinates, if their first `reach` (N,), 0 to 1, is free."""
    if not len(origins):
        return np.zeros(0, np.bool_)
    return _free(scene, origins.astype(np.float32), (targets - origins).astype(np.float32), reach.astype(np.float32))


def _free(
    scene: Scene, origins: NDArray[np.float32], directions: NDArray[np.float32], reach: NDArray[np.float32]
) -> NDArray[np.bool_]:
    hit = scene.embree[0].run(
        np.ascontiguousarray(origins),
        np.ascontiguousarray(directions),
        dists=np.ascontiguousarray(reach),
        query="OCCLUDED",
    )
    return np.asarray(hit == -1, np.bool_)


def lines_of_sight(scene: Scene, transmitter: Floats, receivers: Floats) -> Ints:
    """Return the rows of `receivers` (N, 3) that see `transmitter` (3,), both in centred coordinates."""
    targets = np.broadcast_to(transmitter, receivers.shape)
    length = np.linalg.norm(targets - receivers, axis=1)
    # The last millimetre is left out: a transmitter may be mounted on a surface.
    reach = np.maximum(1.0 - CLEARANCE_M / np.maximum(length, CLEARANCE_M), 0.0)
    return np.flatnonzero(unobstructed(scene, receivers, targets, reach) & (length > 0.0))


def single_reflections(
    scene: Scene, transmitter: Floats, receivers: Floats, reflects: NDArray[np.bool_]
) -> tuple[Ints, Ints, Floats]:
    """Return (receiver (P,), facet (P,), point (P, 3)) of all free first-order paths, centred."""
    from cellslam.sim.rays import kernel

    count = len(scene.table)
    image, side = np.empty((count, 3)), np.empty(count)
    x, y, z = transmitter
    kernel.images(scene.table, reflects, x, y, z, image, side)
    work = np.empty((3, count), np.int64)
    work[0] = np.arange(count)
    room = 160 * len(receivers) + 1024
    while True:
        pair, point = np.empty((room, 2), np.int64), np.empty((room, 3))
        ray, reach = np.empty((room, 6), np.float32), np.empty(room, np.float32)
        found = kernel.candidates(
            scene.table, scene.first, scene.outline, scene.clearance_m, image, side, receivers, BLOCKS, work,
            pair, point, ray, reach,
        )  # fmt: skip
        if found <= room:
            break
        room = found
    kept = np.flatnonzero(_free(scene, ray[:found, :3], ray[:found, 3:], reach[:found])) if found else np.arange(0)
    facet, points = pair[kept, 1], point[kept]
    origins = np.broadcast_to(transmitter, points.shape)
    free = unobstructed(scene, origins, points, np.maximum(1.0 - scene.clearance_m[facet] / image[facet, 2], 0.0))
    return pair[kept[free], 0], facet[free], points[free]
