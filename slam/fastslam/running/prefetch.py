"""Compiled: memory asked for before it is needed, so that the processor need not wait for it.

Source: LLVM language reference, `llvm.prefetch`.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from cellslam.sim.compiling import njit

LINE_BYTES = 64


def _asked(context: Any, array: Any, index: Any) -> Any:
    """Ask for the cache line of array[index]."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = target.make_array(signature.args[0])(target, builder, arguments[0])
        place = builder.bitcast(builder.gep(view.data, [arguments[1]]), ir.IntType(8).as_pointer())
        flag = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [place.type, flag, flag, flag])
        function = builder.module.globals.get("llvm.prefetch.p0")
        if function is None:
            function = ir.Function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [place, flag(0), flag(3), flag(1)])
        return target.get_dummy_value()

    return types.void(array, index), generate


_ask: Any = intrinsic(_asked)


@njit(error_model="numpy")
def prefetch(array: NDArray[Any]) -> None:
    """Ask for a contiguous array of any shape, in any units, line by line."""
    step = LINE_BYTES // array.itemsize
    for i in range(0, array.size, step):
        _ask(array, i)


@njit(error_model="numpy")
def prefetch_column(array: NDArray[Any], first: int, step: int) -> None:
    """Ask for array[first], array[first + step] and so on, by index into an array of any shape."""
    for i in range(first, array.size, step):
        _ask(array, i)
