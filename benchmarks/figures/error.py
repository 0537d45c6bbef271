"""Absolute horizontal error against time, with the bound (the paper's Fig. 3)."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from cellslam.benchmarks.bound import BoundResult
from cellslam.benchmarks.figures.style import GREY, WIDTH_IN, estimator_styles
from cellslam.benchmarks.metrics import horizontal_error
from cellslam.benchmarks.result import TrialResult
from cellslam.sim.recording import Recording


def draw(figure: Figure, recording: Recording, results: Mapping[str, TrialResult], bound: BoundResult | None) -> bool:
    """Draw the errors in metres; return False, and draw nothing, without truth or results."""
    if recording.truth is None or not results:
        return False
    figure.set_size_inches(WIDTH_IN, 3.0)
    axes = figure.add_subplot()
    time_s = recording.time_s - recording.time_s[0]
    for name, line in estimator_styles(results).items():
        axes.plot(time_s, horizontal_error(recording.truth.poses, results[name].poses), **line)
    if bound is not None:
        axes.fill_between(time_s, bound.horizontal_std_m, color=GREY, alpha=0.35, linewidth=0)
        axes.plot(time_s, bound.horizontal_std_m, color=GREY, label="Cramér-Rao bound (rms)")
    axes.set_xlabel("time (s)")
    axes.set_ylabel("horizontal error (m)")
    axes.set_xlim(0, max(float(time_s[-1]), 1e-9))
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left")
    return True
