"""Absolute horizontal error against time, with the bound (the paper's Fig. 3)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellslam.benchmarks.bound.cramer_rao import BoundResult
from cellslam.benchmarks.figures.style import GREY, WIDTH_IN, estimator_styles
from cellslam.benchmarks.scores.metrics import errors_over_time
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.recording import Floats, Recording

ODOMETRY_ALONE = "dead-reckoning"
GAP, LEAST_GAP_S = 5.0, 2.0  # a pause of so many median intervals breaks a curve, if it is no shorter


def draw(figure: Figure, recording: Recording, results: Mapping[str, TrialResult], bound: BoundResult | None) -> bool:
    """Draw the errors in metres, and below them all but dead reckoning magnified.

    Returns False, and draws nothing, without truth, reference or results.
    """
    found = {name: errors_over_time(recording, result.poses) for name, result in results.items()}
    known = {name: pair for name, pair in found.items() if pair is not None}
    if not known:
        return False
    times = next(iter(known.values()))[0] - recording.time_s[0]
    errors = {name: error for name, (_, error) in known.items()}
    small = [float(e.max()) for name, e in errors.items() if name != ODOMETRY_ALONE]
    small += [] if bound is None else [float(bound.horizontal_std_m.max())]
    magnified = bool(small) and ODOMETRY_ALONE in errors
    figure.set_size_inches(WIDTH_IN, 4.2 if magnified else 3.0)
    panels = figure.subplots(2 if magnified else 1, 1, squeeze=False, sharex=True)[:, 0]
    for axes in panels:
        _curves(axes, times, errors, bound)
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("horizontal error (m)")
    panels[0].legend(loc="upper left")
    panels[-1].set_xlabel("time (s)")
    if magnified:
        panels[1].set_ylim(0, 1.1 * max(small) + 1e-9)
        panels[1].set_ylabel("the same, magnified (m)")
    return True


def _curves(axes: Axes, time_s: Floats, errors: Mapping[str, Floats], bound: BoundResult | None) -> None:
    for name, line in estimator_styles(errors).items():
        times, error = broken(time_s, errors[name])
        axes.plot(times, error, **line)
        alone = np.isnan(np.append(error[1:], np.nan)) & np.isnan(np.insert(error[:-1], 0, np.nan))
        axes.plot(times[alone], error[alone], ".", color=line["color"], markersize=2.0)
    if bound is not None:
        axes.fill_between(time_s, bound.horizontal_std_m, color=GREY, alpha=0.35, linewidth=0)
        axes.plot(time_s, bound.horizontal_std_m, color=GREY, label="Cramér-Rao bound (rms)")
    axes.set_xlim(0, max(float(time_s[-1]), 1e-9))


def broken(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return times (N,) in s and values (N,) with NaN between those that a pause parts: nothing is drawn through it."""
    step = np.diff(time_s)
    if not len(step):
        return time_s, values
    after = np.flatnonzero(step > max(GAP * float(np.median(step)), LEAST_GAP_S)) + 1
    return np.insert(time_s, after, np.nan), np.insert(values, after, np.nan)
