"""The store of `cellslam run`: its folder can then be read as a sweep's, by `table`, `figures` and `report`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.sweeps.store import writing
from cellslam.benchmarks.sweeps.tasks import identity, plan, result_of
from cellslam.scenarios.sweep_points import Point
from cellslam.sim.world import versions

if TYPE_CHECKING:
    from collections.abc import Callable

    from cellslam.benchmarks.trials.trials import Trial
    from cellslam.scenarios.estimator_options import Request
    from cellslam.scenarios.scenario import Scenario


@contextmanager
def keeping(
    folder: Path, scenario: Scenario, requests: Sequence[Request], trials: int, seed: int, command: str
) -> Iterator[Callable[[Trial], None]]:
    """Open the store of a run and yield what keeps a trial in it; what earlier runs left there stays.

    Raises InputError where there can be no store, as on a network disk.
    """
    work = plan([Point({}, scenario, tuple(requests))], trials, seed)
    with writing(folder, command, versions()) as store:
        store.declare(work)
        tasks = {task.trial: task for task in work.tasks}

        def keep(trial: Trial) -> None:
            task = tasks[trial.number]
            jobs = {job.estimator: job for job in task.jobs}
            for outcome in trial.outcomes:
                job = jobs[outcome.row["estimator"]]
                store.write(result_of(task, job, trial, outcome), identity(task.world), identity(job.options))

        yield keep
