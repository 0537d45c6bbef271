"""Where tasks are worked off: in this process, in a pool of processes, or on a Dask cluster. All give the same rows."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from importlib import import_module
from typing import Any, Protocol

from cellslam.benchmarks.sweeps.tasks import Began, Lost, Result, Task, work
from cellslam.benchmarks.sweeps.worker_pool import Pool
from cellslam.benchmarks.trials.child_process import Limits
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.sim.errors import InputError

NAMES = ("serial", "processes", "dask")
CONNECT_S = 20
TASKS_AHEAD = 4

_of_thread = threading.local()


class Executor(Protocol):
    """Works off tasks: results in any order, and what was lost with its worker."""

    def run(self, tasks: Iterable[Task]) -> Iterator[Result | Lost]:
        """Yield results and losses as they come."""
        ...


def executor(name: str, jobs: int, limits: Limits, scheduler: str | None = None) -> AbstractContextManager[Executor]:
    """Return the executor of that name as a context; `scheduler` is the address of a running Dask scheduler."""
    if name == "serial":
        return Serial(limits)
    return Pool(jobs, limits) if name == "processes" else _dask(jobs, limits, scheduler)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Serial:
    """This process, one thread; external estimators in processes of their own. Use as a context."""

    def __init__(self, limits: Limits) -> None:
        self.external, self._open = ExternalProcesses(limits, one_thread=True), ExitStack()

    def __enter__(self) -> Serial:
        import numba
        from threadpoolctl import threadpool_limits

        self._open.callback(numba.set_num_threads, numba.get_num_threads())
        numba.set_num_threads(1)
        self._open.enter_context(threadpool_limits(1))
        self._open.enter_context(self.external)
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def run(self, tasks: Iterable[Task]) -> Iterator[Result | Lost]:
        """Yield the results in order."""
        for task in tasks:
            for message in work(task, self.external):
                if not isinstance(message, Began):
                    yield message


class Dask:
    """A Dask cluster. Each of its threads keeps a worker process of its own, with the limits of the pool."""

    def __init__(self, distributed: Any, client: Any, limits: Limits) -> None:
        self._distributed, self.client, self.limits = distributed, client, limits

    def run(self, tasks: Iterable[Task]) -> Iterator[Result | Lost]:
        """Yield the results as they come. A Dask worker that is lost costs what its tasks had not yet sent."""
        waiting = iter(tasks)
        futures: dict[Any, Task] = {}
        done = self._distributed.as_completed()

        def submit() -> None:
            for task in waiting:
                future = self.client.submit(work_apart, task, self.limits, pure=False)
                futures[future] = task
                done.add(future)
                if len(futures) >= TASKS_AHEAD * max(1, sum(self.client.nthreads().values())):
                    return

        submit()
        while futures:
            future = next(done)
            task = futures.pop(future)
            yield from _answers(future, task)
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
def _dask(jobs: int, limits: Limits, scheduler: str | None) -> Iterator[Executor]:
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise InputError("--executor dask needs the package distributed: pip install 'cellslam[cluster]'") from error
    if scheduler is None:
        local = {"n_workers": jobs, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
        with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
            yield Dask(distributed, client, limits)
        return
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
    with client:
        yield Dask(distributed, client, limits)
