"""Rays: virtual transmitters, exact visibility, arrival and departure angles, polarimetric path gain."""

from cellslam.sim.rays.paths import Paths
from cellslam.sim.rays.scene import Scene, prepare
from cellslam.sim.rays.tracing import trace

__all__ = ["Paths", "Scene", "prepare", "trace"]
