"""Compiled: arrays that a kernel may use without counting references.

Threads that count references to the same array write to the same place in memory by turns; their caller holds the
arrays for as long as they run, so that nobody need count.
"""

from __future__ import annotations

from typing import Any

from numba.core import cgutils
from numba.extending import intrinsic

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.state.layout import Blocks, Measured, Scratch, Step, Tracks


def _borrowed(context: Any, array: Any) -> Any:
    """Return the same array, not counted."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = target.make_array(signature.args[0])(target, builder, arguments[0])
        null: Any = cgutils.get_null_value
        view.meminfo, view.parent = null(view.meminfo.type), null(view.parent.type)
        return view._getvalue()

    return array(array), generate


borrowed: Any = intrinsic(_borrowed)


@njit(error_model="numpy")
def borrowed_blocks(b: Blocks) -> Blocks:
    """Return the same particles, not counted."""
    t = b.tracks
    tracks = Tracks(
        borrowed(t.status), borrowed(t.alike), borrowed(t.records), borrowed(t.ident), borrowed(t.order),
        borrowed(t.counts), borrowed(t.bounds),
    )  # fmt: skip
    return Blocks(borrowed(b.state), tracks, borrowed(b.travelled), borrowed(b.log_weight))


@njit(error_model="numpy")
def borrowed_scratch(s: Scratch) -> Scratch:
    """Return the same scratch, not counted."""
    return Scratch(
        borrowed(s.w), borrowed(s.bits), borrowed(s.v), borrowed(s.near), borrowed(s.reached), borrowed(s.rows),
        borrowed(s.scores), borrowed(s.claims), borrowed(s.row_of), borrowed(s.table), borrowed(s.column),
        borrowed(s.floats), borrowed(s.ints),
    )  # fmt: skip


@njit(error_model="numpy")
def borrowed_step(s: Step) -> Step:
    """Return the same snapshot, not counted."""
    m = s.measured
    measured = Measured(
        borrowed(m.first), borrowed(m.site_of), borrowed(m.shares), borrowed(m.z), borrowed(m.many), borrowed(m.fresh),
        m.born,
    )  # fmt: skip
    return Step(s.now, s.dt, borrowed(s.velocity), measured, s.rules)
