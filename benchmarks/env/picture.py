"""One frame of an environment: city, sites, route, directions of the paths, truth, belief and its ellipse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.city.city import City
from cellslam.sim.recording import Floats

SIZE_PX, DPI = 480, 96
NEAR_M = 60.0
SIGMAS = 2.4477  # 95 % of a Gaussian in the plane


@dataclass(frozen=True)
class Scene:
    """What is true: city; track (n, 6) so far; VTs seen now (v, 3); sites (S, 3); the route (r, 2) or None."""

    city: City
    track: Floats
    vts_m: Floats
    sites_m: Floats
    route_m: Floats | None = None


def picture(scene: Scene, belief: Floats, covariance: Floats | None) -> NDArray[np.uint8]:
    """Return an image (480, 480, 3), 120 m wide: truth black, belief (6,) orange with its 95 % ellipse, paths blue.

    A path is drawn as the line to its VT.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SIZE_PX / DPI, SIZE_PX / DPI), dpi=DPI)
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    here = scene.track[-1]
    for outline in scene.city.footprints:
        axes.fill(*np.array(outline.exterior.coords).T[:2], color="0.8", linewidth=0)
    if scene.route_m is not None:
        axes.plot(*scene.route_m.T, color="tab:green", linewidth=0.8, linestyle="--")
    for x, y, _ in scene.vts_m:
        axes.plot([here[0], x], [here[1], y], color="tab:blue", linewidth=0.6, alpha=0.6)
    axes.plot(*scene.track[:, :2].T, color="black", linewidth=1.2)
    axes.plot(*scene.sites_m[:, :2].T, "^", color="tab:blue")
    nose = belief[:2] + 4.0 * np.array([np.cos(belief[3]), np.sin(belief[3])])
    axes.plot(*belief[:2], "o", color="tab:orange", markersize=5)
    axes.plot([belief[0], nose[0]], [belief[1], nose[1]], color="tab:orange")
    if covariance is not None:
        axes.plot(*_ellipse(belief, covariance), color="tab:orange", linewidth=1)
    axes.set_xlim(here[0] - NEAR_M, here[0] + NEAR_M)
    axes.set_ylim(here[1] - NEAR_M, here[1] + NEAR_M)
    axes.set_aspect("equal")
    axes.set_axis_off()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()


def _ellipse(belief: Floats, covariance: Floats) -> Floats:
    """Return the outline (2, 61) that holds the position with 95 %."""
    values, basis = np.linalg.eigh(covariance[:2, :2])
    angle = np.linspace(0, 2 * np.pi, 61)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    ring: Floats = belief[:2, None] + SIGMAS * (basis * np.sqrt(np.maximum(values, 0.0))) @ circle
    return ring
