"""What one update of FastSLAM must move and compute, counted in the source of its kernels, and what the machine can."""

from __future__ import annotations

import ast
import inspect
import textwrap
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.snapshot import nuisance_kernel, pair_kernel, predict_kernel, update_kernel
from cellslam.slam.fastslam.state.layout import LANES, RECORD, RECORD_LAYOUT

SINGLE = 4  # bytes of a number of a record
# What one VT and one measurement that belong to each other go through.
PREDICTED: tuple[Any, ...] = (predict_kernel.predict, pair_kernel.reach)
PAIRED: tuple[Any, ...] = (pair_kernel.innovate, pair_kernel.invert, pair_kernel.logarithm)
UPDATED: tuple[Any, ...] = (
    pair_kernel.innovate, pair_kernel.invert, pair_kernel.logarithm, update_kernel.credit, nuisance_kernel.absorb,
    update_kernel.correct,
)  # fmt: skip


@dataclass(frozen=True)
class Work:
    """Of one update of one VT in one particle: arithmetic operations, bytes of its record read and written."""

    operations: int
    bytes_read: int
    bytes_written: int


def work_of_update() -> Work:
    """Return the work of an update whose VT is predicted once, paired with one measurement and corrected by it."""
    operations = sum(operations_of(kernel) for kernel in (*PREDICTED, *PAIRED, *UPDATED))
    return Work(operations, SINGLE * RECORD, SINGLE * rows_written(update_kernel.correct))


def operations_of(kernel: Any) -> int:
    """Return the arithmetic operations of a compiled kernel on one lane: those in its source and in compiled
    functions that it calls; indices do not count, nor do parts of the filter."""
    tree, names = _parsed(kernel), vars(inspect.getmodule(kernel.py_func))
    total = 0
    for node in _outside_indices(tree):
        if isinstance(node, ast.BinOp | ast.AugAssign):
            total += 1
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called in ("math.sqrt", "max", "min", "abs"):
                total += 1
            elif hasattr(names.get(called), "py_func"):
                total += operations_of(names[called])
    return total


def rows_written(kernel: Any, record: str = "rec") -> int:
    """Return how many rows of `record` a kernel writes: one by one, or a field of its layout by a function `put...`."""
    stores, fields = set(), set()
    for node in ast.walk(_parsed(kernel)):
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == record:
            stores.add(ast.unparse(node.slice))
        elif isinstance(node, ast.Call) and ast.unparse(node.func).startswith("put"):
            where, field = (ast.unparse(a) for a in node.args[:2])
            fields |= {field} if where == record else set()
    return len(stores) + sum(RECORD_LAYOUT.sizes[field] for field in fields)


def _parsed(kernel: Any) -> ast.AST:
    return ast.parse(textwrap.dedent(inspect.getsource(kernel.py_func)))


def _outside_indices(node: ast.AST) -> list[ast.AST]:
    """Return all nodes that are no part of an index."""
    out = [node]
    for child in ast.iter_child_nodes(node):
        if isinstance(node, ast.Subscript) and child is node.slice:
            continue
        out.extend(_outside_indices(child))
    return out


@njit(cache=True, error_model="numpy")
def _turn(values: Any, rounds: int) -> Any:
    """Multiply and add, two operations each, in as many chains as keep a core busy."""
    F = values.dtype.type
    for _ in range(rounds):
        for i in range(len(values)):
            values[i] = values[i] * F(0.999) + F(0.001)


def operations_per_s(repeat: int = 5) -> float:
    """Return single-precision operations a second of one thread, compiled as the filter is, data in the first cache."""
    values, rounds, best = np.ones(8 * LANES, np.float32), 200_000, np.inf
    _turn(values, 1)
    for _ in range(repeat):
        begin = time.perf_counter()
        _turn(values, rounds)
        best = min(best, time.perf_counter() - begin)
    return 2.0 * rounds * len(values) / best
