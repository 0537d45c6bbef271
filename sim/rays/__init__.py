"""The ray tracer: a city and positions in, all specular paths between them out.

`trace` (tracing.py) takes a `City`, or the `Scene` that `prepare` makes of it once, transmitters (S, 3) and receivers
(N, 3) in metres, and returns `Paths`: identity and position of the virtual transmitter, directions, polarimetric gain.
Lines of sight and single reflections are found in `first_order`, which begins with the equations, double ones in
`second_order`, paths over edges in `diffraction`; their gain is computed in `gain` and `diffraction`; `*_kernel` are
the compiled parts.
"""

from cellslam.sim.rays.paths import Paths
from cellslam.sim.rays.scene import Scene, prepare
from cellslam.sim.rays.tracing import trace

__all__ = ["Paths", "Scene", "prepare", "trace"]
