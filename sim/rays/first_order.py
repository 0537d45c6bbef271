"""Lines of sight and single reflections of one transmitter: candidates, then shadow rays on both legs.

For a transmitter s, a receiver r, and a facet in the plane n . x = c with unit vectors e_u, e_v in the plane:

    image               s' = s - 2 (n . s - c) n, the virtual transmitter       `tracing.images_of`
      in the plane      u_s = e_u . s, v_s = e_v . s, distance h = |n . s - c|  `facets_and_images`
    same side           d = sign(n . s - c) (n . r - c) > 0                     `first_order_kernel.hit`
    specular point      t = d / (h + d),   u = u_r + t (u_s - u_r), v alike     `first_order_kernel.hit`
    on the facet        (u, v) in one of its triangles                          `first_order_kernel.inside`
    free                no triangle between r and the point, nor between the
                        point and s; the last `clearance` is left out           `single_reflections`
    length              |r - s'|, direction of arrival that of s' - r           `tracing._describe`

Facets are culled for whole blocks of receivers: where the block's box, projected from the image, misses the facet's
(`first_order_kernel.reaches`), no receiver in it can have a path.

Source: image method, which gives the virtual transmitters of the extended FastSLAM paper, section III;
docs/explanation/rays.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import Floats
from cellslam.sim.rays.paths import Found
from cellslam.sim.rays.scene import CLEARANCE_M, Scene

if TYPE_CHECKING:
    from cellslam.sim.rays.first_order_kernel import FacetTable, Images

BLOCKS = np.array([512, 64])
# One of so many successive candidates of a facet finds out what blocks it: mostly that blocks the others too.
RUN = 16


def facets_and_images(scene: Scene, transmitter: Floats, reflects: NDArray[np.bool_]) -> tuple[FacetTable, Images]:
    """Return the facets, and the transmitter (3,), in m, mirrored in those that reflect (F,), as kernels take them."""
    from cellslam.sim.rays.first_order_kernel import INSIDE_M, FacetTable, Images

    planes, s = scene.planes, transmitter
    n_s, u_s, v_s = (planes[k] * s[0] + planes[k + 1] * s[1] + planes[k + 2] * s[2] for k in (0, 4, 7))
    before = n_s - planes[3]
    h = np.abs(before)
    side = np.where(reflects & (h > INSIDE_M), np.where(before > 0.0, 1.0, -1.0), 0.0)
    images = Images(np.column_stack([u_s, v_s, h]), side)
    return FacetTable(scene.table, scene.first, scene.outline, scene.clearance_m), images


def lines_of_sight(scene: Scene, transmitter: Floats, receivers: Floats) -> Found:
    """Return the paths to those of `receivers` (N, 3) that see `transmitter` (3,), both in centred coordinates."""
    targets = np.broadcast_to(transmitter, receivers.shape)
    length = np.linalg.norm(targets - receivers, axis=1)
    # The last millimetre is left out: a transmitter may be mounted on a surface.
    reach = np.maximum(1.0 - CLEARANCE_M / np.maximum(length, CLEARANCE_M), 0.0)
    return Found.of(np.flatnonzero(scene.unobstructed(receivers, targets, reach) & (length > 0.0)))


def single_reflections(scene: Scene, transmitter: Floats, receivers: Floats, reflects: NDArray[np.bool_]) -> Found:
    """Return all free first-order paths to receivers (N, 3), centred coordinates in m."""
    from cellslam.sim.rays import first_order_kernel as kernel

    facets, images = facets_and_images(scene, transmitter, reflects)
    room = 160 * len(receivers) + 1024
    while True:
        out = kernel.Candidates(
            pair=np.empty((room, 2), np.int64), point=np.empty((room, 3)), reach=np.empty(room),
            probe=np.empty(room, np.int64), probed=np.empty(room // RUN + len(scene.table) + 1, np.int64),
        )  # fmt: skip
        found, probes = kernel.candidates(facets, images, receivers, BLOCKS, RUN, out)
        if found <= room:
            break
        room = found
    pair, point, reach, _, probed = out
    first = probed[:probes]
    blocker = scene.first_hits(receivers[pair[first, 0]], point[first], reach[first])
    kept = np.empty(found, np.int64)
    kept = kept[: kernel.unblocked(found, receivers, scene.corners, blocker, out, kept)]
    kept = kept[scene.unobstructed(receivers[pair[kept, 0]], point[kept], reach[kept])]
    facet, points = pair[kept, 1], point[kept]
    last = scene.clearance_m[facet] / images.image[facet, 2]
    free = scene.unobstructed(np.broadcast_to(transmitter, points.shape), points, np.maximum(1.0 - last, 0.0))
    return Found.of(pair[kept[free], 0], facet[free, None], points[free, None])
