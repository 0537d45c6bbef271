"""Monte Carlo trials of estimators, their scores, tables and figures."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.benchmarks.python_api import replay, run, sweep
    from cellslam.benchmarks.sweeps.rows import results
    from cellslam.benchmarks.tables.summaries import comparison, summary

__all__ = ["comparison", "replay", "results", "run", "summary", "sweep"]
_HOMES = {
    "comparison": "tables.summaries", "replay": "python_api", "results": "sweeps.rows", "run": "python_api",
    "summary": "tables.summaries", "sweep": "python_api",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load what is asked for (PEP 562): importing the package stays light."""
    if name in _HOMES:
        found = globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
