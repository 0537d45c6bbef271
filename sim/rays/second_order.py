"""Double reflections of one transmitter: facets that it sees, pairs of facets, then shadow rays on three legs.

For a transmitter s, a receiver r, and facets a and b in the planes n_a . x = c_a, n_b . x = c_b (`first_order` has the
equations of one facet):

    images              s' = s - 2 (n_a . s - c_a) n_a,  s'' = s' - 2 (n_b . s' - c_b) n_b, the virtual transmitter
                                                                             `second_order_kernel.facet_pairs`
    last point          p_b where the ray from r to s'' meets b              `second_order_kernel.second_candidates`
    first point         p_a where the ray from p_b to s' meets a             `second_order_kernel.second_candidates`
    free                no triangle between r and p_b, p_b and p_a, p_a and s            `_free_paths`
    length              |r - s''|, direction of arrival that of s'' - r                  `tracing._describe`

Pairs are left out where no receiver can be reached: b is culled as a facet that s' would illuminate through a, and
receivers, block by block, as boxes that s'' would through b and a (`_beam_reaches`); a pair, too, of which one of the
first two legs is blocked as a whole (`_open_pairs`).

Source: image method, which gives the virtual transmitters of the extended FastSLAM paper, section III;
docs/explanation/rays.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import Floats, Ints
from cellslam.sim.rays.first_order import facets_and_images
from cellslam.sim.rays.paths import Found, all_found
from cellslam.sim.rays.scene import HIDDEN_M, Scene

if TYPE_CHECKING:
    from cellslam.sim.rays.first_order_kernel import Images

PAIRS_AT_ONCE = 100_000
RECEIVERS_AT_ONCE = 512
# Successive receivers, a hand's breadth apart, that are culled together.
BLOCKS = np.array([512, 128, 32, 8])


def _open_pairs(scene: Scene, transmitter: Floats, images: Images, mirrored: Floats, pairs: Ints) -> NDArray[np.bool_]:
    """Tell the pairs (P, 2) of which neither the first leg nor the one between the facets is wholly blocked."""
    from cellslam.sim.rays import second_order_kernel as second_kernel

    kept = np.ones(len(pairs), np.bool_)
    for begin in range(0, len(pairs), PAIRS_AT_ONCE):
        rows = np.arange(begin, min(begin + PAIRS_AT_ONCE, len(pairs)))
        part, start, end = np.empty((3, len(rows), 4, 3))
        second_kernel.windows(scene.table, images, mirrored, pairs[rows], part, start, end)
        kept[rows] = ~scene.hidden(np.broadcast_to(transmitter, part.shape), part)
        left = rows[kept[rows] & ~np.isnan(start[:, 0, 0])]
        start, end = start[left - begin], end[left - begin]
        away = end - start
        # The leg starts on the first facet: a centimetre further on, so as not to meet that.
        length = np.maximum(np.linalg.norm(away, axis=2, keepdims=True), HIDDEN_M)
        kept[left] = ~scene.hidden(start + away * np.minimum(HIDDEN_M / length, 1.0), end)
    return kept


def double_reflections(
    scene: Scene, transmitter: Floats, receivers: Floats, reflects: NDArray[np.bool_], first: Ints
) -> Found:
    """Return all free second-order paths to receivers (N, 3), centred, in m, over the facets `first` (L,) first."""
    from cellslam.sim.rays import second_order_kernel as second_kernel
    from cellslam.sim.rays.first_order_kernel import bounds

    facets, images = facets_and_images(scene, transmitter, reflects)
    normal = scene.table[:, :3]
    mirrored = transmitter - 2.0 * (normal @ transmitter - scene.table[:, 3])[:, None] * normal
    order, groups = _neighbours(scene, reflects)
    around = bounds(receivers, 0, len(receivers))
    room = 1 << 20
    while True:
        pairs, second = np.empty((room, 2), np.int64), np.empty((room, 4))
        found = second_kernel.facet_pairs(
            scene.table, scene.boxes, order, groups, first[images.side[first] != 0.0], images, mirrored, around, pairs,
            second,
        )  # fmt: skip
        if found <= room:
            break
        room = found
    kept = _open_pairs(scene, transmitter, images, mirrored, pairs[:found])
    pairs, second = pairs[:found][kept], second[:found][kept]
    room = 64 * RECEIVERS_AT_ONCE
    pieces = [Found.of(np.empty(0, np.int64))]
    for begin in range(0, len(receivers), RECEIVERS_AT_ONCE):
        some = receivers[begin : begin + RECEIVERS_AT_ONCE]
        while True:
            hit, points = np.empty((room, 2), np.int64), np.empty((room, 2, 3))
            total = second_kernel.second_candidates(facets, images, pairs, second, some, BLOCKS, hit, points)
            if total <= room:
                break
            room = 2 * total
        row, both = hit[:total, 0], pairs[hit[:total, 1]]
        free = _free_paths(scene, transmitter, some[row], both, points[:total])
        pieces.append(Found.of(row[free] + begin, both[free], points[free]))
    return all_found(pieces)


def _neighbours(scene: Scene, reflects: NDArray[np.bool_]) -> tuple[Ints, Floats]:
    """Return the reflecting facets (R,), neighbours together, and boxes (G, 6) of each `GROUP` of them, in m."""
    from scipy.spatial import KDTree

    from cellslam.sim.rays.second_order_kernel import GROUP

    rows = np.flatnonzero(reflects)
    order = rows[KDTree(scene.boxes[rows, :3], leafsize=GROUP).indices]
    middle, half = scene.boxes[order, :3], scene.boxes[order, 3:]
    starts = np.arange(0, len(order), GROUP)
    low, high = np.minimum.reduceat(middle - half, starts), np.maximum.reduceat(middle + half, starts)
    return order, np.column_stack([low + high, high - low]) / 2.0


def _free_paths(scene: Scene, transmitter: Floats, receiver: Floats, facets: Ints, points: Floats) -> Ints:
    """Return the rows of which all three legs are free, the receiver's leg first: it kills most."""
    rows = np.arange(len(facets))
    share = _share(scene, facets[:, 1], receiver)
    rows = rows[scene.unobstructed(receiver, points[:, 1], 1.0 - share)]
    start, end = points[rows, 1], points[rows, 0]
    leave, arrive = _share(scene, facets[rows, 1], end), _share(scene, facets[rows, 0], start)
    # The middle leg starts on a wall: it is cut at both ends.
    origin = start + leave[:, None] * (end - start)
    left = np.maximum((1.0 - leave - arrive) / np.maximum(1.0 - leave, 1e-9), 0.0)
    rows = rows[scene.unobstructed(origin, end, left)]
    source = np.tile(transmitter, (len(rows), 1))
    return rows[scene.unobstructed(source, points[rows, 0], 1.0 - _share(scene, facets[rows, 0], source))]


def _share(scene: Scene, facet: Ints, origin: Floats) -> Floats:
    """Return which share of a ray from `origin` to the facet lies within the facet's clearance."""
    plane = scene.table[facet]
    distance = np.abs(np.einsum("pi,pi->p", plane[:, :3], origin) - plane[:, 3])
    return np.asarray(np.minimum(scene.clearance_m[facet] / np.maximum(distance, 1e-12), 1.0), np.float64)
