"""Threads that do a share each of what is done for every snapshot: kernels let go of the interpreter.

A pool of `concurrent.futures` takes longer to hand over a share than many a share takes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial

import numba


class Hand:
    """A thread that makes one call at a time."""

    def __init__(self) -> None:
        self._wanted, self._free = threading.Lock(), threading.Lock()
        self._wanted.acquire()
        self._call: Callable[[], object] | None = None
        self._failed: Exception | None = None
        threading.Thread(target=self._work, name="cellslam", daemon=True).start()

    def begin(self, call: Callable[[], object]) -> None:
        """Have a call made once the last one is over."""
        self._free.acquire()
        self._call, self._failed = call, None
        self._wanted.release()

    def wait(self) -> None:
        """Return when the call is over. Raises what it raised."""
        with self._free:
            if self._failed is not None:
                raise self._failed

    def _work(self) -> None:
        while True:
            self._wanted.acquire()
            try:
                if self._call is not None:
                    self._call()
            except Exception as error:
                self._failed = error
            self._call = None
            self._free.release()


_idle: list[Hand] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)


@contextmanager
def hands(count: int) -> Iterator[list[Hand]]:
    """Lend so many hands."""
    lent = [_idle.pop() if _idle else Hand() for _ in range(count)]
    try:
        yield lent
    finally:
        _idle.extend(lent)


def threads() -> int:
    """Return how many threads there may be."""
    return int(numba.get_num_threads())


def in_threads(share: Callable[[int], object], shares: int) -> None:
    """Call share(0), share(1) and so on, each in a thread of its own. Raises what one of them raised, when all are
    done."""
    if shares == 1:
        share(0)
        return
    with hands(shares - 1) as others, ExitStack() as ends:
        for i, other in enumerate(others, 1):
            other.begin(partial(share, i))
            ends.callback(other.wait)
        share(0)
