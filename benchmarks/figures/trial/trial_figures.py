"""The figures of one trial, as in the paper's section V: map, error, associations, clock offsets.

Each draws into a figure, and returns False, drawing nothing, where the trial has nothing of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.bound.cramer_rao import BoundResult
from cellslam.benchmarks.figures import consistency_page, style
from cellslam.benchmarks.figures.consistency_page import Shown
from cellslam.benchmarks.figures.style import GREY, TRUTH, WIDTH_IN
from cellslam.benchmarks.figures.trial import array_calibration, trial_map
from cellslam.benchmarks.figures.trial.trial_map import ODOMETRY_ALONE
from cellslam.benchmarks.scores.metrics import errors_of, errors_over_time
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.tables.consistency import claimed_by
from cellslam.benchmarks.trials.output_files import file_name
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, Recording

if TYPE_CHECKING:
    from cellslam.sim.city import City

GAP, LEAST_GAP_S = 5.0, 2.0  # a pause of so many median intervals breaks a curve, if it is no shorter
DOT = 2.2
MAGNIFIED = 2.0  # from which ratio of the errors on the smaller ones are drawn again
CALIBRATION = "calibration-"  # begins the names of these figures
SETTLED_SHARE = 0.25  # of the drive, after which clock offsets are shown magnified

Results = Mapping[str, TrialResult]


def drawings(
    city: City | None, recording: Recording, results: Results, bound: BoundResult | None
) -> dict[str, style.Drawing]:
    """Return the figures of a trial by name: functions that draw into a Figure, False where one does not apply.

    `map` needs truth or a result; `error` needs truth or a reference, `consistency` a reference; `associations` needs
    measurements; `clock_offsets` a result with offsets, `calibration-ESTIMATOR` one with the array's
    calibration. `city` None: a map without buildings.
    """
    out: dict[str, style.Drawing] = {
        "map": lambda figure: trial_map.draw(figure, city, recording, results),
        "error": lambda figure: draw_error(figure, recording, results, bound),
        "associations": lambda figure: draw_associations(figure, recording, results),
        "clock_offsets": lambda figure: draw_clock_offsets(figure, recording, results),
        "consistency": lambda figure: draw_consistency(figure, recording, results),
    }
    for name, calibration in ((name, r.calibration) for name, r in results.items() if r.calibration is not None):
        draw = partial(array_calibration.draw, calibration=calibration, provenance=recording.provenance)
        out[f"{CALIBRATION}{file_name(name)}"] = draw
    return out


def draw_all(
    city: City | None,
    recording: Recording,
    results: Results,
    bound: BoundResult | None,
    out_dir: str | Path,
    progress: Progress = silent,
    names: Sequence[str] | None = None,
    calibration: bool = False,
) -> list[Path]:
    """Draw every figure that applies, write each as `out_dir`/NAME.png, and return the paths written.

    `names`: of the figures to draw (None: all, of the array's calibration only if that is asked for).
    """
    every = drawings(city, recording, results, bound)
    wanted = names or [name for name in every if calibration or not name.startswith(CALIBRATION)]
    return style.write_all({name: every[name] for name in wanted}, out_dir, ("png",), progress)


def draw_error(figure: Figure, recording: Recording, results: Results, bound: BoundResult | None) -> bool:
    """Draw the absolute horizontal errors with the bound (the paper's Fig. 3), and below them all but dead reckoning
    magnified, where these are much smaller; needs truth or a reference."""
    found = {name: errors_over_time(recording, result.poses) for name, result in results.items()}
    known = {name: pair for name, pair in found.items() if pair is not None}
    if not known:
        return False
    time_s = next(iter(known.values()))[0] - recording.time_s[0]
    errors = {name: error for name, (_, error) in known.items()}
    small = [float(e.max()) for name, e in errors.items() if name != ODOMETRY_ALONE]
    small += [] if bound is None else [float(bound.horizontal_std_m.max())]
    magnified = bool(small) and ODOMETRY_ALONE in errors and MAGNIFIED * max(small) < errors[ODOMETRY_ALONE].max()
    figure.set_size_inches(WIDTH_IN, 4.2 if magnified else 3.0)
    panels = figure.subplots(2 if magnified else 1, 1, squeeze=False, sharex=True)[:, 0]
    for axes in panels:
        for name, line in style.curve_styles(errors).items():
            _error(axes, time_s, errors[name], line)
        if bound is not None:
            axes.fill_between(time_s, bound.horizontal_std_m, color=GREY, alpha=0.35, linewidth=0)
            axes.plot(time_s, bound.horizontal_std_m, color=GREY, label="Cramér-Rao bound (rms)")
        axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("horizontal error (m)")
    panels[0].legend(loc="upper left")
    panels[-1].set_xlabel("time (s)")
    if magnified:
        panels[1].set(ylim=(0, 1.1 * max(small) + 1e-9), ylabel="the same, magnified (m)")
    return True


def draw_consistency(figure: Figure, recording: Recording, results: Results) -> bool:
    """Draw whether the estimators knew how wrong they were; needs a reference: of simulated drives a sweep has many."""
    shown: dict[str, Shown] = {}
    if recording.truth is not None:
        return False
    for name, result in results.items():
        found, squared = errors_over_time(recording, result.poses), errors_of(recording, result).squared
        if found is not None:
            time_s = found[0] - recording.time_s[0]
            shown[name] = Shown([claimed_by(recording, result)], time_s, squared[None])
    return consistency_page.draw(figure, shown)


def _error(axes: Axes, time_s: Floats, error: Floats, line: Mapping[str, Any]) -> None:
    """Draw a curve that breaks at pauses, and what stands alone between two of them as a dot."""
    step = np.diff(time_s)
    usual = float(np.median(step)) if len(step) else 0.0
    after = np.flatnonzero(step > max(GAP * usual, LEAST_GAP_S)) + 1
    axes.plot(np.insert(time_s, after, np.nan), np.insert(error, after, np.nan), **line)
    edges = np.concatenate([[0], after, [len(time_s)]])
    alone = edges[:-1][np.diff(edges) == 1]
    axes.plot(time_s[alone], error[alone], ".", color=line["color"], markersize=2.0)


def draw_associations(figure: Figure, recording: Recording, results: Results) -> bool:
    """Draw measured distances, associated ones coloured by VT (the paper's Fig. 4): of the first two sites that have
    any, the busiest link.

    The associations are those of the result that has most. The vertical range is that of the associated
    measurements, with some room: clutter reaches far beyond.
    """
    chosen = shown_links(recording)
    if not chosen:
        return False
    none = np.full(len(recording.measurements), -1, np.int64)
    answers = [none, *(r.association for r in results.values() if r.association is not None)]
    association = max(answers, key=lambda a: np.count_nonzero(a >= 0))
    figure.set_size_inches(WIDTH_IN, 3.4)
    grid = figure.subplots(1, len(chosen), squeeze=False)[0]
    for axes, link in zip(grid, chosen, strict=True):
        _associations(axes, recording, association, link)
    offset = (recording.sites.clock_offset_std_m > 0.0).any()
    grid[0].set_ylabel("measured path distance (m)" + (",\nclock offset included" if offset else ""))
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, markerscale=4)
    return True


def shown_links(recording: Recording) -> list[int]:
    """Return the link with most measurements of each of the first two sites that have any."""
    count = np.bincount(recording.measurements.link, minlength=len(recording.links))
    of_site = [np.where(recording.links.site == site, count, 0) for site in range(len(recording.sites))]
    return [int(own.argmax()) for own in of_site if own.any()][:2]


def _associations(axes: Axes, recording: Recording, association: Ints, link: int) -> None:
    m, links = recording.measurements, recording.links
    mine = np.flatnonzero(m.link == link)
    time_s, distance_m, vt = recording.elapsed_s[m.snapshot[mine]], m.distance_m[mine], association[mine]
    loose = vt < 0
    dots: dict[str, Any] = {"linestyle": "none", "marker": ".", "markeredgewidth": 0, "rasterized": True}
    label = "not associated"
    axes.plot(time_s[loose], distance_m[loose], **dots, color=GREY, markersize=DOT, alpha=0.6, label=label)
    ids, first = np.unique(vt[~loose], return_index=True)
    for k, one in enumerate(ids[np.argsort(first)]):
        here, colour = vt == one, style.LANDMARKS[k % len(style.LANDMARKS)]
        label = "associated, one colour a VT" if k == 0 else ""
        axes.plot(time_s[here], distance_m[here], **dots, color=colour, markersize=DOT + 0.8, label=label or None)
    if np.isfinite(distance_m[~loose]).any():
        low, high = float(np.nanmin(distance_m[~loose])), float(np.nanmax(distance_m[~loose]))
        span = high - low
        axes.set_ylim(max(low - 0.2 * span - 1.0, min(low, 0.0)), high + 0.35 * span + 1.0)
    known = [("cell", links.cell_id[link]), ("port", links.port[link])]
    named = [f"site {recording.sites.name[links.site[link]]}", *(f"{word} {n}" for word, n in known if n >= 0)]
    axes.set(title=fill(", ".join(named), style.TITLE), xlabel="time (s)")


def draw_clock_offsets(figure: Figure, recording: Recording, results: Results) -> bool:
    """Draw the clock offsets with their 2-sigma bands against the truth, one column a site; needs estimates of clocks
    that are not known. Below, the range is that of the last three quarters of the drive."""
    estimates = {name: r for name, r in results.items() if r.clock_offset_m is not None}
    unknown = recording.sites.clock_offset_std_m + recording.sites.drift_std_m_s > 0.0
    sites = np.flatnonzero(unknown).tolist()
    if not estimates or not sites:
        return False
    figure.set_size_inches(max(3.6 * len(sites), WIDTH_IN * 0.6), 4.4)
    grid = figure.subplots(2, len(sites), squeeze=False, sharex=True)
    for (above, below), site in zip(grid.T, sites, strict=True):
        curves = [_offset(result, site, style.estimator_styles(results)[name]) for name, result in estimates.items()]
        if recording.truth is not None:
            offset_m = recording.truth.clock_offsets_at(recording.elapsed_s)[:, site]
            curves.append((offset_m, None, {"color": TRUTH, "linestyle": ":", "label": "truth"}))
        for axes in (above, below):
            for mean, band, line in curves:
                _with_band(axes, recording.elapsed_s, mean, band, line)
            axes.set_xlim(0, max(float(recording.elapsed_s[-1]), 1e-9))
        above.set_title(fill(f"site {recording.sites.name[site]}", style.TITLE))
        below.set(xlabel="time (s)", ylim=_settled_range([(mean, band) for mean, band, _ in curves]))
    grid[0, 0].set_ylabel("clock offset (m)")
    grid[1, 0].set_ylabel("the same, magnified (m)")
    grid[0, 0].legend(loc="best")
    return True


def _offset(result: TrialResult, site: int, line: dict[str, Any]) -> tuple[Floats, Floats | None, dict[str, Any]]:
    """Return a site's offset (T,) in metres, two claimed standard deviations (T,) of it, and how both are drawn."""
    assert result.clock_offset_m is not None
    variance = result.clock_offset_variance_m2
    band = None if variance is None else 2.0 * np.sqrt(np.maximum(variance[:, site], 0.0))
    return result.clock_offset_m[:, site], band, line


def _with_band(axes: Axes, time_s: Floats, mean: Floats, band: Floats | None, line: Mapping[str, Any]) -> None:
    axes.plot(time_s, mean, **line)
    if band is not None:
        colour, label = line["color"], f"{line['label']} ±2σ"
        axes.fill_between(time_s, mean - band, mean + band, color=colour, alpha=0.22, linewidth=0, label=label)


def _settled_range(curves: list[tuple[Floats, Floats | None]]) -> tuple[float, float]:
    """Return an interval that holds the curves and their bands after the first quarter of the drive."""
    sides = [mean + sign * (0.0 if band is None else band) for mean, band in curves for sign in (-1.0, 1.0)]
    late = np.stack(sides)[:, int(SETTLED_SHARE * len(sides[0])) :]
    low, high = float(late.min()), float(late.max())
    margin = 0.08 * (high - low) + 0.05
    return low - margin, high + margin
