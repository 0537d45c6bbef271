"""What vehicles do to the paths of a drive: they block them, and the long sides of lorries and buses reflect.

A side that reflects is a virtual transmitter that moves; it is plane and of metal, and Doppler is that of a standing
side. Waves that bend round vehicles are left out. Source: image method; gains as those of walls,
docs/explanation/rays.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.described import Described
from cellslam.sim.frames import azimuth_elevation
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.traffic.traffic import Traffic
from cellslam.sim.traffic.traffic_config import KINDS

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths, Scene

FIRST = -2  # what stands for vehicle 0 in `Paths.facets`; -3 for vehicle 1, and so on


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


def blocked_paths(
    traffic: Traffic | None, paths: Paths, transmitters_m: Floats, receivers_m: Floats, time_s: Floats
) -> Blocked:
    """Return what vehicles block of paths from transmitters (S, 3) to receivers (R, 3), in m, at times (R,) in s."""
    if traffic is None or not len(paths):
        return Blocked(np.empty(0, np.int64), np.empty(0, np.int64))
    from cellslam.sim.traffic.boxes_kernel import Lines, blocking_pairs

    points = (~np.isnan(paths.points_m[:, :, 0])).sum(axis=1)
    corners = np.empty((len(paths), 4, 3))
    corners[:, 0], corners[:, 1:3] = transmitters_m[paths.transmitter], paths.points_m
    corners[np.arange(len(paths)), points + 1] = receivers_m[paths.receiver]
    lines = Lines(traffic.steps(time_s)[paths.receiver], corners, points + 2, reflecting_vehicle(paths.facets))
    pairs = blocking_pairs(lines, traffic.poses, traffic.size_m)
    return Blocked(pairs[:, 0].copy(), pairs[:, 1].copy())


def reflecting_vehicle(facets: Ints) -> Ints:
    """Return the vehicle (P,) that the paths with facets (P, 2) are reflected by, -1 none; rows."""
    return np.where(facets[:, 0] <= FIRST, FIRST - facets[:, 0], -1)


def reflected_paths(
    traffic: Traffic, scene: Scene, transmitters_m: Floats, receivers_m: Floats, time_s: Floats, carrier_hz: float
) -> list[Paths]:
    """Return the paths from each transmitter (S, 3) to receivers (R, 3), in m, at times (R,) in s, over one side of a
    vehicle: those that no building blocks, whatever vehicles do."""
    from cellslam.sim.traffic.boxes_kernel import mirror_points

    mirrors = np.flatnonzero(np.isin(traffic.kind, [kind.name for kind in KINDS if kind.reflects]))
    steps = traffic.steps(time_s)
    out = []
    for site, transmitter in enumerate(transmitters_m):
        rows, point, normal = mirror_points(transmitter, receivers_m, steps, traffic.poses, traffic.size_m, mirrors)
        free = scene.free(receivers_m[rows[:, 0]], point)
        free &= scene.free(point, np.broadcast_to(transmitter, point.shape))
        out.append(_described(site, transmitter, receivers_m, rows[free], point[free], normal[free], carrier_hz))
    return out


def _described(
    site: int, transmitter: Floats, receivers_m: Floats, rows: Ints, point: Floats, normal: Floats, carrier_hz: float
) -> Paths:
    """Return the paths (n,) by way of points (n, 3) of the vehicles and receivers in `rows` (n, 2)."""
    from cellslam.sim.city.materials import itu_material
    from cellslam.sim.rays.gain import path_gain
    from cellslam.sim.rays.paths import Paths

    count = len(rows)
    receiver = receivers_m[rows[:, 0]]
    vt = transmitter - 2.0 * ((transmitter - point) * normal).sum(axis=1, keepdims=True) * normal
    corners = np.stack([np.broadcast_to(transmitter, point.shape), point, receiver, receiver], axis=1)
    number, order = np.arange(count)[:, None], np.ones(count, np.int64)
    metal = [itu_material("metal")]
    gain = path_gain(corners, order, number, normal, np.zeros(count, np.int64), metal, carrier_hz)
    arrival, departure = azimuth_elevation(vt - receiver), azimuth_elevation(point - transmitter)
    nowhere = np.full_like(point, np.nan)
    return Paths(
        receiver=rows[:, 0], transmitter=np.full(count, site, np.int64), order=order,
        facets=np.column_stack([FIRST - rows[:, 1], np.full(count, -1, np.int64)]), edge=np.full(count, -1, np.int64),
        points_m=np.stack([point, nowhere], axis=1), vt_position_m=vt, length_m=np.linalg.norm(vt - receiver, axis=1),
        azimuth_rad=arrival[0], elevation_rad=arrival[1],
        departure_azimuth_rad=departure[0], departure_elevation_rad=departure[1], gain=gain,
    )  # fmt: skip
