"""How the figures of a sweep look: what they show, the labels of axes."""

from __future__ import annotations

from dataclasses import dataclass

from cellslam.benchmarks.scores.metrics import METRIC

STATISTICS = {"rmse": "root mean square"}


@dataclass(frozen=True)
class Look:
    """What the sweep curve shows: key along x (None: the first that varies, a number if any is), metric, statistic."""

    x: str | None = None
    metric: str = "position_rmse_m"
    statistic: str = "median"
    confidence: float = 0.95


def summed_label(look: Look) -> str:
    """Return the label of an axis: the metric, and how trials are summed up."""
    return f"{axis(look.metric)},\n{STATISTICS.get(look.statistic, look.statistic)} over trials"


def axis(metric: str) -> str:
    """Return the label of an axis of a metric."""
    return METRIC[metric].label or METRIC[metric].titled
