"""The work of a sweep: one task is one world and trial, with all the estimators that meet it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.scenarios.estimator_options import Request, broken, external_request, loaded
from cellslam.scenarios.keys import names_file
from cellslam.scenarios.scenario import MapConfig
from cellslam.scenarios.sweep_points import Point
from cellslam.sim.errors import InputError
from cellslam.sim.world import KEPT_SCENES, WorldConfig
from cellslam.slam import registry

if TYPE_CHECKING:
    from cellslam.benchmarks.trials.external_processes import ExternalProcesses
    from cellslam.benchmarks.trials.trials import Drive, Outcome
    from cellslam.scenarios.known_worlds.known_world import Entry, KnownWorld
    from cellslam.scenarios.scenario import Scenario
    from cellslam.sim.recording import Recording

KEY_LENGTH = 32
KNOWN = "known_world"  # key of a world that is one of others
Wanted = dict[str, dict[tuple[str, str, str], bool]]  # by world: name, target and options of an estimator; an oracle?


@dataclass(frozen=True)
class Job:
    """One estimator in one trial: its name, what it is loaded by, and the JSON of its full options, "null" where it has
    none."""

    key: str
    estimator: str
    target: str
    options: str
    oracle: bool = False


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
    """A worker turns to a job; `key` None: it makes the world. `apart`: the job runs in a process that must start."""

    key: str | None
    apart: bool = False


@dataclass(frozen=True)
class Result:
    """What a job gave: its row, the traceback if it failed, its compressed trajectory (None: none), and whether its
    estimator was shown the truth."""

    key: str
    row: Mapping[str, Any]
    traceback: str = ""
    trajectory: bytes | None = None
    oracle: bool = False


@dataclass(frozen=True)
class Lost:
    """A job whose worker died, or was killed since it gave no answer in time; `details` is what it printed last."""

    task: Task
    job: Job
    reason: str
    details: str = ""

    @property
    def key(self) -> str:
        """The key of the job."""
        return self.job.key


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


def plan(points: Sequence[Point], trials: int | Sequence[int], seed: int, trajectories: bool = True) -> Plan:
    """Return the tasks of all points: trial by trial, or point by point if the points have many cities.

    `trials`: of each point, or one number for all.
    Points that differ in estimators' options alone share a world, which is then made once a trial; a job that
    several points share is done once.
    """
    jobs: Wanted = {}
    cities, counts = set(), dict[str, int]()
    each = [trials] * len(points) if isinstance(trials, int) else trials
    for point, count in zip(points, each, strict=True):
        world = world_json(point.scenario)
        counts[world] = max(count, counts.get(world, 0))
        cities.add(point.scenario.city.model_dump_json())
        wanted = {(one.name, one.target, options_json(one)): one.oracle for one in point.requests}
        jobs.setdefault(world, {}).update(wanted)
    return _planned(jobs, counts, seed, trajectories, trial_by_trial=len(cities) <= KEPT_SCENES)


def plan_known(world: KnownWorld, trials: int, seed: int, trajectories: bool = True) -> Plan:
    """Return the tasks of a known world of others: all its entries, those of its ladder too, in every trial."""
    jobs: Wanted = {}
    for entry in (*world.entries, *world.ladder):
        text, name, options = asked_by(world, entry)
        oracle = loaded(name, {name: entry.options}).oracle
        jobs.setdefault(text, {})[name, name, options] = oracle
    return _planned(jobs, dict.fromkeys(jobs, trials), seed, trajectories, trial_by_trial=True)


def asked_by(world: KnownWorld, entry: Entry) -> tuple[str, str, str]:
    """Return what an entry of a known world asks for: the world as JSON, the estimator, its options as JSON."""
    text = canonical({"name": world.name, KNOWN: world.name})
    return text, entry.estimator, options_json(loaded(entry.estimator, {entry.estimator: entry.options}))


def _planned(jobs: Wanted, trials: Mapping[str, int], seed: int, trajectories: bool, trial_by_trial: bool) -> Plan:
    order = [(world, trial) for world in jobs for trial in range(trials[world])]
    if trial_by_trial:
        order.sort(key=lambda task: task[1])
    options_used = {options for estimators in jobs.values() for _, _, options in estimators}
    whole = {text: with_contents(text) for text in (*jobs, *options_used)}

    def jobs_of(world: str, trial: int) -> tuple[Job, ...]:
        at = str(seed), str(trial)
        return tuple(
            Job(identity(whole[world], target, whole[options], *at), name, target, options, oracle)
            for (name, target, options), oracle in jobs[world].items()
        )

    tasks = tuple(Task(world, trial, seed, jobs_of(world, trial), trajectories) for world, trial in order)
    return Plan(tasks, {identity(w): w for w in jobs}, {identity(o): o for o in options_used})


def world_json(scenario: Scenario) -> str:
    """Return name, world and, if there is one, the map of a scenario as canonical JSON: what decides what estimators
    meet, with seed and trial."""
    resolved = scenario.resolved
    before = () if scenario.map == MapConfig() else ("map",)
    return canonical({key: resolved[key] for key in ("name", *WorldConfig.model_fields, *before)})


def options_json(request: Request) -> str:
    """Return all options of a request as canonical JSON."""
    return canonical(None if request.options is None else request.options.model_dump(mode="json"))


def identity(*texts: str) -> str:
    """Return a hash of texts, for keys."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:KEY_LENGTH]


def canonical(value: Any) -> str:
    """Return JSON that is the same for equal values."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def work(task: Task, external: ExternalProcesses) -> Iterator[Began | Result | Lost]:
    """Do a task: yield when each job begins, and what it gave. `external`: processes of external estimators."""
    from cellslam.benchmarks.trials.earlier_drives import Before
    from cellslam.benchmarks.trials.trials import NOTHING, score_trial

    yield Began(None)
    requests = [request_of(job) for job in task.jobs]
    name, simulated, before = name_of(task.world), not is_known(task.world), NOTHING
    if simulated:
        scenario = scenario_of(task.world)
        before = Before(scenario.map, scenario, task.seed, task.trial)
    make = partial(recording_of, task)
    drive, outcomes = score_trial(
        make, name, requests, task.trial, task.seed, external, bounded=simulated, before=before
    )
    for job, request in zip(task.jobs, requests, strict=True):
        yield Began(job.key, request.external)
        outcome = next(outcomes)
        if outcome.lost:
            yield Lost(task, job, outcome.row["error"])
        else:
            yield result_of(task, job, drive, outcome)


def result_of(task: Task, job: Job, drive: Drive, outcome: Outcome) -> Result:
    """Return what is stored of a job's outcome: its trajectory too, and a note where there is no bound."""
    from cellslam.benchmarks.sweeps.trajectories import pack, trajectory

    packed = None
    if task.trajectories and drive.recording is not None and outcome.result is not None:
        packed = pack(trajectory(drive.recording, outcome.result, drive.bound))
    note = f"without the bound: {drive.unbound}" if drive.unbound else ""
    return Result(job.key, outcome.row, outcome.traceback or note, packed, job.oracle)


def with_contents(text: str) -> str:
    """Return JSON with a digest of each file that it names, of a city, map or calibration: another content is another
    job. One that cannot be read has none; the job says why."""
    parts = [text]
    for name in _named_files(json.loads(text)):
        if Path(name).is_file():  # no device, which may have no end
            with suppress(OSError):
                parts.append(hashlib.sha256(Path(name).read_bytes()).hexdigest())
    return "\0".join(parts)


def _named_files(value: Any) -> Iterator[str]:
    for key, inner in value.items() if isinstance(value, dict) else ():
        if isinstance(inner, str) and names_file(key):
            yield inner
        yield from _named_files(inner)


def recording_of(task: Task) -> Recording:
    """Return the recording of a task's world and trial. Raises InputError where it cannot be made."""
    from cellslam.scenarios.known_worlds import known_world
    from cellslam.scenarios.simulation import simulate

    if is_known(task.world):
        return known_world(json.loads(task.world)[KNOWN]).simulate(task.seed, task.trial)
    return simulate(scenario_of(task.world), task.seed, task.trial)


def is_known(world: str) -> bool:
    """Return whether a world as JSON is a known one of others, not a scenario."""
    return KNOWN in json.loads(world)


def name_of(world: str) -> str:
    """Return the name of a world as JSON."""
    return str(json.loads(world)["name"])


@lru_cache(maxsize=16)
def scenario_of(world: str) -> Scenario:
    """Return the scenario of a world as JSON."""
    from cellslam.scenarios.loading import from_tables

    return from_tables(json.loads(world))


def request_of(job: Job) -> Request:
    """Return the request of a job; other people's estimator is not loaded, and believed to be an oracle or none."""
    return _request_of(job.estimator, job.target, job.options, job.oracle)


@lru_cache(maxsize=64)
def _request_of(name: str, target: str, options: str, oracle: bool) -> Request:
    table = json.loads(options)
    if registry.module_of(target) is not None:
        return external_request(name, table, oracle, "" if name == target else target)
    try:
        return loaded(target, {target: table or {}})
    except InputError as error:
        return Request(name, broken(error), None)
