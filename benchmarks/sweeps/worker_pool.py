"""A pool of worker processes that heals: one that dies or hangs costs the job it was at, and is replaced.

`main` is the worker's end of the pipe, `_Worker` the pool's.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from typing import IO

from cellslam.benchmarks.sweeps.tasks import Began, Lost, Result, Task, work
from cellslam.benchmarks.trials.child_process import POLL_S, START_LIMIT_S, Limits, bind, ending, started
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.sim.errors import InputError

# Generous: a first use compiles.
WORLD_LIMIT_S = 1800.0
PRINTED_LAST = 4000
PROCESS = "its worker process"


@dataclass(frozen=True)
class Ready:
    """A worker has started, or has done its task."""


def main() -> None:
    """Serve the pipe whose number is the first argument; then come the limits: bytes of memory and milliseconds."""
    number, memory_bytes, milliseconds = (int(word) for word in sys.argv[1:])
    connection = Connection(number)
    bind(memory_bytes)
    try:
        with ExternalProcesses(Limits(1e-3 * milliseconds, memory_bytes), one_thread=True) as external:
            connection.send(Ready())
            while True:
                for message in work(connection.recv(), external):
                    connection.send(message)
                connection.send(Ready())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        # The parent is gone, or needs this worker no more.
        return


class Pool:
    """Worker processes, started fresh (spawned), each with one thread. Use as a context: leaving it ends them."""

    def __init__(self, jobs: int, limits: Limits) -> None:
        self.jobs, self.limits = jobs, limits
        self._workers: list[_Worker] = []
        self._failed_starts = 0

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def run(self, tasks: Iterable[Task]) -> Iterator[Result | Lost]:
        """Yield the results as they come, in any order, and what was lost. Raises InputError if no worker starts."""
        queue = deque(tasks)
        while queue or any(worker.task is not None for worker in self._workers):
            while len(self._workers) < min(self.jobs, len(queue) + self._busy()):
                self._workers.append(_Worker(self.limits))
            for worker in self._workers:
                if worker.idle and queue:
                    worker.give(queue.popleft())
            for worker in self._ready():
                for message in worker.receive():
                    if isinstance(message, Task):
                        queue.appendleft(message)
                    else:
                        yield message
            self._replace_the_dead()

    def _busy(self) -> int:
        return sum(worker.task is not None for worker in self._workers)

    def _ready(self) -> list[_Worker]:
        """Wait for messages; return the workers that have some, died, or are out of time."""
        open_pipes = {
            worker.connection: worker for worker in self._workers if not (worker.idle and worker.task is None)
        }
        ready = {open_pipes[pipe] for pipe in wait(list(open_pipes), POLL_S) if isinstance(pipe, Connection)}
        return [worker for worker in self._workers if worker in ready or worker.overdue or worker.died]

    def _replace_the_dead(self) -> None:
        for worker in [w for w in self._workers if w.ended]:
            self._workers.remove(worker)
            self._failed_starts = 0 if worker.started else self._failed_starts + 1
            if self._failed_starts > self.jobs + 1:
                last = worker.printed().strip().rpartition("\n")[2] or worker.reason
                raise InputError(f"worker processes do not start: {last}; --executor serial works without them")


class _Worker:
    """One process, and what it is at."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.task: Task | None = None
        self.job: str | None = None
        self.started = self.idle = self.began = self.ended = False
        self.reason = self._last = ""
        self._output: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (closed by end())
        self.connection, theirs = Pipe()
        numbers = (theirs.fileno(), limits.memory_bytes, round(1e3 * limits.seconds))
        self.process = started(__name__, numbers, numbers[:1], self._output, True)
        theirs.close()
        self._deadline = time.monotonic() + START_LIMIT_S

    @property
    def overdue(self) -> bool:
        """Whether its time is up."""
        return not (self.idle and self.task is None) and time.monotonic() > self._deadline

    @property
    def died(self) -> bool:
        """Whether the process ended by itself."""
        return not self.ended and self.process.poll() is not None

    def give(self, task: Task) -> None:
        """Send a task. If the process is gone, that is noticed when its answer is waited for."""
        self.task, self.job, self.idle, self.began = task, None, False, False
        self._deadline = time.monotonic() + WORLD_LIMIT_S
        try:
            self.connection.send(task)
        except OSError:
            return

    def receive(self) -> Iterator[Result | Lost | Task]:
        """Yield the results that have arrived; of a lost task the job it was at, and the rest as a task."""
        try:
            while self.connection.poll():
                yield from self._message(self.connection.recv())
        except (EOFError, OSError):
            yield from self._lost(ending(self.process, PROCESS))
            return
        if self.overdue:
            self.process.kill()
            what = (
                f"time limit of {self.limits.seconds:g} s" if self.job else f"{WORLD_LIMIT_S:g} s that a world may take"
            )
            yield from self._lost(f"no answer within the {what}")
        elif self.died and not self.connection.poll():
            yield from self._lost(ending(self.process, PROCESS))

    def end(self) -> None:
        """End the process at once."""
        self.ended = True
        self.connection.close()
        self.process.kill()
        self.process.wait()
        self._output.close()

    def printed(self) -> str:
        """Return the last that the process printed."""
        if self._output.closed:
            return self._last
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - PRINTED_LAST))
        return self._output.read().decode("utf-8", "replace")

    def _message(self, message: Began | Result | Lost | Ready) -> Iterator[Result | Lost]:
        at_world = not isinstance(message, Began) or message.key is None
        apart = isinstance(message, Began) and message.apart  # that process has the limit, once it has started
        limit_s = WORLD_LIMIT_S if at_world else self.limits.seconds + (START_LIMIT_S if apart else 0.0)
        self._deadline = time.monotonic() + limit_s
        if isinstance(message, Ready):
            self.started = self.idle = True
            self.task = self.job = None
        elif isinstance(message, Began):
            self.job, self.began = message.key, True
        else:
            assert self.task is not None
            self.task = self.task.without(message.key)
            yield replace(message, details=self.printed()) if isinstance(message, Lost) else message

    def _lost(self, reason: str) -> Iterator[Lost | Task]:
        self.reason, self._last = reason, self.printed()
        task, at = self.task, self.job
        self.task = None
        self.end()
        if task is None:
            return
        # Without a job it was the world that killed the worker: it would do so for all of them. A worker that died
        # before it began is not the task's fault.
        guilty = [job for job in task.jobs if self.began and at in (None, job.key)]
        for job in guilty:
            yield Lost(task, job, reason, self._last)
            task = task.without(job.key)
        if task.jobs:
            yield task
