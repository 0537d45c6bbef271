"""One frame of an environment: city, sites, the paths of this snapshot, truth, belief and its ellipse."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.recording import Floats, Recording

SIZE_PX, DPI = 480, 96
NEAR_M = 60.0
SIGMAS = 2.4477  # 95 % of a Gaussian in the plane


def picture(
    recording: Recording, now: int, belief: Floats, covariance: Floats | None, city: Any = None
) -> NDArray[np.uint8]:
    """Return an image (480, 480, 3): truth black, belief orange with its 95 % ellipse, true paths of snapshot `now`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    truth = recording.truth
    figure = Figure(figsize=(SIZE_PX / DPI, SIZE_PX / DPI), dpi=DPI)
    canvas: Any = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for outline in () if city is None else city.footprints:
        axes.fill(*np.array(outline.exterior.coords).T[:2], color="0.8", linewidth=0)
    if truth is not None:
        here, rows = truth.poses[now], slice(*recording.rows[now : now + 2])
        for vt in np.unique(truth.measurement_vt[rows]):
            if vt >= 0:
                x, y = truth.vts.position_m[vt, :2]
                axes.plot([here[0], x], [here[1], y], color="tab:blue", linewidth=0.6, alpha=0.6)
        axes.plot(*truth.poses[: now + 1, :2].T, color="black", linewidth=1.2)
        axes.plot(*truth.site_positions_m[:, :2].T, "^", color="tab:blue")
    axes.plot(belief[0], belief[1], "o", color="tab:orange", markersize=5)
    axes.plot(*(belief[:2, None] + [[0, 4 * np.cos(belief[3])], [0, 4 * np.sin(belief[3])]]), color="tab:orange")
    if covariance is not None:
        values, basis = np.linalg.eigh(covariance[:2, :2])
        angle = np.linspace(0, 2 * np.pi, 61)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        ring = belief[:2, None] + SIGMAS * (basis * np.sqrt(np.maximum(values, 0.0))) @ circle
        axes.plot(*ring, color="tab:orange", linewidth=1)
    centre = truth.poses[now] if truth is not None else belief
    axes.set_xlim(centre[0] - NEAR_M, centre[0] + NEAR_M)
    axes.set_ylim(centre[1] - NEAR_M, centre[1] + NEAR_M)
    axes.set_aspect("equal")
    axes.set_axis_off()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
