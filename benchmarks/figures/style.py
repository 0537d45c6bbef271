"""One look for all figures: colours that the colour-blind tell apart (Okabe and Ito, 2008), paper sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any
from zlib import crc32

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline

from cellslam.benchmarks.trials.output_files import writing
from cellslam.sim.progress import Progress, silent

Drawing = Callable[[Figure], bool]  # False: the figure does not apply, and nothing was drawn

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILLION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
GREY, LIGHT, BUILDING, EMPHASIS = "#999999", "#DDDDDD", "#E4E1DC", "#A79F92"
TRUTH, VT, VEHICLES, WALL = BLACK, GREEN, "#5B6B8C", "#3D1A78"
SITES = (VERMILLION, GREEN, PURPLE, ORANGE, SKY)
LANDMARKS = (BLUE, ORANGE, GREEN, PURPLE, VERMILLION, SKY, "#7A5C00", "#5D3A9B")
ESTIMATORS = {
    "fastslam": BLUE, "dead-reckoning": ORANGE, "ekf-slam": GREEN, "bp-slam": PURPLE, "phd-slam": VERMILLION,
    "paper-fastslam": SKY, "smoother": "#7A5C00", "oracle-association": "#5D3A9B",
    "oracle-fastslam": "#2E3A87", "oracle-map": "#8C1D40", "wall-slam": "#117733",
}  # fmt: skip
OTHERS = ("#44AA99", "#AA4499", "#999933", "#661100")
DASHES, PALEST = ("-", "-.", ":"), 0.6
WIDTH_IN = 7.16
PIXELS_PER_INCH = 160
# Materials of a city, as red, green, blue; the ground last.
MATERIALS = {
    "concrete": (0.80, 0.78, 0.74), "brick": (0.78, 0.56, 0.46), "glass": (0.58, 0.75, 0.84),
    "metal": (0.66, 0.69, 0.73), "wood": (0.76, 0.63, 0.44), "marble": (0.90, 0.88, 0.84), "ground": (0.90, 0.91, 0.87),
}  # fmt: skip
OTHER_MATERIAL = (0.77, 0.73, 0.80)
HALF_WIDTH_IN = (0.62 * WIDTH_IN, 3.2)
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


def estimator_styles(labels: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the line of each series, "estimator" or "estimator, what varies": an estimator has one colour everywhere.

    Series of one estimator are shades of its colour and differ in their dashes; dead reckoning is dashed.
    """
    of = {label: label.partition(", ")[0] for label in labels}
    styles: dict[str, dict[str, Any]] = {}
    for label, name in of.items():
        same = [other for other in of if of[other] == name]
        index = same.index(label)
        dashes = "--" if name == "dead-reckoning" else DASHES[index % len(DASHES)]
        white = PALEST * index / max(len(same) - 1, 2)
        red, green, blue = ((1.0 - white) * part + white for part in to_rgb(colour_of(name)))
        styles[label] = {"color": to_hex((red, green, blue)), "linestyle": dashes, "label": label}
    return styles


def colour_of(estimator: str) -> str:
    """Return the colour of an estimator, by its name: other people's have one of a few."""
    return ESTIMATORS.get(estimator) or OTHERS[crc32(estimator.encode()) % len(OTHERS)]


def material_colour(name: str) -> tuple[float, float, float]:
    """Return the colour (red, green, blue), 0 to 1, of a material by name."""
    return MATERIALS.get("ground" if "ground" in name else name, OTHER_MATERIAL)


def outline(polygon: Any) -> Outline:
    """Return the outline of a shapely polygon, a building's footprint, courtyards included."""
    rings = [polygon.exterior, *polygon.interiors]
    return Outline.make_compound_path(*(Outline(np.asarray(ring.coords)[:, :2], closed=True) for ring in rings))


def write_all(
    drawings: Mapping[str, Drawing], folder: str | Path, formats: Sequence[str], progress: Progress = silent
) -> list[Path]:
    """Draw every figure that applies, write each as `folder`/NAME.FORMAT, and return the paths written.

    `formats`: what matplotlib writes, such as png and pdf.
    """
    place, written = Path(folder), []
    place.mkdir(parents=True, exist_ok=True)
    with context(), progress("figures", len(drawings)) as advance:
        for name, drawing in drawings.items():
            figure = Figure(layout="constrained")
            if drawing(figure):
                written += [save(figure, place / f"{name}.{format_}") for format_ in formats]
            advance(1)
    return written


def save(figure: Figure, path: Path) -> Path:
    """Write a figure without date and software name (same figure, same file) and return its path.

    Raises InputError, and leaves no half of it, where the disk refuses.
    """
    metadata = {"png": {"Software": None}, "pdf": {"CreationDate": None}}.get(path.suffix[1:])
    with writing(path):
        try:
            figure.savefig(path, metadata=metadata)
        except OSError:
            with suppress(OSError):
                path.unlink(missing_ok=True)
            raise
    return path
