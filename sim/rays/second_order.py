"""Double reflections of one transmitter: facets that it sees, pairs of facets, then shadow rays on three legs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.model import Floats, Ints
from cellslam.sim.rays.first_order import BLOCKS, unobstructed
from cellslam.sim.rays.scene import Scene

SAMPLE_M = 0.5


def lit_facets(scene: Scene, transmitter: Floats, reflects: NDArray[np.bool_]) -> Ints:
    """Return the facets of which the transmitter (3,), centred, sees a sample point; samples are half a metre apart.

    This is the one step that is not exact: a facet that is seen only through a slit narrower than that is missed.
    """
    from cellslam.sim.rays import second_kernel

    room = 1 << 20
    while True:
        owner, points = np.empty(room, np.int64), np.empty((room, 3))
        found = second_kernel.sample_points(scene.table, scene.first, scene.outline, reflects, SAMPLE_M, owner, points)
        if found <= room:
            break
        room = found
    owner, points = owner[:found], points[:found]
    seen = np.zeros(len(scene.table), np.bool_)
    for rows in np.array_split(np.arange(found), found // 1_000_000 + 1):
        source = np.broadcast_to(transmitter, (len(rows), 3))
        reach = 1.0 - _share(scene, owner[rows], source)
        seen[owner[rows][unobstructed(scene, source, points[rows], reach)]] = True
    return np.flatnonzero(seen)


def double_reflections(
    scene: Scene, transmitter: Floats, receivers: Floats, reflects: NDArray[np.bool_], lit: Ints
) -> tuple[Ints, Ints, Floats]:
    """Return (receiver (P,), facets (P, 2), points (P, 2, 3)) of all free second-order paths, centred."""
    from cellslam.sim.rays import kernel, second_kernel

    count = len(scene.table)
    image, side = np.empty((count, 3)), np.empty(count)
    x, y, z = transmitter
    kernel.images(scene.table, reflects, x, y, z, image, side)
    normal = scene.table[:, :3]
    mirrored = transmitter - 2.0 * (normal @ transmitter - scene.table[:, 3])[:, None] * normal
    low, high = receivers.min(axis=0), receivers.max(axis=0)
    around = np.concatenate([(low + high) / 2, (high - low) / 2 + kernel.INSIDE_M])
    room = 1 << 20
    while True:
        pairs, second = np.empty((room, 2), np.int64), np.empty((room, 4))
        found = second_kernel.facet_pairs(
            scene.table, scene.boxes, reflects, lit[side[lit] != 0.0], image, side, mirrored, around, pairs, second
        )
        if found <= room:
            break
        room = found
    pairs, second = pairs[:found], second[:found]
    work = np.empty((3, found), np.int64)
    work[0] = np.arange(found)
    room = 64 * len(receivers) + 1024
    while True:
        hit, points = np.empty((room, 2), np.int64), np.empty((room, 2, 3))
        total = second_kernel.second_candidates(
            scene.table, scene.first, scene.outline, image, side, pairs, second, receivers, BLOCKS, work, hit, points
        )
        if total <= room:
            break
        room = total
    facets, points = pairs[hit[:total, 1]], points[:total]
    free = _free_paths(scene, transmitter, receivers[hit[:total, 0]], facets, points)
    return hit[:total, 0][free], facets[free], points[free]


def _free_paths(scene: Scene, transmitter: Floats, receiver: Floats, facets: Ints, points: Floats) -> Ints:
    """Return the rows of which all three legs are free, the receiver's leg first: it kills most."""
    rows = np.arange(len(facets))
    share = _share(scene, facets[:, 1], receiver)
    rows = rows[unobstructed(scene, receiver, points[:, 1], 1.0 - share)]
    start, end = points[rows, 1], points[rows, 0]
    leave, arrive = _share(scene, facets[rows, 1], end), _share(scene, facets[rows, 0], start)
    # The middle leg starts on a wall: it is cut at both ends.
    origin = start + leave[:, None] * (end - start)
    left = np.maximum((1.0 - leave - arrive) / np.maximum(1.0 - leave, 1e-9), 0.0)
    rows = rows[unobstructed(scene, origin, end, left)]
    source = np.tile(transmitter, (len(rows), 1))
    return rows[unobstructed(scene, source, points[rows, 0], 1.0 - _share(scene, facets[rows, 0], source))]


def _share(scene: Scene, facet: Ints, origin: Floats) -> Floats:
    """Return which share of a ray from `origin` to the facet lies within the facet's clearance."""
    plane = scene.table[facet]
    distance = np.abs(np.einsum("pi,pi->p", plane[:, :3], origin) - plane[:, 3])
    return np.asarray(np.minimum(scene.clearance_m[facet] / np.maximum(distance, 1e-12), 1.0), np.float64)
