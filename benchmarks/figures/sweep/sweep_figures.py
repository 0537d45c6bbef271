"""The figures of a sweep: distributions, error against time, sweep curves, ranks, consistency, clocks, cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.figures.style import BLACK, GREY, WIDTH_IN, context, estimator_styles, save
from cellslam.benchmarks.figures.sweep.critical_difference import draw_ranks
from cellslam.benchmarks.figures.sweep.sweep_curve import draw_curve
from cellslam.benchmarks.figures.sweep.sweep_data import Panel, SweepData, curve_keys, load, verdicts_of
from cellslam.benchmarks.figures.sweep.sweep_look import Look, axis, summed_label
from cellslam.benchmarks.scores.statistics import interval, statistic
from cellslam.benchmarks.tables.summaries import Layout, check_confidence, metrics_of
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_PANELS = 6
CHI2_SHARE = 0.95


def draw_sweep(
    folder: str | Path,
    out_dir: str | Path,
    look: Look | None = None,
    formats: Sequence[str] = ("png", "pdf"),
    progress: Progress = silent,
) -> list[Path]:
    """Draw every figure of a sweep that applies, write each as `out_dir`/NAME.FORMAT, and return the paths.

    Raises InputError for an unknown key, metric or statistic, or an empty sweep.
    """
    from matplotlib.figure import Figure

    look = look or Look()
    metrics_of(Layout(metrics=(look.metric,)))
    statistic(look.statistic)
    check_confidence(look.confidence)
    data = load(folder)
    x = _x_key(data, look)
    drawings: dict[str, Callable[[Figure], bool]] = {
        "sweep": lambda figure: x is not None and draw_curve(figure, data, look, x),
        "error_cdf": lambda figure: _cdf(figure, data, look.metric),
        "map_error": lambda figure: _cdf(figure, data, "map_gospa_m"),
        "error_time": lambda figure: _over_time(figure, data, "error_m", "horizontal error (m)", np.abs),
        "clock_offset": lambda figure: _over_time(figure, data, "offset_error_m", "clock offset error (m)", np.abs),
        "nees": lambda figure: _nees(figure, data),
        "time_accuracy": lambda figure: _cost(figure, data, look),
        "ranks": lambda figure: draw_ranks(figure, verdicts_of(data)),
    }
    out, written = Path(out_dir), []
    out.mkdir(parents=True, exist_ok=True)
    with context(), progress("figures", len(drawings)) as advance:
        for name, drawing in drawings.items():
            figure = Figure(layout="constrained")
            if drawing(figure):
                written += [save(figure, out / f"{name}.{format_}") for format_ in formats]
            advance(1)
    return written


def _x_key(data: SweepData, look: Look) -> str | None:
    keys = curve_keys(data)
    if look.x is not None and look.x not in keys:
        raise InputError(f"--x {look.x}: not a key that varies ({', '.join(keys) or 'there is none'})")
    return look.x or next(iter(keys), None)


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
    figure.axes[0].set_ylim(0, 1)
    figure.axes[0].set_xlim(left=0)
    figure.axes[0].set_ylabel("share of trials")
    return True


def _over_time(figure: Figure, data: SweepData, column: str, label: str, of: Callable[[Floats], Floats]) -> bool:
    """Draw the median over trials (and sites) against time, with the band from the 10 to the 90 % quantile."""
    curves = {id(one): data.over_time(one, column) for panel in data.panels[:MOST_PANELS] for one in panel.series}
    panels = [panel for panel in data.panels[:MOST_PANELS] if any(curves[id(one)] for one in panel.series)]
    if not panels:
        return False
    for axes, panel, styles in _panels(figure, data, panels):
        for one in panel.series:
            if (curve := curves[id(one)]) is None:
                continue
            time_s, values = curve
            sites = values.reshape(*values.shape[:2], -1).transpose(0, 2, 1).reshape(-1, len(time_s))
            low, middle, high = (np.quantile(of(sites), share, axis=0) for share in (0.1, 0.5, 0.9))
            axes.plot(time_s, middle, **styles[one.label])
            axes.fill_between(time_s, low, high, color=styles[one.label]["color"], alpha=0.18, linewidth=0)
        axes.set_xlabel("time (s)")
    # Axes are shared: limits are set when all panels are drawn.
    figure.axes[0].set_ylim(bottom=0)
    figure.axes[0].set_xlim(left=0)
    figure.axes[0].set_ylabel(f"{label},\nmedian and 10-90 %")
    return True


def _nees(figure: Figure, data: SweepData) -> bool:
    """Draw the mean over trials of the NEES, and where it should be: chi-square with 2 N degrees of freedom over N."""
    from matplotlib.ticker import LogFormatter
    from scipy.stats import chi2

    curves = {id(one): data.over_time(one, "nees") for panel in data.panels[:MOST_PANELS] for one in panel.series}
    panels = [panel for panel in data.panels[:MOST_PANELS] if any(curves[id(one)] for one in panel.series)]
    if not panels:
        return False
    for axes, panel, styles in _panels(figure, data, panels):
        trials = 1
        for one in panel.series:
            if (curve := curves[id(one)]) is None:
                continue
            finite = np.isfinite(curve[1]).any(axis=0)
            mean = np.full(len(curve[0]), np.nan)
            mean[finite] = np.nanmean(curve[1][:, finite], axis=0)
            trials = max(trials, len(curve[1]))
            axes.plot(curve[0], np.maximum(mean, 1e-3), **styles[one.label])
        low, high = (float(chi2.ppf((1 + side * CHI2_SHARE) / 2, 2 * trials)) / trials for side in (-1, 1))
        axes.axhspan(low, high, color=GREY, alpha=0.35, linewidth=0, label=f"{100 * CHI2_SHARE:g} % if consistent")
        axes.axhline(2.0, color=BLACK, linewidth=0.8, linestyle=":")
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
        axes.set_xlabel("time (s)")
    figure.axes[0].set_ylabel("NEES of the horizontal position,\nmean over trials")
    return True


def _cost(figure: Figure, data: SweepData, look: Look) -> bool:
    """Draw the statistic with its interval against the estimator's median time per trial."""
    of, points = statistic(look.statistic), []
    for panel in data.panels:
        for one in panel.series:
            values, seconds = one.values(look.metric), one.values("estimate_seconds")
            if len(values) and len(seconds):
                points.append((one, float(np.median(seconds)), values))
    if not points:
        return False
    figure.set_size_inches(WIDTH_IN * 0.62, 3.2)
    axes, styles, seen = figure.subplots(), estimator_styles(data.labels), set()
    for one, cost_s, values in points:
        middle = float(of.of(values))
        ends = np.array(interval(values, of, look.confidence))
        sides: Floats = np.nan_to_num(np.abs(ends - middle))
        look_of = {**styles[one.label], "linestyle": "none", "label": None if one.label in seen else one.label}
        axes.errorbar(
            cost_s, middle, yerr=sides[:, None], **look_of, marker="o", markersize=4, capsize=2, elinewidth=0.8
        )
        seen.add(one.label)
    axes.set_xscale("log")
    axes.set_xlabel(f"{axis('estimate_seconds')}, median over trials")
    axes.set_ylabel(summed_label(look))
    axes.set_ylim(bottom=0)
    figure.legend(loc="outside lower center", ncols=2)
    return True


def _panels(
    figure: Figure, data: SweepData, panels: Sequence[Panel]
) -> Iterator[tuple[Axes, Panel, Mapping[str, dict[str, Any]]]]:
    """Yield axes, panel and styles; afterwards the figure gets its legend."""
    across = 2 if len(panels) == 4 else min(3, len(panels))
    down = -(-len(panels) // across)
    figure.set_size_inches(WIDTH_IN if across > 1 else WIDTH_IN * 0.62, 0.5 + 2.5 * down)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    styles = estimator_styles(data.labels)
    for axes, panel in zip(grid.flat, panels, strict=False):
        yield axes, panel, styles
        axes.set_title(panel.title, fontsize=7.5)
    for axes in list(grid.flat)[len(panels) :]:
        axes.set_visible(False)
    for axes in list(grid.flat)[max(0, len(panels) - across) : len(panels)]:
        # Nothing stands below it.
        axes.tick_params(labelbottom=True)
    handles = {
        label: handle for axes in grid.flat for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=3)
