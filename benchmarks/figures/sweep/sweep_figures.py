"""The figures of a sweep: distributions, error against time, sweep curves, ranks, consistency, clocks, cost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.figures import consistency_page, style
from cellslam.benchmarks.figures.consistency_page import Shown
from cellslam.benchmarks.figures.style import GREY, HALF_WIDTH_IN, WIDTH_IN, Drawing, estimator_styles, plain_numbers
from cellslam.benchmarks.figures.sweep import sweep_data
from cellslam.benchmarks.figures.sweep.critical_difference import draw_ranks
from cellslam.benchmarks.figures.sweep.stanford_diagram import draw_stanford
from cellslam.benchmarks.figures.sweep.sweep_data import CurveChoice, Panel, Series, SweepData, axis, curve_keys
from cellslam.benchmarks.scores.statistics import LEAST_VALUES, statistic
from cellslam.benchmarks.tables.consistency import claimed_in
from cellslam.benchmarks.tables.summaries import check_confidence, check_metric
from cellslam.benchmarks.trials.output_files import file_name
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats

MOST_PANELS = 6
MOST_TICKS, MOST_LETTERS = 10, 45
MARKERS = {"-": "o", "--": "o", "-.": "s", ":": "D"}  # in place of dashes
SHAPES = "osD^vPX*"  # of the points, by the place of their line
# From this ratio on x is logarithmic; intervals of different lines stand beside each other, by this share of the axis.
LOG_FROM = 10.0
DODGE = 0.012
BOUND_OF = {"position_rmse_m": "bound_position_rmse_m"}  # metrics that have a bound, and its row key
Curve = tuple[Floats, Floats]  # times (P,), values of the trials (N, P) or (N, P, S)


def draw_sweep(
    folder: str | Path,
    out_dir: str | Path,
    choice: CurveChoice | None = None,
    formats: Sequence[str] = ("png", "pdf"),
    progress: Progress = silent,
) -> list[Path]:
    """Draw every figure of a sweep that applies, write each as `out_dir`/NAME.FORMAT, and return the paths.

    Raises InputError for an unknown key, metric or statistic, or an empty sweep.
    """
    choice = choice or CurveChoice()
    check_metric(choice.metric)
    statistic(choice.statistic)
    check_confidence(choice.confidence)
    data = sweep_data.load(folder)
    x = _x_key(data, choice)
    drawings: dict[str, Drawing] = {
        "sweep": lambda figure: x is not None and draw_curve(figure, data, choice, x),
        "error_cdf": lambda figure: _cdf(figure, data, choice.metric),
        "map_error": lambda figure: _cdf(figure, data, "map_gospa_m"),
        "error_time": lambda figure: _over_time(figure, data, "error_m", "horizontal error (m)"),
        "clock_offset": lambda figure: _over_time(figure, data, "offset_error_m", "clock offset error (m)"),
        "time_accuracy": lambda figure: _cost(figure, data, choice),
        "map_against_bound": lambda figure: _map_against_bound(figure, data),
        "stanford": lambda figure: draw_stanford(figure, data),
        "ranks": lambda figure: draw_ranks(figure, sweep_data.verdicts_of(data)),
    }
    for panel in data.panels[:MOST_PANELS]:
        name = file_name(f"consistency {panel.title}".replace(" = ", "-").replace(",", "").strip().replace(" ", "-"))
        drawings[name] = partial(_consistency, data=data, panel=panel)
    return style.write_all(drawings, out_dir, formats, progress)


def _x_key(data: SweepData, choice: CurveChoice) -> str | None:
    keys = curve_keys(data)
    if choice.x is not None and choice.x not in keys:
        raise InputError(f"--x {choice.x}: not a key that varies ({', '.join(keys) or 'there is none'})")
    return choice.x or next(iter(keys), None)


def _cdf(figure: Figure, data: SweepData, metric: str) -> bool:
    """Draw the share of trials below each value; failed trials count as never."""
    panels = [panel for panel in data.panels if any(len(one.values(metric)) for one in panel.series)][:MOST_PANELS]
    if not panels:
        return False
    for axes, panel, styles in _panels(figure, data, panels):
        for one in panel.series:
            values = np.sort(one.values(metric))
            if len(values):
                share = np.arange(1, len(values) + 1) / len(one.rows)
                axes.step(np.append(values, values[-1]), np.append(0.0, share), where="pre", **styles[one.label])
        axes.set_xlabel(axis(metric))
    # Axes are shared: limits are set when all panels are drawn.
    figure.axes[0].set(ylim=(0, 1), xlim=(0, None), ylabel="share of trials")
    return True


def _over_time(figure: Figure, data: SweepData, column: str, label: str) -> bool:
    """Draw the median size over trials (and sites) against time, with the band from the 10 to the 90 % quantile."""
    panels = _curves(data, column)
    for axes, panel, styles in _panels(figure, data, list(panels)):
        for name, (time_s, values) in panels[panel].items():
            sites = np.abs(values).reshape(*values.shape[:2], -1).transpose(0, 2, 1).reshape(-1, len(time_s))
            low, middle, high = np.quantile(sites, (0.1, 0.5, 0.9), axis=0)
            axes.plot(time_s, middle, **styles[name])
            axes.fill_between(time_s, low, high, color=styles[name]["color"], alpha=0.18, linewidth=0)
        axes.set_xlabel("time (s)")
    if panels:
        figure.axes[0].set(ylim=(0, None), xlim=(0, None), ylabel=f"{label},\nmedian and 10-90 %")
    return bool(panels)


def _consistency(figure: Figure, data: SweepData, panel: Panel) -> bool:
    """Draw the page of one panel."""
    shown: dict[str, Shown] = {}
    for one in panel.series:
        drives = [claimed_in(drive) for drive in data.drives(one) if len(drive.nees)]
        if drives and (curve := data.over_time(one, "nees")) is not None:
            shown[one.label] = Shown(drives, *curve)
    return consistency_page.draw(figure, shown, panel.title)


def _map_against_bound(figure: Figure, data: SweepData) -> bool:
    """Draw the root mean square of VTs' errors against how many snapshots saw them, and that of the bound."""
    found = {
        panel: {
            one.label: np.concatenate([(d.map_error_m, d.map_bound_m, d.map_times_seen) for d in drives], axis=1)
            for one in panel.series
            if (drives := [drive for drive in data.drives(one) if len(drive.map_times_seen)])
        }
        for panel in data.panels[:MOST_PANELS]
    }
    panels = [panel for panel, of in found.items() if of]
    for axes, panel, styles in _panels(figure, data, panels):
        for label, (error, bound, times_seen) in found[panel].items():
            bins = np.floor(np.log2(times_seen)).astype(int)
            there = np.unique(bins)
            x = [np.exp(np.log(times_seen[bins == b]).mean()) for b in there]
            for values, line in ((error, styles[label]), (bound, {**styles[label], "linestyle": ":", "label": None})):
                axes.plot(
                    x, [np.sqrt(np.mean(values[bins == b] ** 2)) for b in there], **line, marker="o", markersize=3
                )
        axes.set(xscale="log", yscale="log", xlabel="snapshots that saw a VT")
        plain_numbers(axes.xaxis)
        plain_numbers(axes.yaxis)
    if panels:
        figure.axes[0].set_ylabel("error of VTs (m), root mean square;\ndotted: bound of the same")
    return bool(panels)


def _curves(data: SweepData, column: str) -> dict[Panel, dict[str, Curve]]:
    """Return a column of the trajectories by label of the series, of the first panels; a panel without any is left
    out."""
    out: dict[Panel, dict[str, Curve]] = {}
    for panel in data.panels[:MOST_PANELS]:
        found = {one.label: data.over_time(one, column) for one in panel.series}
        if curves := {label: curve for label, curve in found.items() if curve is not None}:
            out[panel] = curves
    return out


def _cost(figure: Figure, data: SweepData, choice: CurveChoice) -> bool:
    """Draw the statistic with its interval against the estimator's median time per trial."""
    every = [(one, one.values(choice.metric), one.values("estimate_seconds")) for one in data.series]
    points = [point for point in every if len(point[1]) and len(point[2])]
    if not points:
        return False
    figure.set_size_inches(*HALF_WIDTH_IN)
    axes, styles = figure.subplots(), estimator_styles(data.labels)
    for one, values, seconds in points:
        draw_points(axes, [float(np.median(seconds))], [values], choice, {**styles[one.label], "linestyle": "none"})
    axes.set(
        xscale="log", xlabel=f"{axis('estimate_seconds')}, median over trials", ylabel=choice.label, ylim=(0, None)
    )
    _legend(figure, ncols=2)
    return True


def draw_curve(figure: Figure, data: SweepData, choice: CurveChoice, x: str) -> bool:
    """Draw the statistic with intervals against x; settings besides x are lines of their own.

    What is no number stands side by side, and nothing leads from one to the next.
    """
    found = sweep_data.sweep_lines(data, x)
    names = list(dict.fromkeys(at for points in found.values() for at, _ in points if isinstance(at, str)))
    lines = {
        name: [(float(names.index(at)) if isinstance(at, str) else at, one.values(choice.metric)) for at, one in points]
        for name, points in found.items()
    }
    lines = {name: kept for name, points in lines.items() if (kept := [p for p in points if len(p[1])])}
    every = sorted({at for points in lines.values() for at, _ in points if at is not None})
    if not every:
        return False
    figure.set_size_inches(*HALF_WIDTH_IN)
    axes, styles = figure.subplots(), estimator_styles(lines)
    for place, one in enumerate(styles.values()):
        if names:
            one["marker"], one["linestyle"] = MARKERS[one["linestyle"]], "none"
        else:  # where lines meet, the first one is seen, and the next one on both sides of it
            one |= {
                "marker": SHAPES[place % len(SHAPES)],
                "linewidth": 1.2 + 1.2 * min(place, 3),
                "zorder": 3 - 0.1 * place,
            }
    logarithmic = not names and every[0] > 0 and every[-1] >= LOG_FROM * every[0]
    for index, (name, points) in enumerate(lines.items()):
        aside = DODGE * (index - (len(lines) - 1) / 2)
        _line(axes, [(_beside(at, every, aside, logarithmic), values) for at, values in points], choice, styles[name])
    if choice.metric in BOUND_OF:
        for (name, bounds), dashes in zip(bound_lines(found, BOUND_OF[choice.metric], x).items(), cycle(MARKERS)):
            _bound(axes, name, bounds, names, choice, dashes)
    if logarithmic:
        axes.set_xscale("log")
    if names:
        axes.set_xticks(range(len(names)), names, rotation=0 if len("".join(names)) < MOST_LETTERS else 25)
        axes.margins(x=0.08)
    elif len(every) <= MOST_TICKS:
        axes.set_xticks(every, [f"{value:g}" for value in every])
        axes.minorticks_off()
    trials = max(len(values) for points in lines.values() for _, values in points)
    intervals = "no" if trials < LEAST_VALUES else f"{100 * choice.confidence:g} %"
    axes.set(xlabel=x, ylabel=choice.label, title=f"{intervals} intervals, {trials} trials a point")
    if names:
        axes.set_yscale("log")
        plain_numbers(axes.yaxis, between=True)
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
            name = ", ".join(["Cramér-Rao bound", *sweep_data.other_settings(one, x)])
            found.setdefault(name, {}).setdefault(at, []).append(values)
    return {name: {at: np.concatenate(values) for at, values in points.items()} for name, points in found.items()}


def _bound(
    axes: Axes, name: str, points: Mapping[float | str, Floats], names: Sequence[str], choice: CurveChoice, dashes: str
) -> None:
    """Draw a bound, summed up as the metric is: a line where x is a number, else a dash at each place."""
    places = sorted((float(names.index(at)) if isinstance(at, str) else at, at) for at in points)
    middle = [choice.summed(points[at])[0] for _, at in places]
    line: dict[str, Any] = {"marker": "_", "markersize": 22, "linestyle": "none"} if names else {"linestyle": dashes}
    axes.plot([x for x, _ in places], middle, color=GREY, label=name, zorder=1, **line)


def _line(
    axes: Axes, points: Sequence[tuple[float | None, Floats]], choice: CurveChoice, line: Mapping[str, Any]
) -> None:
    """Draw one line with its intervals; a point without x is the same everywhere: a level with a band."""
    at = [place for place, _ in points if place is not None]
    if at:
        draw_points(axes, at, [values for _, values in points], choice, line)
        return
    middle, low, high = choice.summed(points[0][1])
    axes.axhline(middle, **line)
    axes.axhspan(low, high, color=line["color"], alpha=0.15, linewidth=0)


def draw_points(
    axes: Axes, at: Sequence[float], samples: Sequence[Floats], choice: CurveChoice, line: Mapping[str, Any]
) -> None:
    """Draw the statistic of each sample (n,) with its interval, in the sample's units, at its place along x."""
    middle, *ends = np.stack([choice.summed(values) for values in samples], axis=1)
    reach = np.abs(ends - middle)
    reach[:, ~(reach > 0.0).any(axis=0)] = np.nan  # an interval without length is not drawn
    drawn = {"marker": "o", "markersize": 4.5, "markeredgecolor": "white", "markeredgewidth": 0.6, **line}
    axes.errorbar(at, middle, yerr=reach, **drawn, capsize=2.5, elinewidth=0.9)


def _beside(at: float | None, every: Sequence[float], aside: float, logarithmic: bool) -> float | None:
    """Return a place moved aside by a share of the axis, so that intervals do not hide each other."""
    if at is None:
        return None
    return at * (every[-1] / every[0]) ** aside if logarithmic else at + aside * (every[-1] - every[0])


def _panels(
    figure: Figure, data: SweepData, panels: Sequence[Panel]
) -> Iterator[tuple[Axes, Panel, Mapping[str, dict[str, Any]]]]:
    """Yield axes, panel and styles; afterwards the figure gets its legend."""
    if not panels:
        return
    across = 2 if len(panels) == 4 else min(3, len(panels))
    width_in = WIDTH_IN if across > 1 else HALF_WIDTH_IN[0]
    grid = style.panels(figure, len(panels), across, (width_in, 2.5), above_in=0.5, shared=True)
    styles = estimator_styles(data.labels)
    for axes, panel in zip(grid, panels, strict=True):
        yield axes, panel, styles
        axes.set_title(panel.title, fontsize=7.5)
    for axes in grid[-across:]:
        axes.tick_params(labelbottom=True)  # nothing stands below it
    _legend(figure, ncols=3)


def _legend(figure: Figure, ncols: int) -> None:
    """Put a legend below the figure, each label of its axes once."""
    pairs = (zip(*axes.get_legend_handles_labels(), strict=True) for axes in figure.axes)
    handles = {label: handle for pair in pairs for handle, label in pair}
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=ncols)
