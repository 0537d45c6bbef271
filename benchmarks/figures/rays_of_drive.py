"""The rays of a drive in its city: plan, view from above, interactive page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.figures.city_pictures import draw_plan, draw_view
from cellslam.benchmarks.report.city_page import write_city

if TYPE_CHECKING:
    from cellslam.sim.world import World

SHOWN_SNAPSHOTS = 200


def draw_rays(world: World, folder: Path) -> list[Path]:
    """Write rays.png, rays-view.png and rays.html of a drive, at 200 of its snapshots; return their paths."""
    steps = np.arange(0, len(world.drive.poses), max(1, len(world.drive.poses) // SHOWN_SNAPSHOTS))
    poses = world.drive.poses[steps]
    paths, receivers = world.free_paths(poses, steps), np.ascontiguousarray(poses[:, :3])
    written = [folder / name for name in ("rays.png", "rays-view.png", "rays.html")]
    draw_plan(written[0], world.scene.city, paths, world.sites_m, receivers)
    draw_view(written[1], world.scene, paths, world.sites_m, receivers)
    write_city(written[2], world.scene.city, paths, world.sites_m, receivers)
    return written
