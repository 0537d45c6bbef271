"""Monte Carlo trials of estimators, their scores, tables and figures."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.benchmarks.sweeps.rows import results
    from cellslam.benchmarks.tables.summaries import comparison, summary
    from cellslam.python_api import replay, run, sweep

__all__ = ["comparison", "replay", "results", "run", "summary", "sweep"]
_HOMES = {
    "comparison": "cellslam.benchmarks.tables.summaries",
    "replay": "cellslam.python_api",
    "results": "cellslam.benchmarks.sweeps.rows",
    "run": "cellslam.python_api",
    "summary": "cellslam.benchmarks.tables.summaries",
    "sweep": "cellslam.python_api",
}


def __getattr__(name: str) -> Any:
    """Load what is asked for (PEP 562): importing the package stays light."""
    if name in _HOMES:
        found = globals()[name] = getattr(import_module(_HOMES[name]), name)
        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
