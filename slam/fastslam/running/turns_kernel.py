"""Compiled: blocks of particles handed out to threads one at a time, by counters that all of them see.

A thread that the machine holds up takes fewer; none waits for the other before all blocks are taken.

Source: LLVM language reference, `atomicrmw`; blocks are handed out as in Tang and Yew, "Processor self-scheduling for
multiple-nested parallel loops", ICPP 1986.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from cellslam.sim.compiling import njit

TAKEN, DONE = 0, 8  # places of the counters, on cache lines of their own
COUNTERS = 16
PATIENCE = 20_000  # looks at DONE before the interpreter is asked to wait: some 100 us


def _place(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    view = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(view.data, [arguments[1]])


def _added(context: Any, array: Any, index: Any) -> Any:
    """Add 1 to array[index] for all threads at once; return what it was before."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        one = ir.Constant(ir.IntType(64), 1)
        return builder.atomic_rmw("add", _place(target, builder, signature, arguments), one, "seq_cst")

    return types.int64(array, index), generate


def _looked(context: Any, array: Any, index: Any) -> Any:
    """Return array[index] as the last thread left it."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load_atomic(_place(target, builder, signature, arguments), "seq_cst", 8)

    return types.int64(array, index), generate


_add: Any = intrinsic(_added)
_look: Any = intrinsic(_looked)


def new_turns() -> NDArray[np.int64]:
    """Return counters (16,) at the start."""
    return np.zeros(COUNTERS, np.int64)


@njit(error_model="numpy")
def take(turns: NDArray[np.int64]) -> int:
    """Return the number of a block that nobody has taken yet, by the counters (16,); past the last block, one too
    many."""
    return int(_add(turns, TAKEN))


@njit(error_model="numpy")
def done(turns: NDArray[np.int64]) -> None:
    """Say in the counters (16,) that a block is done: others may read what was written."""
    _add(turns, DONE)


@njit(error_model="numpy")
def all_done(turns: NDArray[np.int64], blocks: int) -> None:
    """Look for a while at the counters (16,), whether all blocks are done."""
    for _ in range(PATIENCE):
        if _look(turns, DONE) >= blocks:
            return
