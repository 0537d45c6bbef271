"""The curve of a sweep: a statistic with its interval against a key that varies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.figures.style import GREY, HALF_WIDTH_IN, estimator_styles
from cellslam.benchmarks.figures.sweep.sweep_data import Look, Series, SweepData, other_settings, sweep_lines
from cellslam.benchmarks.scores.statistics import LEAST_VALUES
from cellslam.sim.recording import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_TICKS, MOST_LETTERS = 10, 45
MARKERS = {"-": "o", "--": "o", "-.": "s", ":": "D"}  # in place of dashes
# From this ratio on x is logarithmic; intervals of different lines stand beside each other, by this share of the axis.
LOG_FROM = 10.0
DODGE = 0.008
BOUND_OF = {"position_rmse_m": "bound_position_rmse_m"}  # metrics that have a bound, and its row key


def draw_curve(figure: Figure, data: SweepData, look: Look, x: str) -> bool:
    """Draw the statistic with intervals against x; settings besides x are lines of their own.

    What is no number stands side by side, and nothing leads from one to the next.
    """
    from matplotlib.ticker import LogLocator

    found = sweep_lines(data, x)
    names = list(dict.fromkeys(at for points in found.values() for at, _ in points if isinstance(at, str)))
    lines = {
        name: [(float(names.index(at)) if isinstance(at, str) else at, one.values(look.metric)) for at, one in points]
        for name, points in found.items()
    }
    lines = {name: kept for name, points in lines.items() if (kept := [p for p in points if len(p[1])])}
    every = sorted({at for points in lines.values() for at, _ in points if at is not None})
    if not every:
        return False
    figure.set_size_inches(*HALF_WIDTH_IN)
    axes, styles = figure.subplots(), estimator_styles(lines)
    if names:
        for one in styles.values():
            one["marker"], one["linestyle"] = MARKERS[one["linestyle"]], "none"
    logarithmic = not names and every[0] > 0 and every[-1] >= LOG_FROM * every[0]
    for index, (name, points) in enumerate(lines.items()):
        aside = DODGE * (index - (len(lines) - 1) / 2)
        _line(axes, [(_beside(at, every, aside, logarithmic), values) for at, values in points], look, styles[name])
    if look.metric in BOUND_OF:
        for (name, bounds), dashes in zip(bound_lines(found, BOUND_OF[look.metric], x).items(), cycle(MARKERS)):
            _bound(axes, name, bounds, names, look, dashes)
    if logarithmic:
        axes.set_xscale("log")
    if names:
        axes.set_xticks(range(len(names)), names, rotation=0 if len("".join(names)) < MOST_LETTERS else 25)
        axes.margins(x=0.08)
    elif len(every) <= MOST_TICKS:
        axes.set_xticks(every, [f"{value:g}" for value in every])
        axes.minorticks_off()
    trials = max(len(values) for points in lines.values() for _, values in points)
    intervals = "no" if trials < LEAST_VALUES else f"{100 * look.confidence:g} %"
    axes.set(xlabel=x, ylabel=look.label, title=f"{intervals} intervals, {trials} trials a point")
    if names:
        axes.set_yscale("log")
        axes.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
    else:
        axes.set_ylim(bottom=0)
    figure.legend(loc="outside lower center", ncols=2)
    return True


def bound_lines(
    lines: Mapping[str, Sequence[tuple[float | str | None, Series]]], key: str, x: str
) -> dict[str, dict[float | str, Floats]]:
    """Return the drives' bounds (n,), row key `key`, in its units, by line and place along x.

    There is a line for each world that differs in more than x, named by what differs, as estimators do not matter.
    """
    found: dict[str, dict[float | str, list[Floats]]] = {}
    for at, one in (point for points in lines.values() for point in points):
        if at is not None and len(values := one.values(key)):
            name = ", ".join(["Cramér-Rao bound", *other_settings(one, x)])
            found.setdefault(name, {}).setdefault(at, []).append(values)
    return {name: {at: np.concatenate(values) for at, values in points.items()} for name, points in found.items()}


def _bound(
    axes: Axes, name: str, points: Mapping[float | str, Floats], names: Sequence[str], look: Look, dashes: str
) -> None:
    """Draw a bound, summed up as the metric is: a line where x is a number, else a dash at each place."""
    places = sorted((float(names.index(at)) if isinstance(at, str) else at, at) for at in points)
    middle = [look.summed(points[at])[0] for _, at in places]
    style: dict[str, Any] = {"marker": "_", "markersize": 22, "linestyle": "none"} if names else {"linestyle": dashes}
    axes.plot([x for x, _ in places], middle, color=GREY, label=name, zorder=1, **style)


def _line(axes: Axes, points: Sequence[tuple[float | None, Floats]], look: Look, style: Mapping[str, Any]) -> None:
    """Draw one line with its intervals; a point without x is the same everywhere: a level with a band."""
    at = [place for place, _ in points if place is not None]
    if at:
        draw_points(axes, at, [values for _, values in points], look, style)
        return
    middle, low, high = look.summed(points[0][1])
    axes.axhline(middle, **style)
    axes.axhspan(low, high, color=style["color"], alpha=0.15, linewidth=0)


def draw_points(
    axes: Axes, at: Sequence[float], samples: Sequence[Floats], look: Look, style: Mapping[str, Any]
) -> None:
    """Draw the statistic of each sample (n,) with its interval, in the sample's units, at its place along x."""
    middle, *ends = np.stack([look.summed(values) for values in samples], axis=1)
    reach = np.nan_to_num(np.abs(ends - middle))
    axes.errorbar(at, middle, yerr=reach, **{"marker": "o", **style}, markersize=3.5, capsize=2.5, elinewidth=0.9)


def _beside(at: float | None, every: Sequence[float], aside: float, logarithmic: bool) -> float | None:
    """Return a place moved aside by a share of the axis, so that intervals do not hide each other."""
    if at is None:
        return None
    return at * (every[-1] / every[0]) ** aside if logarithmic else at + aside * (every[-1] - every[0])
