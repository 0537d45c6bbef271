"""Blocks of particles shared out among threads: the kernels let go of the interpreter, and no block reads another."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numba

from cellslam.slam.fastslam.running.turns_kernel import DONE, new_turns


class _Hand:
    """A thread that helps with one call at a time."""

    def __init__(self) -> None:
        self._wanted, self._free = threading.Lock(), threading.Lock()
        self._wanted.acquire()
        self._call: tuple[Callable[..., None], tuple[Any, ...]] | None = None
        threading.Thread(target=self._work, name="cellslam-blocks", daemon=True).start()

    def begin(self, kernel: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        """Have `kernel` called once the last call is over."""
        self._free.acquire()
        self._call = kernel, arguments
        self._wanted.release()

    def wait(self) -> None:
        """Return when the call is over."""
        with self._free:
            pass

    def _work(self) -> None:
        while True:
            self._wanted.acquire()
            if self._call is not None:
                kernel, arguments = self._call
                with suppress(Exception):  # whoever asked makes the same call, and raises the same
                    kernel(*arguments)
                self._call = kernel = arguments = None  # type: ignore[assignment]
            self._free.release()


_idle: list[_Hand] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)


def threads() -> int:
    """Return how many threads kernels may use."""
    return int(numba.get_num_threads())


def over_blocks(kernel: Callable[..., None], blocks: int, scratch: Sequence[Any], *arguments: Any) -> None:
    """Call kernel(turns, blocks, *arguments, scratch of the thread) in as many threads as may be, until all blocks are
    done."""
    turns = new_turns()
    others = []
    for i in range(1, min(len(scratch), blocks, threads())):
        others.append(_idle.pop() if _idle else _Hand())
        others[-1].begin(kernel, (turns, blocks, *arguments, scratch[i]))
    try:
        kernel(turns, blocks, *arguments, scratch[0])
        if turns[DONE] < blocks:
            for other in others:
                other.wait()
    finally:
        _idle.extend(others)
