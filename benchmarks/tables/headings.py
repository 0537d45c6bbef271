"""What stands above the columns of tables that are read away from the command line: reports, papers."""

from __future__ import annotations

import re

# Headings of tables by metric: text, unit, meaning.
HEADINGS = {
    "position_rmse_m": ("RMSE", "m", "root mean square of the horizontal position error over the drive"),
    "position_max_m": ("largest", "m", "largest position error"),
    "position_end_m": ("end", "m", "position error at the end"),
    "heading_rmse_rad": ("heading", "rad", "heading RMSE"),
    "clock_offset_rmse_m": ("offsets", "m", "clock offset error at the end, root mean square over sites"),
    "transmitter_rmse_m": ("sites", "m", "error of the sites' estimated positions, root mean square"),
    "map_gospa_m": ("map", "m", "GOSPA of the virtual transmitters, mean over links"),
    "wall_gospa_m": ("walls", "m", "GOSPA of the walls' visible parts"),
    "wall_share": ("mapped", "", "share of the seen facades' length that is mapped"),
    "wall_normal_rmse_rad": ("wall normals", "rad", "error of the walls' directions, root mean square"),
    "wall_offset_rmse_m": ("wall offsets", "m", "by how much the walls are off across them, root mean square"),
    "association_precision": ("precision", "", "share of associations that are right"),
    "association_recall": ("recall", "", "share of measurements of a VT that were associated rightly"),
    "nees_mean": ("NEES", "", "mean normalised error of the horizontal position: 2 is right"),
    "bound_position_rmse_m": ("bound", "m", "Cramér-Rao bound of the position RMSE"),
    "bound_merged_m": ("bound, merging in", "m", "with merging as an error that persists, where many are merged"),
    "realtime_factor": ("x real", "time", "duration of the drive over time of the estimator"),
    "peak_memory_mb": ("memory", "MB", "what resident memory grew by at the most while the estimator ran"),
    "efficiency_ratio": ("efficiency ratio", "", "root mean square of the RMSE over that of the bound, 1 at best"),
}
_KEY = re.compile(rf"\b({'|'.join(HEADINGS)})\b")
_CLASS = re.compile(r"[\w.]+:(?=\w)")


def in_words(text: str) -> str:
    """Return a text with headings in place of metrics, and classes without the modules that they are in."""
    return _CLASS.sub("", _KEY.sub(lambda found: _heading(found[0]), text))


def _heading(metric: str) -> str:
    text, unit, _ = HEADINGS[metric]
    return f"{text} {unit}" if unit == "time" else f"{text} ({unit})" if unit else text
