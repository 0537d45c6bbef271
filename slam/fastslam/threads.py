"""Blocks of particles shared out among threads: the kernels let go of the interpreter, and no block reads another."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import numpy as np

_pools: dict[int, ThreadPoolExecutor] = {}
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)


def threads() -> int:
    """Return how many threads kernels may use."""
    return int(numba.get_num_threads())


def over_blocks(kernel: Callable[..., None], blocks: int, scratch: Sequence[Any], *arguments: Any) -> None:
    """Call kernel(start, stop, *arguments, scratch of the thread) so that all blocks are done."""
    count = max(1, min(len(scratch), blocks, threads()))
    edges = np.linspace(0, blocks, count + 1).astype(int).tolist()
    others = []
    for i in range(1, count):
        if count not in _pools:
            _pools[count] = ThreadPoolExecutor(count - 1, thread_name_prefix="cellslam-blocks")
        others.append(_pools[count].submit(kernel, edges[i], edges[i + 1], *arguments, scratch[i]))
    try:
        kernel(0, edges[1], *arguments, scratch[0])
    finally:
        for other in others:
            other.result()
