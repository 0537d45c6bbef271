"""The store of `cellslam run`: its folder can then be read as a sweep's, by `table`, `figures` and `report`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.sweeps.store import Store, writing
from cellslam.benchmarks.sweeps.tasks import Result, Task, identity, plan
from cellslam.benchmarks.sweeps.trajectories import pack, trajectory
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
        yield lambda trial: _keep(store, trial, tasks[trial.number])


def _keep(store: Store, trial: Trial, task: Task) -> None:
    jobs = {job.estimator: job for job in task.jobs}
    for outcome in trial.outcomes:
        job, packed = jobs[outcome.row["estimator"]], None
        if trial.recording is not None and outcome.result is not None:
            packed = pack(trajectory(trial.recording, outcome.result, trial.bound))
        store.write(
            Result(job.key, outcome.row, outcome.traceback, packed), identity(task.world), identity(job.options)
        )
