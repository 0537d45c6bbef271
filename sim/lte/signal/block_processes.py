"""Blocks of a drive measured by processes of their own: threads would wait for each other's Python code.

The processes are started as modules, not forked: what else the caller's program is, or does, is none of their business.

Source: own, docs/how-to/drive-from-signals.md.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from queue import SimpleQueue

from threadpoolctl import threadpool_limits

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats

Task = Callable[[int], Floats]


class _Process:
    """A child that answers each number with what `task` makes of it."""

    def __init__(self, task: bytes) -> None:
        command = [sys.executable, "-P", "-m", __name__]
        self._child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._ask, self._answer = self._child.stdin, self._child.stdout
        self._first = task

    def ask(self, number: int) -> Floats:
        """Return the task's answer, or raise its error; InputError when the child is gone."""
        try:
            self._ask.write(self._first + pickle.dumps(number))
            self._ask.flush()
            self._first = b""
            answer = pickle.load(self._answer)
        except (EOFError, OSError) as error:
            code = self._child.wait()
            raise InputError(
                f"a process that measures signals has ended with status {code}; finished blocks are kept: run again"
            ) from error
        if isinstance(answer, Exception):
            raise answer
        result: Floats = answer
        return result

    def end(self) -> None:
        """Kill the child, whatever it is doing."""
        self._child.kill()
        self._child.wait()
        self._answer.close()
        with suppress(OSError):
            self._ask.close()


def in_processes(task: Task, numbers: Iterable[int], count: int) -> Iterator[Floats]:
    """Yield `task` of each number, tables of any shape, in order; `count` processes work ahead. `task` must pickle."""
    processes = [_Process(pickle.dumps(task)) for _ in range(count)]
    free: SimpleQueue[_Process] = SimpleQueue()
    for process in processes:
        free.put(process)

    def ask(number: int) -> Floats:
        process = free.get()
        try:
            return process.ask(number)
        finally:
            free.put(process)

    pool = ThreadPoolExecutor(count)
    try:
        yield from pool.map(ask, numbers)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.end()
        pool.shutdown()


def serve() -> None:
    """Be such a child: read the task and numbers from standard input until it ends, write answers to standard
    output."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what anybody prints is no answer
    requests = sys.stdin.buffer
    task: Task = pickle.load(requests)
    with threadpool_limits(1):
        while True:
            try:
                number = pickle.load(requests)
            except EOFError:
                return
            try:
                answer: Floats | Exception = task(number)
            except Exception as error:
                answer = error
            answers.write(pickle.dumps(answer))
            answers.flush()


if __name__ == "__main__":
    serve()
