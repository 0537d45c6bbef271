"""What the viewer shows of a world in three dimensions: city, sites, true drive, rays and VTs at each step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cellslam.benchmarks.figures.style import material_colour
from cellslam.sim.city.city import GROUND, City
from cellslam.sim.recording import Floats, Ints

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths
    from cellslam.sim.traffic import Traffic
    from cellslam.sim.world import World

# What is farther than this from drive and sites is not shown.
MARGIN_M = 100.0
FLAT_M = 0.5
# The page's light, from the south-east and above.
TO_LIGHT = np.array([1.0, -2.0, 3.0])

Cities = dict[str, Mapping[str, Any]]


def rounded(values: Any, digits: int = 2) -> Any:
    """Return an array as nested lists of short numbers, what is not finite as None."""
    array = np.asarray(values, np.float64)
    if array.ndim > 1:
        return [rounded(row, digits) for row in array]
    short = np.round(array, digits) + 0.0
    whole = digits <= 0
    return [(int(v) if whole else v) if np.isfinite(v) else None for v in short.tolist()]


def scene_of(world: World, steps: Ints) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """Return sites, drive, rays and true VTs of a world at snapshots `steps` (n,), and the part of the city around
    them."""
    from cellslam.sim.world import virtual_transmitters

    poses = world.drive.poses[steps]
    paths = world.free_paths(poses, steps)
    vts, path_vt = virtual_transmitters(paths)
    box = box_of(np.concatenate([poses[:, :3], world.sites_m]))
    scene = {
        "sites": [site.name for site in world.config.sites],
        "site_positions": rounded(world.sites_m.T, 1),
        "truth": rounded(poses[:, :3].T, 2),
        "rays": rays_of(paths, len(poses)),
        "vts": rounded(vts.position_m.T, 1),
        "visible": _visible(paths, path_vt, len(poses)),
        "box": rounded(box.T, 0),
        "vehicles": vehicles_of(world.traffic, steps * world.config.vehicle.snapshot_interval_s),
    }
    return scene, mesh_of(world.scene.city, box)


def vehicles_of(traffic: Traffic | None, time_s: NDArray[np.floating[Any]]) -> dict[str, Any] | None:
    """Return sizes of other vehicles, and at each of `time_s` (n,) x, y, ground and yaw of each; None without any."""
    if traffic is None:
        return None
    return {"size": rounded(traffic.size_m, 2), "poses": [rounded(now, 2) for now in traffic.at(time_s)]}


def mesh_of(city: City, box: Floats) -> dict[str, Any]:
    """Return the buildings (whole) and the ground of a city within a box (2, 2) in m, as meshes of one colour each."""
    corners = city.vertices[city.triangles]
    inside = ((corners[:, :, :2] >= box[0]) & (corners[:, :, :2] <= box[1])).all(axis=2).any(axis=1)
    building = city.facets.building[city.triangle_facet]
    near = np.isin(building, np.unique(building[inside & (building != GROUND)]))
    material = np.array([m.name for m in city.materials])[city.facets.material[city.triangle_facet]]
    ground = building == GROUND
    walls = [_mesh(city, near & ~ground & (material == name), name) for name in np.unique(material[near & ~ground])]
    return {"name": city.name, "parts": [_ground(city, ground, inside, box), *walls]}


def box_of(points: Floats) -> Floats:
    """Return the corners (2, 2) of the horizontal box around points (n, 3) in m, with a margin."""
    return np.stack([np.nanmin(points[:, :2], axis=0) - MARGIN_M, np.nanmax(points[:, :2], axis=0) + MARGIN_M])


def rays_of(paths: Paths, steps: int) -> list[list[list[float]]]:
    """Return for each step, which is a receiver, its rays: kind, number of the site, then x, y, z of each point between
    site and receiver."""
    out: list[list[list[float]]] = [[] for _ in range(steps)]
    points = np.round(paths.points_m, 1)
    rows = zip(paths.receiver.tolist(), paths.kind.tolist(), paths.transmitter.tolist(), points, strict=True)
    for step, number, site, own in rows:
        out[step].append([number, site, *own[~np.isnan(own[:, 0])].ravel().tolist()])
    return out


def _ground(city: City, ground: Any, inside: Any, box: Floats) -> dict[str, Any]:
    """Return the ground; where it is flat, one rectangle."""
    heights = city.vertices[city.triangles[ground]][:, :, 2]
    if ground.any() and np.ptp(heights) >= FLAT_M:
        return _mesh(city, ground & inside, "ground")
    level = float(np.median(heights)) if ground.any() else float(city.vertices[:, 2].min())
    (x0, y0), (x1, y1) = box.tolist()
    corners = {"x": [x0, x1, x1, x0], "y": [y0, y0, y1, y1], "z": [round(level, 1)] * 4}
    return {**_named("ground"), **corners, "i": [0, 0], "j": [1, 2], "k": [2, 3], "bright": [9, 9]}


def _mesh(city: City, chosen: Any, name: str) -> dict[str, Any]:
    """Return some triangles of a city as vertices, indices and how bright each is (0 to 9), all of one material."""
    used, renumbered = np.unique(city.triangles[chosen], return_inverse=True)
    i, j, k = renumbered.reshape(-1, 3).T.tolist()
    x, y, z = rounded(city.vertices[used].T, 1)
    corners = city.vertices[city.triangles[chosen]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Either side of a triangle may be the outer one.
    bright = np.abs(normal @ TO_LIGHT) / np.maximum(np.linalg.norm(normal, axis=1) * np.linalg.norm(TO_LIGHT), 1e-9)
    return {**_named(name), "x": x, "y": y, "z": z, "i": i, "j": j, "k": k, "bright": rounded(9 * bright, 0)}


def _named(material: str) -> dict[str, Any]:
    """Return what a mesh is called, and its colour as red, green, blue up to 255."""
    colour = [round(255 * share) for share in material_colour(material)]
    return {"name": material.replace("_", " "), "colour": colour}


def _visible(paths: Paths, path_vt: Ints, steps: int) -> list[list[int]]:
    """Return for each step the true VTs from which a path arrives."""
    out: list[list[int]] = [[] for _ in range(steps)]
    for step, vt in zip(paths.receiver.tolist(), path_vt.tolist(), strict=True):
        if vt >= 0:
            out[step].append(vt)
    return out
