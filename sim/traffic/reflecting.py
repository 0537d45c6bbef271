"""Paths over one side of a lorry or bus: virtual transmitters that move.

The sides are plane and of metal. Doppler is that of a standing side.

Source: image method; gains as those of walls, docs/explanation/rays.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import azimuth_elevation
from cellslam.sim.recording import Floats, Ints
from cellslam.sim.traffic.traffic import LONGEST_STEP_M, Traffic
from cellslam.sim.traffic.traffic_config import KINDS

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths, Scene

FIRST = -2  # what stands for vehicle 0 in `Paths.facets`; -3 for vehicle 1, and so on


def reflecting_vehicle(facets: Ints) -> Ints:
    """Return the vehicle (P,) that the paths with facets (P, 2) are reflected by, -1 none; rows."""
    return np.where(facets[:, 0] <= FIRST, FIRST - facets[:, 0], -1)


def reflected_paths(
    traffic: Traffic, scene: Scene, transmitters_m: Floats, receivers_m: Floats, time_s: Floats, carrier_hz: float
) -> list[Paths]:
    """Return the paths from each transmitter (S, 3) to receivers (R, 3), in m, at times (R,) in s, over one side of a
    vehicle: those that no building blocks, whatever vehicles do."""
    from cellslam.sim.traffic.reflecting_kernel import mirror_points

    mirrors = np.flatnonzero(np.isin(traffic.kind, [kind.name for kind in KINDS if kind.reflects]))
    steps = traffic.steps(time_s)
    out = []
    for site, transmitter in enumerate(transmitters_m):
        rows, point, normal = mirror_points(
            transmitter, receivers_m, steps, traffic.poses, LONGEST_STEP_M, traffic.size_m, mirrors
        )
        free = _free(scene, receivers_m[rows[:, 0]], point) & _free(scene, point, transmitter)
        out.append(_paths(site, transmitter, receivers_m, rows[free], point[free], normal[free], carrier_hz))
    return out


def _free(scene: Scene, start_m: Floats, end_m: Floats) -> NDArray[np.bool_]:
    """Return whether no building is between points (n, 3)."""
    from cellslam.sim.rays.first_order import unobstructed
    from cellslam.sim.rays.scene import CLEARANCE_M

    away = np.linalg.norm(end_m - start_m, axis=1)
    reach = np.maximum(1.0 - CLEARANCE_M / np.maximum(away, CLEARANCE_M), 0.0)
    ends = np.broadcast_to(end_m, start_m.shape)
    return unobstructed(scene, start_m - scene.origin_m, ends - scene.origin_m, reach)


def _paths(
    site: int, transmitter: Floats, receivers_m: Floats, rows: Ints, point: Floats, normal: Floats, carrier_hz: float
) -> Paths:
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
