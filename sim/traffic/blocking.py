"""Which of a drive's paths are blocked by which vehicle. Waves that bend round vehicles are left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import Described
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.traffic.reflecting import reflecting_vehicle
from cellslam.sim.traffic.traffic import LONGEST_STEP_M, Traffic

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths


@dataclass(frozen=True, repr=False)
class Blocked(Described):
    """Which path is blocked by which vehicle: rows `path` (B,), sorted, and `vehicle` (B,); by several at once, too."""

    path: Ints
    vehicle: Ints

    def free(self, paths: int) -> NDArray[np.bool_]:
        """Return which of so many paths are not blocked, (P,), without unit."""
        out = np.ones(paths, np.bool_)
        out[self.path] = False
        return out


NOTHING_BLOCKED = Blocked(np.empty(0, np.int64), np.empty(0, np.int64))


def blocked_paths(
    traffic: Traffic | None, paths: Paths, transmitters_m: Floats, receivers_m: Floats, time_s: Floats
) -> Blocked:
    """Return what vehicles block of paths from transmitters (S, 3) to receivers (R, 3), in m, at times (R,) in s."""
    if traffic is None or not len(paths):
        return NOTHING_BLOCKED
    from cellslam.sim.traffic.blocking_kernel import Lines, blocking_pairs

    points = (~np.isnan(paths.points_m[:, :, 0])).sum(axis=1)
    corners = np.empty((len(paths), 4, 3))
    corners[:, 0], corners[:, 1:3] = transmitters_m[paths.transmitter], paths.points_m
    corners[np.arange(len(paths)), points + 1] = receivers_m[paths.receiver]
    lines = Lines(traffic.steps(time_s)[paths.receiver], corners, points + 2, reflecting_vehicle(paths.facets))
    pairs = blocking_pairs(lines, traffic.poses, LONGEST_STEP_M, traffic.size_m)
    return Blocked(pairs[:, 0].copy(), pairs[:, 1].copy())
