"""Copies of arrays within kernels.

Where an array is assigned to a part of another one, Numba also compiles the text of the error that this might raise,
which takes 1.6 s in each process that compiles.
"""

from __future__ import annotations

from typing import Any

from cellslam.sim.compiling import lean


@lean
def put(out: Any, given: Any) -> None:
    """Write the numbers of `given` (n,) to the first of `out`."""
    for i in range(len(given)):
        out[i] = given[i]
