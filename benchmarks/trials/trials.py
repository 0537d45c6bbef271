"""Trials: one world for all estimators, each driven over it and scored; an error costs its own row only."""

from __future__ import annotations

import math
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.trials.estimation import BadAnswerError, estimate, warm_up
from cellslam.benchmarks.trials.trial_result import METRIC_KEYS, ROW_KEYS, TrialResult
from cellslam.scenarios.estimator_options import Request, resolve
from cellslam.scenarios.scenario import Scenario
from cellslam.sim.errors import InputError
from cellslam.sim.progress import Progress, silent
from cellslam.sim.randomness import Stream, stream
from cellslam.sim.recording import Recording
from cellslam.slam.registry import own_traceback

if TYPE_CHECKING:
    import pandas as pd

    from cellslam.benchmarks.bound.cramer_rao import BoundResult

Row = dict[str, Any]
DEFAULT_ESTIMATORS = ("fastslam", "dead-reckoning")
ALIGNED = "horizontal, least squares over the whole drive"


@dataclass(frozen=True)
class Outcome:
    """One estimator's trial: its row, and its result, or the traceback of why there is none."""

    row: Row
    result: TrialResult | None
    traceback: str = ""


@dataclass(frozen=True)
class Trial:
    """One trial of all estimators; recording and bound are None where its world could not be made.

    `unbound`: why a recording with truth has no bound.
    """

    number: int
    recording: Recording | None
    bound: BoundResult | None
    outcomes: tuple[Outcome, ...]
    unbound: str = ""


def run(
    scenario: str | Path | Scenario,
    estimators: Sequence[str] = DEFAULT_ESTIMATORS,
    trials: int = 1,
    seed: int = 0,
    overrides: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> pd.DataFrame:
    """Return the rows of `trials` trials of `estimators` in a scenario, one a trial and estimator.

    `scenario` is a preset's name, a .toml path, or a Scenario (then without overrides); `overrides` are by
    dotted key. A trial that failed is a row with status "failed" and its error. Raises InputError for a wrong
    request.
    """
    import pandas as pd

    from cellslam.scenarios.loading import load

    if not isinstance(scenario, Scenario):
        scenario = load(scenario, overrides)
    elif overrides:
        raise InputError("overrides cannot change a Scenario that is already loaded: give its name or path")
    check_counts(trials, seed)
    requests = resolve(scenario.estimator, estimators, overrides or ())
    done = simulated_trials(scenario, requests, trials, seed, progress)
    frame = pd.DataFrame([o.row for trial in done for o in trial.outcomes], columns=list(ROW_KEYS))
    numbers = [key for key in ROW_KEYS if key in METRIC_KEYS or key.endswith(("_s", "_m", "_seconds", "_factor"))]
    return frame.astype(dict.fromkeys(numbers, "float64"))


def check_counts(trials: int, seed: int) -> None:
    """Raise InputError unless there is at least one trial and the seed is not negative."""
    if trials < 1:
        raise InputError(f"trials = {trials}: must be at least 1")
    if seed < 0:
        raise InputError(f"seed = {seed}: must be 0 or more")


def record(scenario: Scenario, seed: int, trial: int, progress: Progress = silent) -> Recording:
    """Return the recording of one trial; its provenance holds the resolved scenario, root seed and trial."""
    from cellslam.sim.world import simulate

    recording = simulate(scenario.world, seed, trial, progress)
    return replace(recording, provenance={"scenario": scenario.resolved, **recording.provenance})


def simulated_trials(
    scenario: Scenario, requests: Sequence[Request], trials: int, seed: int, progress: Progress = silent
) -> Iterator[Trial]:
    """Yield trials 0 to `trials` - 1 of root seed `seed`, one after the other.

    Raises InputError when the world of the first trial cannot be made; of a later one it fails that trial.
    """
    for number in range(trials):
        try:
            recording = record(scenario, seed, number, progress)
        except InputError as error:
            if number == 0:
                raise
            text = f"the world cannot be made: {error}"
            failed = (Outcome(failed_row(scenario.name, r.name, number, seed, text), None) for r in requests)
            yield Trial(number, None, None, tuple(failed))
            continue
        yield score_recording(recording, scenario.name, requests, number, seed, progress)


def score_recording(
    recording: Recording,
    scenario: str,
    requests: Sequence[Request],
    trial: int,
    seed: int,
    progress: Progress = silent,
    align: bool = False,
) -> Trial:
    """Return the trial of all requested estimators on one recording; seed and trial give their streams.

    `align`: each estimate is first laid onto the truth, and its row says so; there is no bound then.
    """
    from cellslam.benchmarks.bound.cramer_rao import bound

    limit, unbound = None, ""
    if recording.truth is not None and not align:
        try:
            limit = bound(recording, progress)
        except InputError as error:  # a recording of another version, whose errors are not those of this one
            unbound = str(error)
    answers = (outcome_of(recording, scenario, r, trial, seed, limit, progress, align) for r in requests)
    return Trial(trial, recording, limit, tuple(answers), unbound)


def outcome_of(
    recording: Recording,
    scenario: str,
    request: Request,
    trial: int,
    seed: int,
    limit: BoundResult | None,
    progress: Progress = silent,
    align: bool = False,
) -> Outcome:
    """Return what one estimator makes of a recording; `limit` is the recording's bound, `align` as above."""
    row = _row(recording, scenario, request.name, trial, seed)
    outcome = _outcome(recording, row, request, limit, stream(seed, trial, Stream.ESTIMATOR), progress, align)
    return replace(outcome, row={**outcome.row, "alignment": ALIGNED}) if align else outcome


def failed_row(scenario: str, estimator: str, trial: int, seed: int, error: str) -> Row:
    """Return the row of a trial that gave nothing."""
    first = {"scenario": scenario, "estimator": estimator, "trial": trial, "seed": seed}
    return {**dict.fromkeys(ROW_KEYS), **first, "status": "failed", "error": error}


def _outcome(
    recording: Recording,
    row: Row,
    request: Request,
    limit: BoundResult | None,
    rng: Any,
    progress: Progress,
    align: bool = False,
) -> Outcome:
    from cellslam.benchmarks.recordings.alignment import aligned
    from cellslam.benchmarks.scores.metrics import score

    try:
        warm_up(request, progress)
        result = estimate(recording, request, rng, progress)
        result = aligned(recording, result) if align else result
    except (Exception, SystemExit) as error:
        return Outcome({**row, "status": "failed", "error": explained(error)}, None, traceback.format_exc())
    seconds = result.estimate_seconds
    times = {"estimate_seconds": seconds, "realtime_factor": row["duration_s"] / seconds}
    row = {**row, "status": "ok", **score(recording, result, limit), **times}
    return Outcome({key: _plain(row[key]) for key in ROW_KEYS}, result)


def _row(recording: Recording, scenario: str, estimator: str, trial: int, seed: int) -> Row:
    from cellslam.benchmarks.scores.metrics import distance_m, duration_s

    first = {"scenario": scenario, "estimator": estimator, "trial": trial, "seed": seed}
    size = {"snapshots": len(recording.time_s), "duration_s": duration_s(recording)}
    return {**dict.fromkeys(ROW_KEYS), **first, **size, "distance_m": distance_m(recording)}


def explained(error: BaseException) -> str:
    """Return an error as one line: what, in which snapshot, and the estimator's own traceback."""
    text = " ".join(str(error).split())
    if isinstance(error, InputError):
        return text
    line = text if isinstance(error, BadAnswerError) else f"{type(error).__name__}: {text}".removesuffix(": ")
    notes = "".join(f", {note}" for note in getattr(error, "__notes__", ()))
    return line + notes + ("" if isinstance(error, BadAnswerError) else own_traceback(error))


def _plain(value: Any) -> Any:
    """Return a value that JSON holds: numpy scalars as Python's, NaN and infinity as None."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
