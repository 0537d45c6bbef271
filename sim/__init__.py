"""The world and the receiver: what is true, and what would be measured.

A `WorldConfig` and a seed in, a `Recording` out (`simulate`), or a prepared `World` that measures pose by pose.
`city`, `rays`, `vehicle` and `lte` are its parts, `world` puts them together, `recording` is what the rest of the
package sees of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellslam.sim.world import World, WorldConfig, prepare, simulate

__all__ = ["World", "WorldConfig", "prepare", "simulate"]


def __getattr__(name: str) -> Any:
    """Load `cellslam.sim.world` when one of its names is asked for (PEP 562): importing the package stays light."""
    if name in __all__:
        from cellslam.sim import world

        return getattr(world, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
