"""The viewer's page of a city, with rays if there are any: a step of its slider is a receiver."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.figures.city_pictures import draw_plan, draw_view
from cellslam.benchmarks.report.page import write_page
from cellslam.benchmarks.report.scene import box_of, mesh_of, rays_of, rounded
from cellslam.sim.city.city import GROUND, City, Floats
from cellslam.sim.rays.exchange.traced_paths import Traced

if TYPE_CHECKING:
    from cellslam.sim.world import World

MOST_RAYS = 6000
SHOWN_SNAPSHOTS = 200
MOST_RECEIVERS = 2000
KINDS = ("lines of sight", "single reflections", "double reflections", "diffracted")
NOWHERE = np.empty((0, 3))


def write_city(path: Path, city: City, rays: Traced | None = None) -> None:
    """Write the page of a city, with rays if there are any.

    Of more than 6000 rays or 2000 receivers, those of every n-th receiver. Raises InputError without plotly.
    """
    transmitters, receivers = (NOWHERE, NOWHERE) if rays is None else (rays.transmitters_m, rays.receivers_m)
    count = 0 if rays is None else len(rays.paths)
    stride = max(1, -(-len(receivers) // MOST_RECEIVERS), -(-count // MOST_RAYS))
    rows = np.arange(0, len(receivers), stride)
    box = _box(city, transmitters, receivers)
    scene: dict[str, Any] = {
        "sites": [f"transmitter {number}" for number in range(len(transmitters))],
        "site_positions": rounded(transmitters.T, 1),
        **({"truth": rounded(receivers[rows].T, 2), "truth_name": "receivers"} if len(receivers) else {}),
        "rays": [] if rays is None else rays_of(rays.paths, len(receivers))[::stride],
        "box": rounded(box.T, 0),
        "city": "city",
    }
    section = {"time": rows.tolist(), "counts": "receiver", "at_once": True, "estimates": [], "scene": scene}
    content = {
        "title": f"{'Rays' if count else 'City'}: {city.name}",
        "lead": _lead(rays, stride),
        "series": [],
        "heading": "Rays" if count else "City",
        "trials": [section],
        "cities": {"city": mesh_of(city, box)},
    }
    write_page(path, content)


def draw_rays(world: World, folder: Path) -> None:
    """Write rays.png, rays-view.png and rays.html of a drive, at 200 of its snapshots."""
    steps = np.arange(0, len(world.drive.poses), max(1, len(world.drive.poses) // SHOWN_SNAPSHOTS))
    poses = world.drive.poses[steps]
    rays = Traced(world.free_paths(poses, steps), world.sites_m, poses[:, :3])
    draw_plan(folder / "rays.png", world.scene.city, rays)
    draw_view(folder / "rays-view.png", world.scene.city, rays)
    write_city(folder / "rays.html", world.scene.city, rays)


def _box(city: City, transmitters: Floats, receivers: Floats) -> Floats:
    """Return the box of what there is to see: the ground may reach far beyond the buildings."""
    walls = city.triangles[city.facets.building[city.triangle_facet] != GROUND]
    built = city.vertices[np.unique(walls)] if len(walls) else city.bounds
    return box_of(np.concatenate([built, transmitters, receivers]))


def _lead(rays: Traced | None, stride: int) -> str:
    if rays is None:
        return "A city. Colours are materials; a name in the legend switches what it names off and on."
    found = zip(np.bincount(rays.paths.kind, minlength=len(KINDS)), KINDS, strict=True)
    counts = [f"{count} {name}" for count, name in found if count]
    thinned = f" Drawn are those of every {stride}th receiver." if stride > 1 else ""
    return f"{len(rays.paths)} paths to {len(rays.receivers_m)} receivers: {', '.join(counts) or 'none'}.{thinned}"
