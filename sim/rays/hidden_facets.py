"""Which facets stand wholly behind others, as seen from a point: they need no further thought.

Source: own derivation, docs/explanation/rays.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import Floats, Ints
from cellslam.sim.rays.first_order import first_hits
from cellslam.sim.rays.scene import Scene

# A corner counts as hidden if what hides it stands at least this far in front of it.
HIDDEN_M = 0.01


def lit_facets(scene: Scene, transmitter: Floats, reflects: NDArray[np.bool_]) -> Ints:
    """Return the facets (L,) of which the transmitter (3,), centred, in m, may see a part; none is missing."""
    rows = np.flatnonzero(reflects)
    table = scene.table[rows]
    u, v = table[:, [10, 11, 11, 10]], table[:, [12, 12, 13, 13]]
    corners = u[:, :, None] * table[:, None, 4:7] + v[:, :, None] * table[:, None, 7:10]
    corners += (table[:, 3:4] * table[:, :3])[:, None]
    height = np.abs(table[:, :3] @ transmitter - table[:, 3])
    clearance = scene.clearance_m[rows] / np.maximum(height, 1e-12)
    start = np.broadcast_to(transmitter, corners.shape)
    return np.asarray(rows[~hidden(scene, start, corners, np.repeat(clearance, 4))], np.int64)


def hidden(scene: Scene, origins: Floats, targets: Floats, clearance: Floats | float = 0.0) -> NDArray[np.bool_]:
    """Tell which windows (N, 4, 3) stand wholly behind one convex facet, as seen from a point.

    The rays `origins` -> `targets` lie on lines through that point. If all four end on one convex facet before they
    reach the window, so do all between them: no window of which a part is seen is said to be hidden. What hides
    it meets the rays before the last centimetre and the last share `clearance` (4 N,) of them.
    """
    away = (targets - origins).reshape(-1, 3)
    last = np.maximum(HIDDEN_M / np.maximum(np.linalg.norm(away, axis=1), HIDDEN_M), clearance)
    reach = np.maximum(1.0 - last, 0.0)
    triangle = first_hits(scene, origins.reshape(-1, 3), targets.reshape(-1, 3), reach)
    by = np.where(triangle >= 0, scene.city.triangle_facet[triangle], -1).reshape(-1, 4)
    return np.asarray((by[:, 0] >= 0) & (by == by[:, :1]).all(axis=1) & scene.convex[by[:, 0]], np.bool_)
