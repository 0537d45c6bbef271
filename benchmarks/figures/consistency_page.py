"""The page that shows whether estimators know how wrong they are: of the drives of a sweep, or of one drive.

Four panels: the reliability diagram, how often errors lie within the ellipse of each claimed probability; the histogram
of the probability claimed for the ellipse through the truth (PIT), which is flat where claims are right; the NEES over
time with its band; and how often position, heading and clocks lie outside of what is claimed to hold 50 to 99 %.

One drive is one correlated sample: intervals are over drives, and there are none below five.

Sources: Gneiting, Balabdaoui and Raftery, "Probabilistic forecasts, calibration and sharpness", J. Royal Statistical
Society B 69, 2007 (PIT and reliability); Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
navigation", 2001, section 5.4 (NEES and its band).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import BLACK, GREY, WIDTH_IN, estimator_styles, plain_numbers
from cellslam.benchmarks.scores.belief import LEVELS
from cellslam.benchmarks.scores.statistics import share_interval
from cellslam.benchmarks.tables.consistency import Claimed, nees_band
from cellslam.benchmarks.tables.summaries import CONFIDENCE
from cellslam.sim.recording import Floats

BINS, GRID, MOST_DENSITY = 20, 100, 5.0
LEAST_NEES = 0.05
LEAST_SHARE = 3e-4  # of what is drawn on a logarithmic axis
Style = Mapping[str, Any]


@dataclass(frozen=True)
class Shown:
    """What is shown of an estimator: what it claimed in each of its drives, and the NEES (N, P) of these at `time_s`
    (P,)."""

    drives: Sequence[Claimed]
    time_s: Floats
    nees: Floats


def draw(figure: Figure, shown: Mapping[str, Shown], title: str = "") -> bool:
    """Draw the page of estimators by label; False, and nothing, where none of them claims a position."""
    there = {label: one for label, one in shown.items() if any(len(drive.position) for drive in one.drives)}
    if not there:
        return False
    figure.set_size_inches(WIDTH_IN, 6.4)
    (reliability, pit), (nees, outside) = figure.subplots(2, 2)
    styles = estimator_styles(shown)
    for label, one in there.items():
        _reliability(reliability, one, styles[label])
        _histogram(pit, one, styles[label])
    reliability.plot([0, 1], [0, 1], color=BLACK, linewidth=0.8, linestyle=":")
    reliability.set(
        xlim=(0, 1), ylim=(0, 1), xlabel="claimed probability of an ellipse", ylabel="share of errors in it"
    )
    pit.axhline(1.0, color=BLACK, linewidth=0.8, linestyle=":")
    pit.set(xlim=(0, 1), ylim=(0, min(pit.get_ylim()[1], MOST_DENSITY)), ylabel="density")
    pit.set_xlabel("claimed probability of the ellipse through the truth")
    draw_nees(nees, {label: (one.time_s, one.nees) for label, one in there.items()}, styles)
    _outside(outside, there, styles)
    drives = sorted({len(one.drives) for one in there.values()})
    count = f"{'-'.join(map(str, drives))} independent drive{'s' * (drives[-1] > 1)}"
    figure.suptitle(f"{title}: {count}" if title else count, fontsize=9)
    figure.legend(*reliability.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return True


def draw_nees(axes: Axes, curves: Mapping[str, tuple[Floats, Floats]], styles: Mapping[str, Style]) -> None:
    """Draw the mean over drives of the NEES (N, P) at times (P,) by label, and the band in which it should be."""
    for label, (time_s, values) in curves.items():
        finite = np.isfinite(values).any(axis=0)
        mean = np.full(len(time_s), np.nan)
        mean[finite] = np.nanmean(values[:, finite], axis=0)
        axes.plot(time_s, np.maximum(mean, 1e-3), **styles[label])
    low, high = nees_band(max(len(values) for _, values in curves.values()))
    axes.axhspan(low, high, color=GREY, alpha=0.35, linewidth=0)
    axes.axhline(2.0, color=BLACK, linewidth=0.8, linestyle=":")
    axes.set(
        yscale="log",
        xlabel="time (s)",
        ylim=(max(axes.get_ylim()[0], LEAST_NEES), None),
        ylabel=f"NEES, with its {100 * CONFIDENCE:g} % band",
    )
    plain_numbers(axes.yaxis, between=True)


def _reliability(axes: Axes, one: Shown, style: Style) -> None:
    """Draw the share of errors within ellipses, drives weighing alike, with its interval over drives."""
    levels = np.linspace(0.0, 1.0, GRID + 1)
    shares = np.stack([_shares(drive.position, levels) for drive in one.drives if len(drive.position)])
    axes.plot(levels, shares.mean(axis=0), **style)
    ends = np.array([share_interval(column, CONFIDENCE) for column in shares[:, 5:-1:5].T])
    if np.isfinite(ends).any():
        axes.fill_between(levels[5:-1:5], *ends.T, color=style["color"], alpha=0.15, linewidth=0)


def _histogram(axes: Axes, one: Shown, style: Style) -> None:
    found = np.mean(
        [np.histogram(d.position, BINS, (0.0, 1.0), density=True)[0] for d in one.drives if len(d.position)], axis=0
    )
    axes.stairs(
        found, np.linspace(0.0, 1.0, BINS + 1), color=style["color"], linestyle=style["linestyle"], linewidth=1.4
    )


def _outside(axes: Axes, shown: Mapping[str, Shown], styles: Mapping[str, Style]) -> None:
    """Draw how often errors lie outside of what is claimed to hold them, beside the share that was claimed."""
    whats = {"position": "position", "heading": "heading", "clocks": "clock"}  # in words, and as an attribute
    count = len(LEVELS)
    for place, what in enumerate(whats.values()):
        for k, level in enumerate(LEVELS):
            x = place * (count + 1.0) + k
            axes.plot([x - 0.45, x + 0.45], [1.0 - level] * 2, color=BLACK, linewidth=0.8, linestyle=":")
            for index, (label, one) in enumerate(shown.items()):
                claimed = [column for drive in one.drives if len(column := getattr(drive, what))]
                if claimed:
                    aside = 0.6 * ((index + 0.5) / len(shown) - 0.5)
                    _dot(axes, x + aside, np.array([np.mean(c > level) for c in claimed]), styles[label]["color"])
    middle = [place * (count + 1.0) + (count - 1) / 2.0 for place in range(len(whats))]
    axes.set(yscale="log", ylim=(LEAST_SHARE, 1.2), ylabel="share outside of 50, 90, 95, 99 % (dotted)")
    plain_numbers(axes.yaxis)
    axes.set_xticks(middle, list(whats))
    axes.grid(visible=False, axis="x")


def _dot(axes: Axes, x: float, shares: Floats, colour: str) -> None:
    mean = max(float(shares.mean()), LEAST_SHARE)
    low, high = share_interval(shares, CONFIDENCE)
    axes.plot(x, mean, "o", color=colour, markersize=3.5)
    if np.isfinite(low):
        axes.plot([x, x], np.maximum([low, high], LEAST_SHARE), color=colour, linewidth=0.9)


def _shares(probability: Floats, levels: Floats) -> Floats:
    """Return the shares (k,) of claimed probabilities (n,) up to levels (k,)."""
    return np.asarray(np.searchsorted(np.sort(probability), levels, side="right") / len(probability))
