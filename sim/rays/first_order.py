"""Lines of sight and single reflections of one transmitter: candidates, then shadow rays on both legs.

For a transmitter s, a receiver r, and a facet in the plane n . x = c with unit vectors e_u, e_v in the plane:

    image               s' = s - 2 (n . s - c) n, the virtual transmitter      `tracing.images_of`
      in the plane      (e_u . s, e_v . s), and the distance h = |n . s - c|   `first_order_kernel.mirror`
    same side           d = sign(n . s - c) (n . r - c) > 0                    `first_order_kernel.candidates`
    specular point      t = d / (h + d),   u = u_r + t (u_s - u_r), v alike    `first_order_kernel.candidates`
    on the facet        (u, v) in one of its triangles                         `first_order_kernel.inside`
    free                no triangle between r and the point, nor between the
                        point and s; the last `clearance` is left out          `single_reflections`
    length              |r - s'|, direction of arrival that of s' - r          `tracing._describe`

Facets are culled for whole blocks of receivers: where the block's box, projected from the image, misses the facet's
(`first_order_kernel.reaches`), no receiver in it can have a path.

Source: image method, which gives the virtual transmitters of the extended FastSLAM paper, section III;
docs/explanation/rays.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import Floats, Ints
from cellslam.sim.rays.scene import CLEARANCE_M, Scene

BLOCKS = np.array([512, 64])
# One of so many successive candidates of a facet finds out what blocks it: mostly that blocks the others too.
RUN = 16


def unobstructed(scene: Scene, origins: Floats, targets: Floats, reach: Floats) -> NDArray[np.bool_]:
    """Tell of rays (N, 3) -> (N, 3), centred coordinates in m, if their first `reach` (N,), 0 to 1, is free."""
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
    """Return (receiver (P,), facet (P,), point (P, 3)) of all free first-order paths, centred coordinates in m."""
    from cellslam.sim.rays import first_order_kernel as kernel

    count = len(scene.table)
    facets = kernel.FacetTable(scene.table, scene.first, scene.outline, scene.clearance_m)
    images = kernel.Images(np.empty((count, 3)), np.empty(count))
    kernel.mirror(scene.table, reflects, transmitter, images)
    work = np.empty((3, count), np.int64)
    work[0] = np.arange(count)
    room = 160 * len(receivers) + 1024
    while True:
        out = kernel.Candidates(
            pair=np.empty((room, 2), np.int64), point=np.empty((room, 3)), reach=np.empty(room),
            probe=np.empty(room, np.int64), probed=np.empty(room // RUN + count + 1, np.int64),
        )  # fmt: skip
        state = np.zeros((2, count), np.int64)
        found, probes = kernel.candidates(facets, images, receivers, BLOCKS, RUN, work, state, out)
        if found <= room:
            break
        room = found
    pair, point, reach, _, probed = out
    blocker = first_hits(scene, receivers[pair[probed[:probes], 0]], point[probed[:probes]], reach[probed[:probes]])
    kept = np.empty(found, np.int64)
    kept = kept[: kernel.unblocked(found, receivers, scene.corners, blocker, out, kept)]
    kept = kept[unobstructed(scene, receivers[pair[kept, 0]], point[kept], reach[kept])]
    facet, points = pair[kept, 1], point[kept]
    origins = np.broadcast_to(transmitter, points.shape)
    last = scene.clearance_m[facet] / images.image[facet, 2]
    free = unobstructed(scene, origins, points, np.maximum(1.0 - last, 0.0))
    return pair[kept[free], 0], facet[free], points[free]


def first_hits(scene: Scene, origins: Floats, targets: Floats, reach: Floats) -> Ints:
    """Return the index of the triangle that each ray (N, 3) -> (N, 3), in m, meets first within its share `reach` (N,),
    -1 none.
    """
    if not len(origins):
        return np.zeros(0, np.int64)
    directions = (targets - origins).astype(np.float32)
    hit = scene.embree[0].run(
        np.ascontiguousarray(origins, np.float32),
        np.ascontiguousarray(directions),
        dists=np.ascontiguousarray(reach, np.float32),
        query="INTERSECT",
    )
    return np.asarray(hit, np.int64)
