"""Monte Carlo trials of estimators, their scores, tables and figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.benchmarks.trials import run

__all__ = ["run"]


def __getattr__(name: str) -> Any:
    """Load the runner when it is asked for (PEP 562): importing the package stays light."""
    if name == "run":
        from cellslam.benchmarks.trials import run

        return run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
