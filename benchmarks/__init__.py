"""Monte Carlo trials of estimators, their scores, tables and figures."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.benchmarks.sweeps.rows import results
    from cellslam.benchmarks.tables.summaries import comparison, summary
    from cellslam.python_api import replay, run, sweep

__all__ = ["comparison", "replay", "results", "run", "summary", "sweep"]


def __getattr__(name: str) -> Any:
    """Load what is asked for (PEP 562), which `cellslam` has under the same name: the package stays light."""
    if name in __all__:
        return getattr(import_module("cellslam"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
