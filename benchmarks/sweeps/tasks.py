"""The work of a sweep: one task is one world and trial, with all the estimators that meet it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cellslam.scenarios.sweep_points import Point
from cellslam.sim.world import KEPT_SCENES, WorldConfig

if TYPE_CHECKING:
    from cellslam.benchmarks.bound.cramer_rao import BoundResult
    from cellslam.benchmarks.trials.trials import Outcome
    from cellslam.scenarios.estimator_options import Request
    from cellslam.scenarios.scenario import Scenario
    from cellslam.sim.recording import Recording

KEY_LENGTH = 32


@dataclass(frozen=True)
class Job:
    """One estimator in one trial. `options` is the JSON of its full options, "null" where it has none."""

    key: str
    estimator: str
    options: str


@dataclass(frozen=True)
class Task:
    """One world and trial. `world` is the JSON of the scenario without the estimators' tables."""

    world: str
    trial: int
    seed: int
    jobs: tuple[Job, ...]
    trajectories: bool = True

    def only(self, job: Job) -> Task:
        """Return the task with one of its jobs alone."""
        return replace(self, jobs=(job,))

    def without(self, key: str) -> Task:
        """Return the task less the job of that key."""
        return replace(self, jobs=tuple(job for job in self.jobs if job.key != key))


@dataclass(frozen=True)
class Began:
    """A worker turns to a job; `key` None: it makes the world."""

    key: str | None


@dataclass(frozen=True)
class Result:
    """What a job gave: its row, the traceback if it failed, and its compressed trajectory (None: none)."""

    key: str
    row: Mapping[str, Any]
    traceback: str = ""
    trajectory: bytes | None = None


@dataclass(frozen=True)
class Lost:
    """A job whose worker died, or was killed since it gave no answer in time; `details` is what it printed last."""

    task: Task
    job: Job
    reason: str
    details: str = ""


@dataclass(frozen=True)
class Plan:
    """All tasks of a sweep, and each distinct world and options by id, as JSON."""

    tasks: tuple[Task, ...]
    worlds: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return sum(len(task.jobs) for task in self.tasks)

    def without(self, keys: Mapping[str, Any]) -> Plan:
        """Return the plan less the jobs in `keys`; a task without jobs is left out."""
        rest = (replace(t, jobs=tuple(j for j in t.jobs if j.key not in keys)) for t in self.tasks)
        return replace(self, tasks=tuple(t for t in rest if t.jobs))


def plan(points: Sequence[Point], trials: int, seed: int, trajectories: bool = True) -> Plan:
    """Return the tasks of all points: trial by trial, or point by point if the points have many cities.

    Points that differ in estimators' options alone share a world, which is then made once a trial; a job that
    several points share is done once.
    """
    jobs: dict[str, dict[tuple[str, str], None]] = {}
    cities = set()
    for point in points:
        world = world_json(point.scenario)
        cities.add(point.scenario.city.model_dump_json())
        asked = ((request.name, options_json(request)) for request in point.requests)
        jobs.setdefault(world, {}).update(dict.fromkeys(asked))
    order = (
        ((world, trial) for trial in range(trials) for world in jobs)
        if len(cities) <= KEPT_SCENES
        else ((world, trial) for world in jobs for trial in range(trials))
    )
    tasks = tuple(
        Task(world, trial, seed, tuple(_jobs(world, jobs[world], trial, seed)), trajectories) for world, trial in order
    )
    said = {options for asked in jobs.values() for _, options in asked}
    return Plan(tasks, {identity(w): w for w in jobs}, {identity(o): o for o in said})


def world_json(scenario: Scenario) -> str:
    """Return name and world of a scenario as canonical JSON: what decides a trial's recording, with seed and trial."""
    resolved = scenario.resolved
    return canonical({key: resolved[key] for key in ("name", *WorldConfig.model_fields)})


def options_json(request: Request) -> str:
    """Return all options of a request as canonical JSON."""
    return canonical(None if request.options is None else request.options.model_dump(mode="json"))


def identity(*texts: str) -> str:
    """Return a hash of texts, for keys."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:KEY_LENGTH]


def canonical(value: Any) -> str:
    """Return JSON that is the same for equal values."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def work(task: Task) -> Iterator[Began | Result]:
    """Do a task in this process: yield when each job begins, and its result. Whatever goes wrong is a failed row."""
    from cellslam.benchmarks.bound.cramer_rao import bound
    from cellslam.benchmarks.trials.trials import explained, failed_row, record

    yield Began(None)
    scenario = scenario_of(task.world)
    try:
        recording = record(scenario, task.seed, task.trial)
        limit = bound(recording)
    except Exception as error:
        text = f"the world cannot be made: {error if _expected(error) else explained(error)}"
        for job in task.jobs:
            yield Result(job.key, failed_row(scenario.name, job.estimator, task.trial, task.seed, text))
        return
    for job in task.jobs:
        yield Began(job.key)
        yield _result(task, job, scenario.name, recording, limit)


def _result(task: Task, job: Job, scenario: str, recording: Recording, limit: BoundResult) -> Result:
    import traceback

    from cellslam.benchmarks.sweeps.trajectories import pack
    from cellslam.benchmarks.trials.trials import explained, failed_row, outcome_of

    try:
        request = request_of(job.estimator, job.options)
        outcome = outcome_of(recording, scenario, request, task.trial, task.seed, limit)
        packed = pack(recording, outcome.result, limit) if task.trajectories and outcome.result is not None else None
    except (Exception, SystemExit) as error:
        row = failed_row(scenario, job.estimator, task.trial, task.seed, explained(error))
        return Result(job.key, row, traceback.format_exc())
    return _packed(job, outcome, packed)


def _packed(job: Job, outcome: Outcome, packed: bytes | None) -> Result:
    return Result(job.key, outcome.row, outcome.traceback, packed)


def _jobs(world: str, asked: Mapping[tuple[str, str], None], trial: int, seed: int) -> Iterator[Job]:
    for estimator, options in asked:
        yield Job(identity(world, estimator, options, str(seed), str(trial)), estimator, options)


def _expected(error: Exception) -> bool:
    from cellslam.sim.errors import InputError

    return isinstance(error, InputError)


@lru_cache(maxsize=16)
def scenario_of(world: str) -> Scenario:
    """Return the scenario of a world as JSON."""
    from cellslam.scenarios.loading import from_tables

    return from_tables(json.loads(world))


@lru_cache(maxsize=64)
def request_of(estimator: str, options: str) -> Request:
    """Return the request of an estimator with options as JSON."""
    from cellslam.scenarios.estimator_options import resolve

    return resolve({estimator: json.loads(options) or {}}, [estimator])[0]
