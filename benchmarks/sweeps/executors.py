"""Where tasks are worked off: in this process, in a pool of processes, or on a Dask cluster. All give the same rows.

An executor is a function of tasks, which yields the results of their jobs, in any order, and what was lost with its
worker. `main` is the worker's side of the pool; how a process is started, limited and ended is in
`trials.child_process`.
"""

from __future__ import annotations

import os
import pickle
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from multiprocessing.connection import wait
from typing import IO, Any

from cellslam.benchmarks.sweeps.tasks import Began, Lost, Result, Task, work
from cellslam.benchmarks.trials.child_process import POLL_S, START_LIMIT_S, ChildProcess, Limits, connect
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.benchmarks.trials.failures import LostError
from cellslam.sim.errors import InputError

CONNECT_S = 20
TASKS_AHEAD = 4
# Generous: a first use compiles.
WORLD_LIMIT_S = 1800.0
PRINTED_LAST = 4000

Executor = Callable[[Iterable[Task]], Iterator[Result | Lost]]
_of_thread = threading.local()


@contextmanager
def executor(name: str, jobs: int, limits: Limits, scheduler: str | None = None) -> Iterator[Executor]:
    """Give the executor of that name; `scheduler` is the address of a running Dask scheduler."""
    if name == "serial":
        with one_thread(limits) as external:
            yield partial(_one_by_one, external)
    elif name == "processes":
        with Pool(jobs, limits) as pool:
            yield pool.run
    else:
        with _cluster(jobs, scheduler) as client:
            yield partial(_on_cluster, client, limits)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def one_thread(limits: Limits) -> Iterator[ExternalProcesses]:
    """Let this process have one thread; give the processes of external estimators, each with one as well."""
    import numba
    from threadpoolctl import threadpool_limits

    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        with threadpool_limits(1), ExternalProcesses(limits, one_thread=True) as external:
            yield external
    finally:
        numba.set_num_threads(threads)


def _one_by_one(external: ExternalProcesses, tasks: Iterable[Task]) -> Iterator[Result | Lost]:
    """Work off tasks in this process, in order."""
    for task in tasks:
        for message in work(task, external):
            if not isinstance(message, Began):
                yield message


class Pool:
    """Worker processes, started fresh, each with one thread; one that dies or hangs costs the job it was at, and is
    replaced. Use as a context: leaving it ends them."""

    def __init__(self, jobs: int, limits: Limits) -> None:
        self.jobs, self.limits = jobs, limits
        self._workers: list[_Worker] = []
        self._failed_starts = 0

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            if not worker.reason:  # one that is lost has ended
                worker.end()
        self._workers.clear()

    def run(self, tasks: Iterable[Task]) -> Iterator[Result | Lost]:
        """Yield the results as they come, in any order, and what was lost. Raises InputError if no worker starts."""
        queue = deque(tasks)
        while queue or any(worker.task for worker in self._workers):
            wanted = len(queue) + sum(worker.task is not None for worker in self._workers)
            while len(self._workers) < min(self.jobs, wanted):
                self._workers.append(_Worker(self.limits))
            for worker in self._workers:
                if worker.idle and queue:
                    worker.give(queue.popleft())
            wait([worker.fileno() for worker in self._workers if not worker.idle], POLL_S)
            for worker in self._workers:
                for answer in worker.answers():
                    if isinstance(answer, Task):
                        queue.appendleft(answer)
                    else:
                        yield answer
            self._replace_the_lost()

    def _replace_the_lost(self) -> None:
        for worker in [w for w in self._workers if w.reason]:
            self._workers.remove(worker)
            self._failed_starts = 0 if worker.began else self._failed_starts + 1
            if self._failed_starts > self.jobs + 1:
                last = worker.printed().strip().rpartition("\n")[2] or worker.reason
                raise InputError(f"worker processes do not start: {last}; --executor serial works without them")


@dataclass(frozen=True)
class Ready:
    """A worker has started, or has done its task."""


def main() -> None:
    """Serve as a worker: the limits come first, then one task after the other."""
    requests, reply = connect()

    def send(message: Ready | Began | Result | Lost) -> None:
        reply(pickle.dumps(message))

    try:
        with ExternalProcesses(pickle.load(requests), one_thread=True) as external:
            send(Ready())
            while True:
                for message in work(pickle.load(requests), external):
                    send(message)
                send(Ready())
    except (EOFError, BrokenPipeError):
        # The parent is gone, or needs this worker no more.
        return


class _Worker(ChildProcess):
    """The pool's end of one worker process.

    `task`: what is left of the task that it has; `at`: what of it has begun last; `began`: whether it ever began one:
    a worker that dies before has not really started; `reason`: why the process is lost.
    """

    def __init__(self, limits: Limits) -> None:
        self._output: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (closed by end())
        super().__init__(__name__, limits, True, self._output, "its worker process")
        self.send(limits)
        self.task: Task | None = None
        self.at: Began | None = None
        self.started, self.began, self.reason, self._printed = False, False, "", ""
        self._deadline = time.monotonic() + START_LIMIT_S

    @property
    def idle(self) -> bool:
        """Whether it waits for a task."""
        return self.started and self.task is None

    def give(self, task: Task) -> None:
        """Send a task."""
        self.task, self.at = task, None
        self._deadline = time.monotonic() + WORLD_LIMIT_S
        self.send(task)

    def answers(self) -> Iterator[Result | Lost | Task]:
        """Yield the results that have arrived; where the process is lost, the job it was at, and the rest as a task."""
        try:
            while (message := self.reply(deadline=0.0)) is not None:
                yield from self._result(pickle.loads(message))
        except LostError as error:
            yield from self._lost(str(error))
            return
        if not self.idle and time.monotonic() > self._deadline:
            job = self.at is not None and self.at.key is not None
            what = f"time limit of {self.limits.seconds:g} s" if job else f"{WORLD_LIMIT_S:g} s that a world may take"
            yield from self._lost(f"no answer within the {what}")

    def end(self) -> None:
        """End the process at once."""
        super().end()
        self._printed = self.printed()
        self._output.close()

    def printed(self) -> str:
        """Return the last that the process printed."""
        if self._output.closed:
            return self._printed
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - PRINTED_LAST))
        return self._output.read().decode("utf-8", "replace")

    def _result(self, message: Ready | Began | Result | Lost) -> Iterator[Result | Lost]:
        """Note where the worker is, and until when it may be there; yield its message if that is a result."""
        self._deadline = time.monotonic() + WORLD_LIMIT_S
        if isinstance(message, Ready):
            self.started, self.task, self.at = True, None, None
        elif isinstance(message, Began):
            self.at, self.began = message, True
            if message.key is not None:
                # A process apart has the limit of time itself, once it has started.
                self._deadline = time.monotonic() + self.limits.seconds + (START_LIMIT_S if message.apart else 0.0)
        else:
            assert self.task is not None
            self.task = self.task.without(message.key)
            yield replace(message, details=self.printed()) if isinstance(message, Lost) else message

    def _lost(self, reason: str) -> Iterator[Lost | Task]:
        task, self.task, self.reason = self.task, None, reason
        self.end()
        if task is None:
            return
        # Without a job it was the world that killed the worker: it would do so for all of them. A worker that died
        # before it began is not the task's fault.
        guilty = [job for job in task.jobs if self.at is not None and self.at.key in (None, job.key)]
        for job in guilty:
            yield Lost(task, job, reason, self.printed())
            task = task.without(job.key)
        if task.jobs:
            yield task


def _on_cluster(client: Any, limits: Limits, tasks: Iterable[Task]) -> Iterator[Result | Lost]:
    """Work off tasks on a Dask cluster, each of whose threads keeps a worker process of its own, as the pool's. A Dask
    worker that is lost costs what its tasks had not yet sent."""
    waiting = iter(tasks)
    futures: dict[Any, Task] = {}
    done = import_module("distributed").as_completed()

    def submit() -> None:
        for task in waiting:
            future = client.submit(work_apart, task, limits, pure=False)
            futures[future] = task
            done.add(future)
            if len(futures) >= TASKS_AHEAD * max(1, sum(client.nthreads().values())):
                return

    submit()
    while futures:
        future = next(done)
        yield from _answers(future, futures.pop(future))
        submit()


def work_apart(task: Task, limits: Limits) -> list[Result | Lost]:
    """Do a task in a worker process that belongs to the calling thread; it is kept for the next task."""
    pool: Pool | None = getattr(_of_thread, "pool", None)
    if pool is None or pool.limits != limits:
        if pool is not None:
            pool.__exit__()
        pool = _of_thread.pool = Pool(1, limits)
    return list(pool.run([task]))


def _answers(future: Any, task: Task) -> Iterator[Result | Lost]:
    error = future.exception()
    if error is None:
        yield from future.result()
    elif isinstance(error, InputError):
        raise error
    else:
        reason = f"its Dask worker was lost ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
        yield from (Lost(task, job, reason) for job in task.jobs)


@contextmanager
def _cluster(jobs: int, scheduler: str | None) -> Iterator[Any]:
    """Give a client of the scheduler at an address, or of a cluster on this machine."""
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise InputError("--executor dask needs the package distributed: pip install 'cellslam[cluster]'") from error
    if scheduler is None:
        local = {"n_workers": jobs, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
        with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
            yield client
        return
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
    with client:
        yield client
