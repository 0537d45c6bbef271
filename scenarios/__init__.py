"""Scenarios: a world, and the options of the estimators that meet it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.scenarios.loading import load, preset_names
    from cellslam.scenarios.scenario import Scenario

__all__ = ["Scenario", "load", "preset_names"]


def __getattr__(name: str) -> Any:
    """Load the models when one of the names is asked for (PEP 562): importing the package stays light."""
    if name == "Scenario":
        from cellslam.scenarios.scenario import Scenario

        return Scenario
    if name in __all__:
        from cellslam.scenarios import loading

        return getattr(loading, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
