"""Delay and azimuth against time, a row of two panels a link."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cellslam.benchmarks.figures.style import BLUE, WIDTH_IN, context
from cellslam.sim.frames import SPEED_OF_LIGHT_MPS
from cellslam.sim.recording import Ints, Recording

DOTS = 6000  # a panel
LINKS = 16


def draw(recording: Recording, path: Path) -> None:
    """Write the figure as PNG; of more than 16 links the first 16, of more than 6000 dots a link some of them."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    r = recording
    links = max(min(len(r.links), LINKS), 1)
    with context():
        figure = Figure(figsize=(WIDTH_IN, 0.6 + 1.05 * links), dpi=110)
        FigureCanvasAgg(figure)
        panels = figure.subplots(links, 2, squeeze=False, sharex=True)
        for link in range(links):
            rows = _some(np.flatnonzero(r.measurements.link == link))
            left, right = panels[link]
            time = (r.time_s - r.time_s[0])[r.measurements.snapshot[rows]]
            delay = r.measurements.distance_m[rows] / SPEED_OF_LIGHT_MPS * 1e6
            for axes, values in ((left, delay), (right, np.degrees(r.measurements.azimuth_rad[rows]))):
                axes.plot(time, values, ".", color=BLUE, markersize=1.2, rasterized=True)
                if not np.isfinite(values).any():
                    axes.text(0.5, 0.5, "not measured", transform=axes.transAxes, ha="center", va="center")
            right.set_ylim(-185, 185)
            right.set_yticks([-180, -90, 0, 90, 180])
            left.set_ylabel(f"{_name(r, link)}\ndelay (µs)", fontsize=7)
            right.set_ylabel("azimuth (deg)", fontsize=7)
        for axes in panels[-1]:
            axes.set_xlabel("time (s)")
            axes.set_xlim(0, max(float(r.time_s[-1] - r.time_s[0]), 1e-3))
        figure.subplots_adjust(
            left=0.11, right=0.985, top=0.99, bottom=0.42 / (0.6 + 1.05 * links), wspace=0.3, hspace=0.18
        )
        figure.savefig(path, format="png")


def _some(rows: Ints) -> Ints:
    return rows if len(rows) <= DOTS else rows[np.linspace(0, len(rows) - 1, DOTS).astype(np.int64)]


def _name(r: Recording, link: int) -> str:
    site = str(r.sites.name[r.links.site[link]])
    cell, port = int(r.links.cell_id[link]), int(r.links.port[link])
    return site + (f" {cell}" if cell >= 0 else "") + (f"/{port}" if port >= 0 else "")
