"""The viewer: one self-contained HTML page that works offline. Reports, playbacks and cities are contents of it."""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.trials.output_files import check_file, write_text
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent

if TYPE_CHECKING:
    from cellslam.benchmarks.report.worst_trials import Choice

PAGE = "report.html"
# Scripts that need plotly; what is read first, text and tables, is there before it.
PLOTS = ("plots.js", "scene.js", "charts.js", "trial.js")


def write_report(
    folder: str | Path, out: str | Path | None = None, choice: Choice | None = None, progress: Progress = silent
) -> Path:
    """Write the report of a sweep's folder to `out` (default: DIR/report.html) and return its path.

    Raises InputError for a folder without results, an unknown metric or estimator, or without plotly.
    """
    from cellslam.benchmarks.report.report_content import content
    from cellslam.benchmarks.report.worst_trials import Choice
    from cellslam.benchmarks.sweeps.store import reading

    check_plotly()
    path = Path(folder) / PAGE if out is None else Path(out)
    with reading(Path(folder)):  # says so where there are no results
        check_file(path)
    write_page(path, content(Path(folder), choice or Choice(), progress))
    return path


def check_plotly() -> None:
    """Raise InputError unless plotly is installed."""
    if find_spec("plotly") is None:
        raise InputError("interactive pages need plotly: pip install 'cellslam[report]'")


def write_page(path: Path, content: Mapping[str, Any]) -> None:
    """Write the viewer's page of a content at once; a section without content is not shown.

    Raises InputError without plotly, and when the disk refuses.
    """
    check_plotly()
    from plotly.offline import get_plotlyjs

    def own(name: str) -> str:
        return (files("cellslam.benchmarks.report") / name).read_text("utf-8")

    parts = {
        "title": escape(content["title"]),
        "style": own("page.css"),
        "plotly": packed(get_plotlyjs()),
        "data": embedded(content),
        "tables": own("page.js"),
        "plots": "\n".join(map(own, PLOTS)),
    }
    write_text(path, Template(own("page.html")).substitute(parts))


def packed(text: str) -> str:
    """Return a text as the base64 of its gzip, always the same: plotly is then a third as long."""
    return b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def embedded(content: Mapping[str, Any]) -> str:
    """Return JSON that is safe inside a script element of HTML."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
