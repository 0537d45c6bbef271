"""Paths of other ray tracers, and of measurements, in; our own out.

`sionna` reads and writes what users of Sionna RT save of its `Paths`, `deepmimo` scenario folders; `traced_paths`
checks what was read against geometry, whatever the format, and makes `Paths` of it.
"""

from cellslam.sim.rays.exchange.deepmimo import read_deepmimo, write_deepmimo
from cellslam.sim.rays.exchange.sionna import read_sionna, write_sionna
from cellslam.sim.rays.exchange.traced_paths import EXACT, Tolerance, Traced

__all__ = ["EXACT", "Tolerance", "Traced", "read_deepmimo", "read_sionna", "write_deepmimo", "write_sionna"]
