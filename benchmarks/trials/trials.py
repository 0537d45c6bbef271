"""Trials: one world for all estimators, each driven over it and scored.

What fails what, in `run`, `replay`, `sweep` and the suites alike (`score_trial`): a world that cannot be made, whatever
the error, fails every row of its trial, which say so; a bound that cannot be computed leaves nulls and a note; an
estimator's error is its own row's alone. In one place the request itself is blamed: where `run` cannot make the world
of its first trial as the scenario asks for what cannot be (InputError), it ends with that line and no rows.

cellslam's own estimators run in this process; external ones never do (`external_processes`), but for one that was
defined in `__main__`, as in a notebook, since no other process has it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.scores import metrics
from cellslam.benchmarks.scores.alignment import aligned
from cellslam.benchmarks.scores.statistics import plain
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.earlier_drives import Before
from cellslam.benchmarks.trials.estimation import estimate
from cellslam.benchmarks.trials.failures import ExternalError, LostError, details, explained
from cellslam.scenarios.estimator_options import Request
from cellslam.scenarios.scenario import MapConfig, Scenario
from cellslam.scenarios.simulation import simulate
from cellslam.sim.described import Described
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import OdometryModel, Recording

if TYPE_CHECKING:
    from cellslam.benchmarks.bound.cramer_rao import BoundResult
    from cellslam.benchmarks.trials.external_processes import ExternalProcesses

Row = dict[str, Any]
NOTHING = Before(MapConfig())
DEFAULT_ESTIMATORS = ("fastslam", "ekf-slam", "dead-reckoning")
ALIGNED = "horizontal, least squares over the whole drive"


@dataclass(frozen=True, repr=False)
class Outcome(Described):
    """One estimator's trial: its row, and its result, or the error that there was in place of one."""

    row: Row
    result: TrialResult | None
    error: BaseException | None = None

    @property
    def traceback(self) -> str:
        """The traceback of the error, and nothing where there was none."""
        return "" if self.error is None else details(self.error)

    @property
    def lost(self) -> bool:
        """Whether the estimator's process died or was killed, which need not be its own fault."""
        return isinstance(self.error, LostError)


@dataclass(frozen=True, repr=False)
class Drive(Described):
    """What the estimators of a trial meet; without a recording, the `problem` that there was.

    Seed and trial give their random draws; `before`: the map that they begin with. `unbound`: why a recording with
    truth has no bound.
    """

    scenario: str
    trial: int
    seed: int
    recording: Recording | None = None
    bound: BoundResult | None = None
    unbound: str = ""
    problem: Exception | None = None
    before: Before = NOTHING


@dataclass(frozen=True, repr=False)
class Trial(Described):
    """One trial of all estimators."""

    number: int
    drive: Drive
    outcomes: tuple[Outcome, ...]


def check_counts(trials: int, seed: int) -> None:
    """Raise InputError unless there is at least one trial and the seed is not negative."""
    if trials < 1:
        raise InputError(f"trials = {trials}: must be at least 1")
    if seed < 0:
        raise InputError(f"seed = {seed}: must be 0 or more")


def simulated_trials(
    scenario: Scenario,
    requests: Sequence[Request],
    trials: int,
    seed: int,
    external: ExternalProcesses,
    progress: Progress = silent,
) -> Iterator[Trial]:
    """Yield trials 0 to `trials` - 1 of root seed `seed`, one after the other.

    Raises InputError when the world of the first trial cannot be made as the scenario asks.
    """
    for number in range(trials):
        make = partial(simulate, scenario, seed, number, progress=progress)
        before = Before(scenario.map, scenario, seed, number)
        drive, outcomes = score_trial(make, scenario.name, requests, number, seed, external, progress, before=before)
        if number == 0 and isinstance(drive.problem, InputError):
            raise drive.problem
        yield Trial(number, drive, tuple(outcomes))


def score_trial(
    make: Callable[[], Recording],
    scenario: str,
    requests: Sequence[Request],
    trial: int,
    seed: int,
    external: ExternalProcesses | None = None,
    progress: Progress = silent,
    align: bool = False,
    sheet: OdometryModel | None = None,
    bounded: bool = True,
    before: Before = NOTHING,
) -> tuple[Drive, Iterator[Outcome]]:
    """Return a trial's drive, and the outcome of each request as it is asked for; seed and trial give their streams.

    `make` returns the recording. `external` are the processes of external estimators, needed where one is asked
    for. `align`: each estimate is first laid onto the truth, and its row says so; there is no bound then,
    nor where the trial is not `bounded`.
    `sheet`: what estimators assume of the odometry's errors; the bound keeps to what the recording says.
    `before`: the map that they begin with.
    """
    drive = _made(Drive(scenario, trial, seed, before=before), make, progress, bounded and not align)
    if sheet is not None and drive.recording is not None:
        drive = replace(drive, recording=replace(drive.recording, odometry_model=sheet))
    return drive, (outcome_of(drive, request, external, progress, align) for request in requests)


def score_recording(
    recording: Recording, scenario: str, requests: Sequence[Request], trial: int, seed: int, **more: Any
) -> Trial:
    """Return the trial of all requests on a recording; arguments as of `score_trial`."""
    drive, outcomes = score_trial(lambda: recording, scenario, requests, trial, seed, **more)
    return Trial(trial, drive, tuple(outcomes))


def failed_row(scenario: str, estimator: str, trial: int, seed: int, error: str) -> Row:
    """Return the row of a trial that gave nothing."""
    first = {"scenario": scenario, "estimator": estimator, "trial": trial, "seed": seed}
    return {**dict.fromkeys(metrics.ROW_KEYS), **first, "status": "failed", "error": error}


def _made(drive: Drive, make: Callable[[], Recording], progress: Progress, bounded: bool) -> Drive:
    try:
        recording = make()
    except Exception as error:
        return replace(drive, problem=error)
    drive = replace(drive, recording=recording)
    if recording.truth is None or not bounded:
        return drive
    try:
        return replace(drive, bound=drive.before.bound(recording, progress))
    except Exception as error:  # of a recording of another version, the errors are not those of this one
        return replace(drive, unbound=explained(error))


def outcome_of(
    drive: Drive,
    request: Request,
    external: ExternalProcesses | None = None,
    progress: Progress = silent,
    align: bool = False,
) -> Outcome:
    """Return what one estimator makes of a drive; arguments as of `score_trial`."""
    if drive.recording is None:
        assert drive.problem is not None
        text = f"the world cannot be made: {explained(drive.problem)}"
        row = failed_row(drive.scenario, request.name, drive.trial, drive.seed, text)
        return Outcome(row, None, drive.problem)
    recording = drive.recording
    row = failed_row(drive.scenario, request.name, drive.trial, drive.seed, "")
    row |= {"snapshots": len(recording.time_s), "duration_s": metrics.duration_s(recording)}
    row |= {"distance_m": metrics.distance_m(recording)}
    row |= {"alignment": ALIGNED} if align else {}
    try:
        if not request.external:
            driven = estimate
        elif external is not None:
            driven = external.estimate
        else:
            raise ExternalError(f"{request.name} runs in a process of its own, and there is none here")
        rng = stream(drive.seed, drive.trial, Stream.ESTIMATOR)
        result = driven(recording, request, rng, progress, drive.before.known(request))
        result = aligned(recording, result) if align else result
        scores = metrics.score(recording, result, drive.bound)
    except (Exception, SystemExit) as error:
        return Outcome({**row, "error": explained(error)}, None, error)
    cost = {
        "estimate_seconds": result.estimate_seconds,
        "realtime_factor": row["duration_s"] / result.estimate_seconds,
        "peak_memory_mb": result.peak_memory_mb,
    }
    row |= {"status": "ok", "error": None, **scores, **cost}
    return Outcome({key: plain(value) for key, value in row.items()}, result)
