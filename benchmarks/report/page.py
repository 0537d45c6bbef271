"""The report of a sweep: one self-contained HTML page that works offline."""

from __future__ import annotations

import json
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from cellslam.benchmarks.report.choice import Choice
from cellslam.sim.progress import Progress, silent

PAGE = "report.html"


def write_report(
    folder: str | Path, out: str | Path | None = None, choice: Choice | None = None, progress: Progress = silent
) -> Path:
    """Write the report of a sweep's folder to `out` (default: DIR/report.html) and return its path.

    Raises InputError for a folder without results, an unknown metric or estimator, or without plotly.
    """
    from cellslam.benchmarks.figures.city_page import check_plotly
    from cellslam.benchmarks.report.report_content import content
    from cellslam.benchmarks.trials.output_files import check_file

    check_plotly()
    path = Path(folder) / PAGE if out is None else Path(out)
    check_file(path)
    write_page(path, content(Path(folder), choice or Choice(), progress))
    return path


def write_page(path: Path, content: Mapping[str, Any]) -> None:
    """Write the page of a report's content at once. Raises InputError when the disk refuses."""
    from plotly.offline import get_plotlyjs

    from cellslam.benchmarks.trials.output_files import write_text
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
