"""Clock offset estimates with their 2-sigma bands against the truth, one column a site."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import TITLE, TRUTH, WIDTH_IN, estimator_styles
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.recording import Floats, Recording

SETTLED_SHARE = 0.25


def draw(figure: Figure, recording: Recording, results: Mapping[str, TrialResult]) -> bool:
    """Draw the offsets in metres: above all, below the range of the last three quarters of the drive.

    Sites whose clock is known have none. Returns False, and draws nothing, if no result estimates offsets.
    """
    estimates = {name: r for name, r in results.items() if r.clock_offset_m is not None}
    unknown = recording.sites.clock_offset_std_m + recording.sites.drift_std_m_s > 0.0
    sites = [int(site) for site in np.flatnonzero(unknown)]
    if not estimates or not sites:
        return False
    figure.set_size_inches(max(3.6 * len(sites), WIDTH_IN * 0.6), 4.4)
    grid = figure.subplots(2, len(sites), squeeze=False, sharex=True)
    time_s = recording.time_s - recording.time_s[0]
    styles = estimator_styles(results)
    for column, site in enumerate(sites):
        for name, result in estimates.items():
            assert result.clock_offset_m is not None
            mean, band = result.clock_offset_m[:, site], _band(result, site)
            for axes in grid[:, column]:
                _line_with_band(axes, time_s, mean, band, styles[name])
        for axes in grid[:, column]:
            if recording.truth is not None:
                offset_m = recording.truth.clock_offsets_at(recording.elapsed_s)[:, site]
                axes.plot(recording.elapsed_s, offset_m, color=TRUTH, linestyle=":", label="truth")
            axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
        grid[0, column].set_title(fill(f"site {recording.sites.name[site]}", TITLE))
        grid[1, column].set_ylim(*_settled_range(recording, estimates, site))
        grid[1, column].set_xlabel("time (s)")
    grid[0, 0].set_ylabel("clock offset (m)")
    grid[1, 0].set_ylabel("the same, magnified (m)")
    grid[0, 0].legend(loc="best")
    return True


def _band(result: TrialResult, site: int) -> Floats | None:
    """Return two claimed standard deviations (T,) of a site's offset, in metres."""
    if result.clock_offset_variance_m2 is None:
        return None
    return np.asarray(2.0 * np.sqrt(np.maximum(result.clock_offset_variance_m2[:, site], 0.0)))


def _line_with_band(axes: Axes, time_s: Floats, mean: Floats, band: Floats | None, line: dict[str, Any]) -> None:
    axes.plot(time_s, mean, **line)
    if band is not None:
        label = f"{line['label']} ±2σ"
        colour = line["color"]
        axes.fill_between(time_s, mean - band, mean + band, color=colour, alpha=0.22, linewidth=0, label=label)


def _settled_range(recording: Recording, estimates: Mapping[str, TrialResult], site: int) -> tuple[float, float]:
    """Return an interval that holds truth, estimates and bands after the first quarter of the drive."""
    late = slice(int(SETTLED_SHARE * len(recording.time_s)), None)
    values = []
    for result in estimates.values():
        assert result.clock_offset_m is not None
        mean, band = result.clock_offset_m[late, site], _band(result, site)
        spread = np.zeros_like(mean) if band is None else band[late]
        values += [mean - spread, mean + spread]
    if recording.truth is not None:
        values.append(recording.truth.clock_offsets_at(recording.elapsed_s)[late, site])
    every = np.concatenate(values)
    low, high = float(every.min()), float(every.max())
    margin = 0.08 * (high - low) + 0.05
    return low - margin, high + margin
