"""Where the time of a command goes: by the tasks that it reports, compiling apart."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from cellslam.sim.progress import Progress

COMPILED = "for compiled code (made once, then loaded)"
LEAST_S = 0.05


class TimeSpent:
    """Adds up the wall-clock time of tasks, in s; of tasks in each other, the outer one counts."""

    def __init__(self) -> None:
        from numba.core import event

        self._begin = time.monotonic()
        self._by_task: defaultdict[str, float] = defaultdict(float)  # seconds
        self._open = 0
        self._compiling = event.TimingListener()  # type: ignore[no-untyped-call]
        event.register("numba:compile", self._compiling)  # type: ignore[no-untyped-call]

    def of(self, progress: Progress) -> Progress:
        """Return a progress that passes its tasks on to another, and adds up their time."""

        @contextmanager
        def task(description: str, total: int) -> Iterator[Callable[[int], None]]:
            begin, compiled = time.monotonic(), self._compiled_s()
            self._open += 1
            try:
                with progress(description, total) as advance:
                    yield advance
            finally:
                self._open -= 1
                if not self._open:
                    compiled = self._compiled_s() - compiled
                    waits = description.startswith("compiling ")
                    self._by_task[COMPILED if waits else description] += time.monotonic() - begin - compiled

        return task

    def in_words(self) -> str:
        """Return the time of each task in one line, the longest first."""
        total, compiled = time.monotonic() - self._begin, self._compiled_s()
        spent = {**self._by_task, COMPILED: self._by_task[COMPILED] + compiled}
        spent["other"] = total - sum(spent.values())
        longest_first = sorted(spent, key=lambda task: -spent[task])
        parts = [f"{spent[task]:.1f} {task}" for task in longest_first if spent[task] > LEAST_S]
        return f"took {total:.1f} s: {', '.join(parts)}"

    def _compiled_s(self) -> float:
        return float(self._compiling.duration) if self._compiling.done else 0.0
