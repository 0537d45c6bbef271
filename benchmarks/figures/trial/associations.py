"""Measured path distances against time, associated ones coloured by VT (the paper's Fig. 4)."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import GREY, LANDMARKS, TITLE, WIDTH_IN
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.recording import Ints, Recording

PANELS = 2
DOT = 2.2


def draw(figure: Figure, recording: Recording, results: Mapping[str, TrialResult]) -> bool:
    """Draw the busiest link of each of the first two sites with measurements; False if none has any.

    The associations are those of the result that has most. The vertical range is that of the associated
    measurements, with some room: clutter reaches far beyond.
    """
    chosen = shown_links(recording, PANELS)
    if not chosen:
        return False
    none = np.full(len(recording.measurements), -1, np.int64)
    said = [none, *(r.association for r in results.values() if r.association is not None)]
    association = max(said, key=lambda a: np.count_nonzero(a >= 0))
    figure.set_size_inches(WIDTH_IN, 3.4)
    grid = figure.subplots(1, len(chosen), squeeze=False)[0]
    for axes, link in zip(grid, chosen, strict=True):
        _panel(axes, recording, association, link)
    offset = (recording.sites.clock_offset_std_m > 0.0).any()
    grid[0].set_ylabel("measured path distance (m)" + (",\nclock offset included" if offset else ""))
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, markerscale=4)
    return True


def shown_links(recording: Recording, most: int) -> list[int]:
    """Return the link with most measurements of each of the first `most` sites that have any."""
    count = np.bincount(recording.measurements.link, minlength=len(recording.links))
    chosen = []
    for site in range(len(recording.sites)):
        mine = np.flatnonzero((recording.links.site == site) & (count > 0))
        if len(mine):
            chosen.append(int(mine[np.argmax(count[mine])]))
    return chosen[:most]


def _panel(axes: Axes, recording: Recording, association: Ints, link: int) -> None:
    m, links = recording.measurements, recording.links
    mine = np.flatnonzero(m.link == link)
    time_s = recording.time_s[m.snapshot[mine]] - recording.time_s[0]
    vt = association[mine]
    loose = vt < 0
    dots: dict[str, Any] = {"linestyle": "none", "marker": ".", "markeredgewidth": 0, "rasterized": True}
    distance_m = m.distance_m[mine]
    axes.plot(
        time_s[loose],
        distance_m[loose],
        **dots,
        color=GREY,
        markersize=DOT,
        alpha=0.6,
        label="not associated",
    )
    for k, one in enumerate(_by_first_detection(vt[~loose])):
        here, colour = vt == one, LANDMARKS[k % len(LANDMARKS)]
        label = "associated, one colour a VT" if k == 0 else None
        axes.plot(time_s[here], distance_m[here], **dots, color=colour, markersize=DOT + 0.8, label=label)
    if np.isfinite(distance_m[~loose]).any():
        low, high = float(np.nanmin(distance_m[~loose])), float(np.nanmax(distance_m[~loose]))
        span = high - low
        axes.set_ylim(max(low - 0.2 * span - 1.0, min(low, 0.0)), high + 0.35 * span + 1.0)
    known = [("cell", links.cell_id[link]), ("port", links.port[link])]
    named = [f"site {recording.sites.name[links.site[link]]}", *(f"{word} {n}" for word, n in known if n >= 0)]
    axes.set_title(fill(", ".join(named), TITLE))
    axes.set_xlabel("time (s)")


def _by_first_detection(vt: Ints) -> Ints:
    """Return the distinct ids in the order in which they first occur."""
    ids, first = np.unique(vt, return_index=True)
    return np.asarray(ids[np.argsort(first)])
