"""How long work reports its progress: a callable that opens one task and returns its `advance`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol


class Progress(Protocol):
    """Opens a task of `total` steps; the context's value is called with the number of steps just done."""

    def __call__(self, description: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """Open the task."""
        ...


@contextmanager
def silent(description: str, total: int) -> Iterator[Callable[[int], None]]:
    """Report nothing: the default of every function that takes a `Progress`."""
    del description, total
    yield lambda _steps: None
