"""Conformance: what any estimator must fulfil, as checks (`checks`) and as a pytest class (`EstimatorConformance`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.slam.conformance.kit import EstimatorConformance

__all__ = ["EstimatorConformance"]


def __getattr__(name: str) -> Any:
    """Load the pytest class when it is asked for (PEP 562): the checks need no pytest."""
    if name == "EstimatorConformance":
        from cellslam.slam.conformance.kit import EstimatorConformance

        return EstimatorConformance
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
