"""Carrying out a sweep: what is not stored yet is worked off, and each result is stored as it comes.

plan        a task for each world and trial, with a job for each estimator that meets it     `tasks.plan`
            its key is a hash of world, estimator, options, seed and trial: a key that is
            stored is not done again                                                         `pending`
distribute  a worker process a core, each with one thread; an idle one is given the next      `executors.Pool`
            task, so that a long task delays no other; machines that see nothing of each
            other but a folder take a share of the tasks each                                `shards`
work        a worker makes the world from its seed, and runs one estimator after the other   `tasks.work`
store       each row comes back as it is ready, and only the parent process writes           `carry_out`, `store`
lose        a worker that dies or hangs costs the job it was at; the rest of its task goes   `executors._Worker`
            back into the queue, and the job is tried once more, alone                       `carry_out`
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.sweeps import tasks
from cellslam.benchmarks.sweeps.executors import Executor
from cellslam.benchmarks.sweeps.store import Note, Store, databases, lost_trajectories, reading, statuses, writing
from cellslam.benchmarks.sweeps.tasks import Began, Job, Lost, Plan, Result, Task, identity
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.scenarios.sweep_points import Point
from cellslam.sim.world import versions

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.trials import Trial
    from cellslam.scenarios.estimator_options import Request
    from cellslam.scenarios.scenario import Scenario

OnResult = Callable[[Task, Job, Mapping[str, Any]], None]
SAMPLES_PER_ESTIMATOR = 4


def carry_out(plan: Plan, store: Store, executor: Executor, on_result: OnResult) -> None:
    """Work off a plan; `on_result` is called with task, job and row of each result, once it is stored.

    A job that was lost with its worker is tried once more, alone; lost again, it is a failed row.
    """
    owners = {job.key: (task, job) for task in plan.tasks for job in task.jobs}
    store.declare(plan)

    def keep(result: Result) -> None:
        task, job = owners[result.key]
        store.write(result, identity(task.world), identity(job.options))
        on_result(task, job, result.row)

    lost: list[Lost] = []
    for answer in executor(plan.tasks):
        if isinstance(answer, Lost):
            lost.append(answer)
        else:
            keep(answer)
    for first in lost:
        for answer in executor([first.task.only(first.job)]):
            keep(_given_up(first, answer) if isinstance(answer, Lost) else answer)


def pending(plan: Plan, folder: Path, retry_failed: bool) -> Plan:
    """Return what of a plan is to be done: what `folder` has not, what has lost its trajectory, and what failed if
    `retry_failed`. Raises InputError where the folder cannot be read."""
    if not databases(folder):
        return plan
    kept = {job.key for task in plan.tasks for job in task.jobs if task.trajectories}
    with reading(folder) as database:
        lost = lost_trajectories(folder, database, kept) if kept else ()
    status = statuses(folder).items()
    return plan.without({key: s for key, s in status if key not in lost and (s == "ok" or not retry_failed)})


@contextmanager
def keeping(
    folder: Path, scenario: Scenario, requests: Sequence[Request], trials: int, seed: int, command: str, note: Note
) -> Iterator[Callable[[Trial], None]]:
    """Open the store of `cellslam run`, which `table`, `figures` and `report` then read as a sweep's, and yield what
    keeps a trial in it; what earlier runs left there stays. `note` gets a line where it waits.

    Raises InputError where there can be no store, as on a network disk.
    """
    plan = tasks.plan([Point({}, scenario, tuple(requests))], trials, seed)
    with writing(folder, command, versions(), note) as store:
        store.declare(plan)
        of_trial = {task.trial: task for task in plan.tasks}

        def keep(trial: Trial) -> None:
            task = of_trial[trial.number]
            jobs = {job.estimator: job for job in task.jobs}
            for outcome in trial.outcomes:
                job = jobs[outcome.row["estimator"]]
                result = tasks.result_of(task, job, trial.drive, outcome)
                store.write(result, identity(task.world), identity(job.options))

        yield keep


def seconds_of(plan: Plan, external: ExternalProcesses) -> tuple[float, Mapping[str, float]]:
    """Return the seconds that one core needs for a plan, and those of one trial by part ("world", estimators).

    One trial of the first world is timed, with a few different options of each estimator, after everything is
    compiled. Raises InputError when that world cannot be made.
    """
    if not plan.tasks:
        return 0.0, {}
    first = max(plan.tasks[: len(plan.worlds)], key=lambda task: len(task.jobs))
    jobs: dict[str, list[Job]] = {}
    for job in first.jobs:
        jobs.setdefault(job.estimator, []).append(job)
    few = (own[:: -(-len(own) // SAMPLES_PER_ESTIMATOR)] for own in jobs.values())
    sample = replace(first, jobs=tuple(job for own in few for job in own))
    _compile(sample, external)
    spent: dict[str, list[float]] = {}
    names = {job.key: job.estimator for job in sample.jobs}
    begin, part = time.perf_counter(), "world"
    for message in tasks.work(sample, external):
        now = time.perf_counter()
        if isinstance(message, Began) and message.key is not None:
            if part == "world":
                spent.setdefault(part, []).append(now - begin)
            begin, part = now, names[message.key]
        elif not isinstance(message, Began):
            spent.setdefault(part, []).append(now - begin)
    mean = {name: sum(values) / len(values) for name, values in spent.items()}
    total = len(plan.tasks) * mean["world"]
    return total + sum(mean.get(job.estimator, 0.0) for task in plan.tasks for job in task.jobs), mean


def _given_up(first: Lost, second: Lost) -> Result:
    from cellslam.benchmarks.trials.trials import failed_row

    again = "alone it was lost again" if second.reason == first.reason else f"alone: {second.reason}"
    task, job = first.task, first.job
    row = failed_row(tasks.name_of(task.world), job.estimator, task.trial, task.seed, f"{first.reason}; {again}")
    return Result(job.key, row, second.details or first.details, oracle=job.oracle)


def _compile(task: Task, external: ExternalProcesses) -> None:
    from cellslam.benchmarks.bound.cramer_rao import bound
    from cellslam.benchmarks.trials.estimation import warm_up

    recording = tasks.recording_of(task)
    if not tasks.is_known(task.world):
        bound(recording)
    for job in task.jobs:
        try:
            request = tasks.request_of(job)
            (external.warm_up if request.external else warm_up)(request)
        except Exception:
            # The trial itself will say so in its row.
            continue
