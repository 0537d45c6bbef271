"""One look for all figures: colours that the colour-blind tell apart (Okabe and Ito, 2008), paper sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any
from zlib import crc32

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from cellslam.benchmarks.trials.output_files import writing
from cellslam.sim.progress import Progress, silent

Drawing = Callable[[Figure], bool]  # False: the figure does not apply, and nothing was drawn

BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILLION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
GREY, LIGHT, BUILDING, EMPHASIS = "#999999", "#DDDDDD", "#E4E1DC", "#A79F92"
TRUTH, VT, VEHICLES, WALL = BLACK, GREEN, "#5B6B8C", "#3D1A78"
SITES = (VERMILLION, GREEN, PURPLE, ORANGE, SKY)
LANDMARKS = (BLUE, ORANGE, GREEN, PURPLE, VERMILLION, SKY, "#7A5C00", "#5D3A9B")
# No two of one hue. What is not cellslam's own has hues, dashes and markers that no built-in one has.
ESTIMATORS = {
    "fastslam": BLUE, "dead-reckoning": ORANGE, "ekf-slam": GREEN, "bp-slam": PURPLE, "phd-slam": VERMILLION,
    "paper-fastslam": "#5566D9", "smoother": "#8C8C00", "wall-slam": "#5B9A1F", "oracle-association": "#5D3A9B",
    "oracle-fastslam": "#A23BC4", "oracle-map": "#A3262B",
}  # fmt: skip
OTHERS = (("#0E97A7", "-.", "D"), ("#B5179E", ":", "P"), ("#1E8E2E", "-.", "X"), ("#5B6770", ":", "v"),
          ("#8A5A44", "-.", "*"))  # fmt: skip
MARKED_EVERY, COINCIDES = 0.12, 0.005  # of the axes' diagonal; of what two curves span
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
    others, styles = _others(of.values()), dict[str, dict[str, Any]]()
    for label, name in of.items():
        same = [other for other in of if of[other] == name]
        index = same.index(label)
        colour, first, _ = others.get(name) or (ESTIMATORS[name], "--" if name == "dead-reckoning" else "-", "")
        dashes = DASHES[index % len(DASHES)] if len(same) > 1 and first != "--" else first
        white = PALEST * index / max(len(same) - 1, 2)
        red, green, blue = ((1.0 - white) * part + white for part in to_rgb(colour))
        styles[label] = {"color": to_hex((red, green, blue)), "linestyle": dashes, "label": label}
    return styles


def curve_styles(curves: Mapping[str, NDArray[np.float64]]) -> dict[str, dict[str, Any]]:
    """Return the line of each curve (T,) or (T, 2), by its label: other people's estimators have markers, too.

    Of curves that coincide the first is on top, the next is seen on both sides of it, and their labels say so.
    """
    styles, others, drawn = estimator_styles(curves), _others(curves), dict[str, int]()
    for label, line in styles.items():
        if label in others:
            line |= {"marker": others[label][2], "markevery": MARKED_EVERY, "markersize": 4.5}
        alike = next((first for first in drawn if _coincide(curves[first], curves[label])), None)
        if alike is None:
            drawn[label] = 0
        else:
            drawn[alike] += 1
            line |= {"linewidth": 1.4 + 1.4 * drawn[alike], "zorder": 1.9 - 0.1 * drawn[alike]}
            line["label"] = f"{label} (coincides with {alike})"
    return styles


def _coincide(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Return whether two curves are nowhere further apart than an eye tells."""
    if one.shape != other.shape or not np.isfinite(one).any():
        return False
    span = max(float(np.ptp(curve[np.isfinite(curve)])) for curve in (one, other) if np.isfinite(curve).any())
    return bool(np.nanmax(np.abs(one - other), initial=0.0) <= COINCIDES * span)


def _others(names: Iterable[str]) -> dict[str, tuple[str, str, str]]:
    """Return colour, dashes and marker of the estimators among `names` that are not cellslam's own, each its own."""
    found: dict[str, tuple[str, str, str]] = {}
    for name in dict.fromkeys(names):
        if name not in ESTIMATORS:
            place = crc32(name.encode())
            free = [one for i in range(len(OTHERS)) if (one := OTHERS[(place + i) % len(OTHERS)]) not in found.values()]
            found[name] = (free or [OTHERS[place % len(OTHERS)]])[0]
    return found


def colour_of(estimator: str) -> str:
    """Return the colour of an estimator, by its name, where no other one of other people is beside it."""
    return str(estimator_styles([estimator])[estimator]["color"])


def material_colour(name: str) -> tuple[float, float, float]:
    """Return the colour (red, green, blue), 0 to 1, of a material by name."""
    return MATERIALS.get("ground" if "ground" in name else name, OTHER_MATERIAL)


def outline(polygon: Any) -> Outline:
    """Return the outline of a shapely polygon, a building's footprint, courtyards included."""
    rings = [polygon.exterior, *polygon.interiors]
    return Outline.make_compound_path(*(Outline(np.asarray(ring.coords)[:, :2], closed=True) for ring in rings))


def panels(
    figure: Figure, count: int, across: int, size_in: tuple[float, float], above_in: float = 0.0, shared: bool = False
) -> list[Axes]:
    """Return axes side by side, `across` of them, in rows as wide and high as `size_in`, below a margin."""
    down = -(-count // across)
    figure.set_size_inches(size_in[0], above_in + down * size_in[1])
    grid = list(figure.subplots(down, across, squeeze=False, sharex=shared, sharey=shared).flat)
    for axes in grid[count:]:
        axes.set_visible(False)
    return grid[:count]


def plain_numbers(axis: Axis, between: bool = False) -> None:
    """Write the numbers of a logarithmic axis as they are, those `between` powers of ten too."""
    axis.set_major_formatter("{x:g}")
    if between:
        axis.set_minor_locator(LogLocator(subs=(2, 5)))
        axis.set_minor_formatter("{x:g}")


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
