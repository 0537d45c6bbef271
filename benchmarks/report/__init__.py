"""The report of a sweep: one self-contained HTML page that works offline."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from cellslam.sim.progress import Progress, silent

PAGE = "report.html"


@dataclass(frozen=True)
class Choice:
    """What a report shows of the worst trials: how many of each of these estimators, and by which metric.

    `estimators` empty: the one whose median is lowest, oracles aside.
    """

    worst: int = 3
    metric: str = "position_rmse_m"
    estimators: Sequence[str] = ()


def write_report(
    folder: str | Path, out: str | Path | None = None, choice: Choice | None = None, progress: Progress = silent
) -> Path:
    """Write the report of a sweep's folder to `out` (default: DIR/report.html) and return its path.

    Raises InputError for a folder without results, an unknown metric or estimator, or without plotly.
    """
    from cellslam.benchmarks.figures.html import check_plotly
    from cellslam.benchmarks.output import check_file
    from cellslam.benchmarks.report.content import content

    check_plotly()
    path = Path(folder) / PAGE if out is None else Path(out)
    check_file(path)
    write_page(path, content(Path(folder), choice or Choice(), progress))
    return path


def write_page(path: Path, content: Mapping[str, Any]) -> None:
    """Write the page of a report's content at once. Raises InputError when the disk refuses."""
    from plotly.offline import get_plotlyjs

    from cellslam.benchmarks.output import write_text
    from cellslam.sim.errors import InputError

    own = files("cellslam.benchmarks.report")
    scripts = "\n".join((own / name).read_text("utf-8") for name in ("page.js", "plots.js", "trial.js"))
    parts = {
        "title": escape(content["title"]),
        "style": (own / "page.css").read_text("utf-8"),
        "plotly": get_plotlyjs(),
        "data": embedded(content),
        "script": scripts,
    }
    try:
        write_text(path, Template((own / "page.html").read_text("utf-8")).substitute(parts))
    except OSError as error:
        raise InputError(f"{path}: the report cannot be written ({error.strerror or error})") from error


def embedded(content: Mapping[str, Any]) -> str:
    """Return JSON that is safe inside a script element of HTML."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def rounded(values: Any, digits: int = 2) -> Any:
    """Return an array as nested lists of short numbers, what is not finite as None."""
    array = np.asarray(values, np.float64)
    if array.ndim > 1:
        return [rounded(row, digits) for row in array]
    short = np.round(array, digits) + 0.0
    whole = digits <= 0
    return [(int(v) if whole else v) if np.isfinite(v) else None for v in short.tolist()]
