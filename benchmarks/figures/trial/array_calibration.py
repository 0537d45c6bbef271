"""The array's calibration as an estimator found it: mean, standard deviation, truth, difference, by direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import WIDTH_IN
from cellslam.benchmarks.scores.array_calibration import FieldMap, field_map
from cellslam.sim.recording import Floats
from cellslam.slam.model.calibration import COMPONENTS, Calibration

UNITS = {"distance": (1.0, "m"), "azimuth": (180.0 / np.pi, "deg"), "elevation": (180.0 / np.pi, "deg")}


def draw(figure: Figure, calibration: Calibration, provenance: Mapping[str, Any]) -> bool:
    """Draw a row for each component that the field has, over the directions that were met.

    `provenance`: of the recording; it says what the truth is. Returns False, and draws nothing, where nothing was met.
    """
    field = field_map(calibration, provenance)
    there = np.isfinite(field.mean[..., 0]).any(axis=1)
    if not there.any() or not calibration.components:
        return False
    rows = [COMPONENTS.index(name) for name in calibration.components]
    known = field.truth is not None
    figure.set_size_inches(WIDTH_IN * (1.0 if known else 0.6), 0.7 + 1.35 * len(rows))
    axes = figure.subplots(len(rows), 4 if known else 2, squeeze=False, sharex=True, sharey=True)
    for line, c in zip(axes, rows, strict=True):
        _row(figure, line, field, c)
    for one in axes[-1]:
        one.set(xlabel="azimuth (deg)", xticks=[-90, 0, 90])
    low, high = np.degrees(field.elevation_rad[there][[0, -1]])
    axes[0, 0].set_ylim(low - 3.0, high + 3.0)
    return True


def _row(figure: Figure, line: Any, field: FieldMap, c: int) -> None:
    """Draw one component: signed errors on one scale, the deviation on its own."""
    name = COMPONENTS[c]
    factor, unit = UNITS[name]
    signed, most = {"estimate": field.mean[..., c]}, float(np.nanmax(field.std[..., c]))
    if field.truth is not None:
        signed |= {"truth": field.truth[..., c], "difference": field.mean[..., c] - field.truth[..., c]}
    largest = factor * max(float(np.nanmax(np.abs(values))) for values in signed.values())
    order = ("estimate", "standard deviation", "truth", "difference")[: len(line)]
    for axes, title in zip(line, order, strict=True):
        if title in signed:
            image = _image(axes, field, factor * signed[title], "RdBu_r", (-largest, largest))
        else:
            image = _image(axes, field, factor * field.std[..., c], "viridis", (0.0, factor * most))
        if title in ("standard deviation", order[-1]):
            figure.colorbar(image, ax=axes, label=f"{name} error ({unit})" if title == order[-1] else None, aspect=12)
        if line[0].get_subplotspec().is_first_row():
            axes.set_title(title)
    line[0].set_ylabel("elevation (deg)")


def _image(axes: Axes, field: FieldMap, values: Floats, colours: str, span: tuple[float, float]) -> Any:
    axes.grid(False)
    azimuth, elevation = np.degrees(field.azimuth_rad), np.degrees(field.elevation_rad)
    return axes.pcolormesh(
        azimuth, elevation, np.ma.masked_invalid(values), cmap=colours, vmin=span[0], vmax=span[1], rasterized=True
    )
