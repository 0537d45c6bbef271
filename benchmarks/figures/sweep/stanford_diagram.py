"""The Stanford diagram: protection level against error of every snapshot, an estimator a panel.

Above the diagonal the protection level holds. Below it the estimator misleads; where the protection level is below the
alert limit and the error above it, that is hazardous.

Source: Tossaint et al., "The Stanford-ESA integrity diagram", J. Institute of Navigation 54(2), 2007.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import BLACK, ORANGE, VERMILLION, WIDTH_IN, panels, plain_numbers
from cellslam.benchmarks.figures.sweep.sweep_data import SweepData
from cellslam.benchmarks.scores.metrics import ALERT_LIMIT_M, RISK
from cellslam.benchmarks.tables.integrity import regions
from cellslam.sim.recording import Floats

MOST_PANELS, BINS, LEAST_M = 6, 60, 0.02
ASIDE = 1.08  # factor between a text and the line beside it


def draw_stanford(figure: Figure, data: SweepData) -> bool:
    """Draw the diagram of each estimator over all worlds, of six at the most; False, and nothing, without claims."""
    found: dict[str, list[tuple[Floats, Floats]]] = {}
    for one in data.series:
        pairs = [drive.errors.protection() for drive in data.drives(one)]
        found.setdefault(one.label, []).extend(pair for pair in pairs if len(pair[0]))
    found = dict([(label, pairs) for label, pairs in found.items() if pairs][:MOST_PANELS])
    if not found:
        return False
    across = min(3, len(found))
    grid = panels(figure, len(found), across, (max(WIDTH_IN * across / 3, 3.4), 2.6), above_in=0.3, shared=True)
    most = max(float(max(error.max(), level.max())) for pairs in found.values() for error, level in pairs)
    edges = np.geomspace(LEAST_M, max(most, 10.0 * ALERT_LIMIT_M), BINS + 1)
    for axes, (label, pairs) in zip(grid, found.items(), strict=True):
        error, level = (np.concatenate(column) for column in zip(*pairs, strict=True))
        _panel(axes, error, level, edges)
        axes.set_title(label, fontsize=7.5)
    figure.supxlabel("horizontal error (m)", fontsize=8.5)
    figure.supylabel(f"protection level at a risk of {RISK:g} (m)", fontsize=8.5)
    return True


def _panel(axes: Axes, error: Floats, level: Floats, edges: Floats) -> None:
    counted, _, _ = np.histogram2d(np.clip(error, *edges[[0, -1]]), np.clip(level, *edges[[0, -1]]), (edges, edges))
    shades = LogNorm(1.0, max(2.0, float(counted.max())))
    axes.pcolormesh(
        edges, edges, np.where(counted > 0, counted, np.nan).T, norm=shades, cmap="viridis", rasterized=True
    )
    axes.plot(edges[[0, -1]], edges[[0, -1]], color=BLACK, linewidth=0.8)
    axes.axhline(ALERT_LIMIT_M, color=ORANGE, linewidth=0.9)
    axes.axvline(ALERT_LIMIT_M, color=ORANGE, linewidth=0.9)
    axes.fill_between([ALERT_LIMIT_M, edges[-1]], edges[0], ALERT_LIMIT_M, color=VERMILLION, alpha=0.2, linewidth=0)
    axes.set(xscale="log", yscale="log", xlim=edges[[0, -1]], ylim=edges[[0, -1]])
    for axis in (axes.xaxis, axes.yaxis):
        plain_numbers(axis)
    low, limit, high = edges[0] * ASIDE, ALERT_LIMIT_M, edges[-1] / ASIDE
    places = {
        "nominal": (low, limit / ASIDE, "left", "top"), "misleading": (limit / ASIDE, low, "right", "bottom"),
        "hazardous": (high, low, "right", "bottom"), "unavailable": (low, high, "left", "top"),
        "unavailable, misleading": (high, limit * ASIDE, "right", "bottom"),
    }  # fmt: skip
    for name, share in regions(error, level, ALERT_LIMIT_M).items():
        x, y, side, end = places[name]
        text = f"{name.rpartition(', ')[2]}\n{100 * share:.3g} %"
        behind = {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 1}
        axes.text(x, y, text, fontsize=6, ha=side, va=end, bbox=behind)
