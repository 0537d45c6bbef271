"""What a report shows of a world in three dimensions: city, sites, true drive, rays and VTs at each step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.report.choice import rounded
from cellslam.sim.city.city import GROUND, City
from cellslam.sim.recording import Floats, Ints

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths
    from cellslam.sim.world import World

# What is farther than this from drive and sites is not shown.
MARGIN_M = 100.0
FLAT_M = 0.5
# The page's light, from the south-east and above.
TO_LIGHT = np.array([1.0, -2.0, 3.0])


def scene_of(world: World, steps: Ints) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """Return sites, drive, rays and true VTs of a world at snapshots `steps` (n,), and the part of the city around
    them."""
    from cellslam.sim.world import virtual_transmitters

    poses = world.drive.poses[steps]
    paths = world.free_paths(poses, steps)
    vts, path_vt = virtual_transmitters(paths)
    box = _box(np.concatenate([poses[:, :3], world.sites_m]))
    scene = {
        "sites": [site.name for site in world.config.sites],
        "site_positions": rounded(world.sites_m.T, 1),
        "truth": rounded(poses[:, :3].T, 2),
        "rays": _rays(paths, len(poses)),
        "vts": rounded(vts.position_m.T, 1),
        "visible": _visible(paths, path_vt, len(poses)),
        "box": rounded(box.T, 0),
        "vehicles": _vehicles(world, steps),
    }
    return scene, mesh_of(world.scene.city, box)


def _vehicles(world: World, steps: Ints) -> dict[str, Any] | None:
    """Return sizes of other vehicles, and for each step x, y, ground and yaw of each of them."""
    if world.traffic is None:
        return None
    poses = world.traffic.at(steps * world.config.vehicle.snapshot_interval_s)
    return {"size": rounded(world.traffic.size_m, 2), "poses": [rounded(now, 2) for now in poses]}


def mesh_of(city: City, box: Floats) -> dict[str, Any]:
    """Return the buildings (whole) and the ground of a city within a box (2, 2) in m, each as vertices and
    triangles."""
    corners = city.vertices[city.triangles]
    inside = ((corners[:, :, :2] >= box[0]) & (corners[:, :, :2] <= box[1])).all(axis=2).any(axis=1)
    building = city.facets.building[city.triangle_facet]
    near = np.isin(building, np.unique(building[inside & (building != GROUND)]))
    ground = building == GROUND
    heights = corners[ground][:, :, 2]
    if not ground.any() or np.ptp(heights) < FLAT_M:
        level = float(np.median(heights)) if ground.any() else float(city.vertices[:, 2].min())
        (x0, y0), (x1, y1) = box.tolist()
        corners_xyz = {"x": [x0, x1, x1, x0], "y": [y0, y0, y1, y1], "z": [round(level, 1)] * 4}
        floor = {**corners_xyz, "i": [0, 0], "j": [1, 2], "k": [2, 3], "bright": [9, 9]}
    else:
        floor = _mesh(city, ground & inside)
    return {"name": city.name, "buildings": _mesh(city, near & ~ground), "ground": floor}


def _mesh(city: City, chosen: Any) -> dict[str, Any]:
    """Return some triangles of a city as vertices, indices and how bright each is (0 to 9)."""
    used, renumbered = np.unique(city.triangles[chosen], return_inverse=True)
    i, j, k = renumbered.reshape(-1, 3).T.tolist()
    x, y, z = rounded(city.vertices[used].T, 1)
    corners = city.vertices[city.triangles[chosen]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Either side of a triangle may be the outer one.
    bright = np.abs(normal @ TO_LIGHT) / np.maximum(np.linalg.norm(normal, axis=1) * np.linalg.norm(TO_LIGHT), 1e-9)
    return {"x": x, "y": y, "z": z, "i": i, "j": j, "k": k, "bright": rounded(9 * bright, 0)}


def _box(points: Floats) -> Floats:
    """Return the corners (2, 2) of the horizontal box around points, with a margin."""
    return np.stack([points[:, :2].min(axis=0) - MARGIN_M, points[:, :2].max(axis=0) + MARGIN_M])


def _rays(paths: Paths, steps: int) -> list[list[list[float]]]:
    """Return for each step its rays: number of the site, then x, y, z of each point between site and vehicle."""
    out: list[list[list[float]]] = [[] for _ in range(steps)]
    points = np.round(paths.points_m, 1)
    for step, site, own in zip(paths.receiver.tolist(), paths.transmitter.tolist(), points, strict=True):
        out[step].append([site, *own[~np.isnan(own[:, 0])].ravel().tolist()])
    return out


def _visible(paths: Paths, path_vt: Ints, steps: int) -> list[list[int]]:
    """Return for each step the true VTs from which a path arrives."""
    out: list[list[int]] = [[] for _ in range(steps)]
    for step, vt in zip(paths.receiver.tolist(), path_vt.tolist(), strict=True):
        if vt >= 0:
            out[step].append(vt)
    return out
