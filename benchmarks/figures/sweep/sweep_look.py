"""How the figures of a sweep look: what they show, the labels of axes."""

from __future__ import annotations

from dataclasses import dataclass

AXIS = {
    "position_rmse_m": "position RMSE (m)",
    "position_max_m": "largest position error (m)",
    "position_end_m": "position error at the end (m)",
    "heading_rmse_rad": "heading RMSE (rad)",
    "clock_offset_rmse_m": "clock offset error at the end (m)",
    "map_gospa_m": "map GOSPA (m)",
    "nees_mean": "mean NEES",
    "estimate_seconds": "time of the estimator (s a trial)",
}

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
    return f"{AXIS.get(look.metric, look.metric)},\n{STATISTICS.get(look.statistic, look.statistic)} over trials"
