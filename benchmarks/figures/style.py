"""One look for all figures: colours that the colour-blind tell apart (Okabe and Ito, 2008), paper sizes."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILLION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
GREY, LIGHT, BUILDING, EMPHASIS = "#999999", "#DDDDDD", "#E4E1DC", "#A79F92"
TRUTH, VT, VEHICLES = BLACK, GREEN, "#5B6B8C"
SITES = (VERMILLION, GREEN, PURPLE, ORANGE, SKY)
LANDMARKS = (BLUE, ORANGE, GREEN, PURPLE, VERMILLION, SKY, "#7A5C00", "#5D3A9B")
WIDTH_IN = 7.16
PIXELS_PER_INCH = 160
TITLE = 40  # characters in a line of a title over half of the width


def context() -> AbstractContextManager[None]:
    """Return the context in which figures are drawn and saved."""
    settings: dict[Any, Any] = {
        "font.size": 8.5,
        "axes.titlesize": 9,
        "axes.labelsize": 8.5,
        "legend.fontsize": 7.5,
        "legend.framealpha": 0.9,
        "legend.edgecolor": LIGHT,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#EEEEEE",
        "axes.axisbelow": True,
        "lines.linewidth": 1.4,
        "savefig.dpi": PIXELS_PER_INCH,
        "pdf.fonttype": 42,
    }
    return mpl.rc_context(settings)


def estimator_styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the line of each estimator: dead reckoning dashed in orange, the others in solid colours."""
    colours = [BLUE, GREEN, PURPLE, VERMILLION, SKY, "#7A5C00", YELLOW]
    styles: dict[str, dict[str, Any]] = {}
    for name in names:
        if name == "dead-reckoning":
            styles[name] = {"color": ORANGE, "linestyle": "--", "label": name}
        else:
            index = sum(other != "dead-reckoning" for other in styles)
            styles[name] = {"color": colours[index % len(colours)], "linestyle": "-", "label": name}
    return styles


def save(figure: Figure, path: Path) -> Path:
    """Write a figure without date and software name (same figure, same file) and return its path."""
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}}.get(path.suffix[1:])
    figure.savefig(path, metadata=metadata)
    return path
