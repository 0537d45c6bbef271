"""`run`, `trial`, `replay` and `sweep` for Python: as the commands, with tables and arrays instead of files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from cellslam.benchmarks.scores.metrics import METRIC_KEYS, ROW_KEYS
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.benchmarks.trials.failures import ExternalError
from cellslam.benchmarks.trials.trials import (
    DEFAULT_ESTIMATORS,
    Outcome,
    Row,
    Trial,
    check_counts,
    score_recording,
    score_trial,
    simulated_trials,
)
from cellslam.progress_bars import shown
from cellslam.recordings.fitting.assumptions import assumed
from cellslam.scenarios import external_options
from cellslam.scenarios.recording_origin import Origin
from cellslam.scenarios.scenario import Scenario
from cellslam.scenarios.simulation import scenario_of, simulate
from cellslam.scenarios.sweep_points import Sweep, points
from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.progress import Progress
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

OnError = Literal["raise", "row"]
Estimators = str | type[Any] | Sequence[str | type[Any]]


def run(
    scenario: str | Path | Scenario,
    estimators: Estimators = DEFAULT_ESTIMATORS,
    trials: int = 1,
    seed: int = 0,
    overrides: Mapping[str, Any] | None = None,
    progress: Progress | bool = True,
    on_error: OnError = "raise",
) -> pd.DataFrame:
    """Return the rows of `trials` trials of `estimators` in a scenario, one a trial and estimator.

    `scenario` is a preset's name, a .toml path, or a Scenario (then without overrides); an estimator is a name,
    "module:Class", or a class; `overrides` are by dotted key. `progress`: on stderr (False: none), or a `Progress` of
    your own. `on_error`: what an estimator raises is raised here ("raise"), or is a row with status "failed" and its
    error ("row"). Raises InputError for a wrong request. Needs no `if __name__ == "__main__"`.
    """
    chosen = scenario_of(scenario, overrides)
    check_counts(trials, seed)
    requests = external_options.requests(chosen.estimator, names_of(estimators), overrides or ())
    with ExternalProcesses() as external, shown(progress) as display:
        return _table(simulated_trials(chosen, requests, trials, seed, external, display), on_error)


def trial(
    scenario: str | Path | Scenario,
    estimators: Estimators = DEFAULT_ESTIMATORS,
    seed: int = 0,
    number: int = 0,
    overrides: Mapping[str, Any] | None = None,
    progress: Progress | bool = True,
    on_error: OnError = "raise",
) -> TrialView:
    """Return one trial with all that it left: rows, figures, the recording with its truth, and the estimates.

    Arguments as of `run`; `number` counts the trials of a root seed from 0. Raises InputError for a wrong request.
    """
    chosen = scenario_of(scenario, overrides)
    check_counts(number + 1, seed)
    requests = external_options.requests(chosen.estimator, names_of(estimators), overrides or ())
    with ExternalProcesses() as external, shown(progress) as display:
        drive, outcomes = score_trial(
            lambda: simulate(chosen, seed, number, progress=display),
            chosen.name, requests, number, seed, external, display,
        )  # fmt: skip
        if drive.problem is not None:
            raise drive.problem
        found = Trial(number, drive, tuple(outcomes))
    return TrialView(chosen, seed, found, _table([found], on_error))


class TrialView:
    """One trial in a notebook: it shows itself as the table of its rows.

    `recording` has the measurements (`recording.measurements.distance_m`, ...), the odometry, and the truth
    (`recording.truth.poses`); `bound` the bound; `estimates` by name of the estimator what each answered: `poses`
    (T, 6) in m and rad, `covariances` (T, 6, 6), `association`, `clock_offset_m` in m, `vts`.
    """

    def __init__(self, scenario: Scenario, seed: int, found: Trial, rows: pd.DataFrame) -> None:
        assert found.drive.recording is not None
        self.scenario, self.seed, self.number, self.rows = scenario, seed, found.number, rows
        self.recording: Recording = found.drive.recording
        self.bound = found.drive.bound
        self.estimates = {o.row["estimator"]: o.result for o in found.outcomes if o.result is not None}

    def plot(self, name: str = "map") -> Figure:
        """Return a figure of the trial: map, error, associations, clock_offsets, or calibration-ESTIMATOR.

        Raises InputError for another name, and for a figure that this trial has not.
        """
        from matplotlib.figure import Figure

        from cellslam.benchmarks.figures.style import context
        from cellslam.benchmarks.figures.trial.trial_figures import drawings
        from cellslam.sim.world import prepare

        city = prepare(self.scenario.world, self.seed, self.number).scene.city
        known = drawings(city, self.recording, self.estimates, self.bound)
        if name not in known:
            raise unknown_name("figure", name, tuple(known))
        with context():
            figure = Figure(layout="constrained")
            if not known[name](figure):
                raise InputError(f"figure '{name}': none of the estimators gives what it shows")
        return figure

    def __repr__(self) -> str:
        return f"{self.scenario.name}, seed {self.seed}, trial {self.number}\n{self._shown.to_string()}"

    def _repr_html_(self) -> str:
        return str(self._shown.to_html())

    @property
    def _shown(self) -> pd.DataFrame:
        return self.rows.set_index("estimator")[list(METRIC_KEYS)].dropna(axis=1, how="all").round(3)


def replay(
    recording: str | Path | Recording,
    estimators: Estimators = DEFAULT_ESTIMATORS,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
    align: bool = False,
    progress: Progress | bool = True,
    fit: bool | None = None,
    on_error: OnError = "raise",
) -> pd.DataFrame:
    """Return the rows of `estimators` on a recording or the file of one, each scored by truth or reference.

    `seed`: of the estimators' draws (None: the recording's own); `overrides`: options as
    "estimator.fastslam.particles", and the odometry's data sheet as "noise.u_psi.noise_density", and what the recording
    names of code and files, as its "radio.path_loss", given again: unasked it is not loaded; `align`: each estimate is
    first laid onto the truth; `fit`: sizes of errors are learnt from the recording first (None: if it was measured);
    `progress`, `on_error`: as of `run`. Raises InputError.
    """
    place = Path("recording" if isinstance(recording, Recording) else recording)
    drive = recording if isinstance(recording, Recording) else Recording.load(place)
    origin = Origin.of(drive, place, overrides)
    root = origin.seed if seed is None else seed
    check_counts(1, root)
    with ExternalProcesses() as external, shown(progress) as display:
        given = assumed(drive, origin, names_of(estimators), overrides or {}, fit, display)
        more = {"external": external, "progress": display, "align": align, "sheet": given.odometry_model}
        return _table([score_recording(drive, origin.name, given.requests, origin.trial, root, **more)], on_error)


def sweep(
    scenario: str | Path,
    axes: Mapping[str, Sequence[Any]],
    out: str | Path,
    estimators: Estimators = DEFAULT_ESTIMATORS,
    trials: int = 1,
    seed: int = 0,
    overrides: Mapping[str, Any] | None = None,
    jobs: int | None = None,
    progress: Progress | bool = True,
) -> SweepView:
    """Run every combination of the `axes`, keys with their values, keep it in the folder `out`, and return it.

    What `out` has already is not done again. `jobs`: processes (None: one a core). A trial that
    failed is a row that says why. Raises InputError.
    """
    from cellslam.benchmarks.sweeps.executors import cores, executor
    from cellslam.benchmarks.sweeps.store import writing
    from cellslam.benchmarks.sweeps.sweeping import carry_out, pending
    from cellslam.benchmarks.sweeps.tasks import plan
    from cellslam.benchmarks.trials.child_process import shares
    from cellslam.sim.world import versions

    check_counts(trials, seed)
    values = tuple(tuple({key: value} for value in several) for key, several in axes.items())
    asked = points(Sweep(str(scenario), overrides or {}, values), names_of(estimators))
    processes = jobs or cores()
    command = f"cellslam.sweep({str(scenario)!r}, {dict(axes)!r})"
    with writing(Path(out), command, versions()) as store:
        todo = pending(plan(asked, trials, seed), store.folder, retry_failed=False)
        with (
            executor("processes", processes, shares(processes)) as pool,
            shown(progress) as display,
            display("trials", len(todo)) as advance,
        ):
            carry_out(todo, store, pool, lambda *_: advance(1))
    return SweepView(Path(out))


class SweepView:
    """A sweep in a notebook: it shows itself as its table. The commands `table` and `figures` take its `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def rows(self) -> pd.DataFrame:
        """A row a trial and estimator, with a column for each key that varies."""
        from cellslam.benchmarks.sweeps.rows import results

        return results(self.folder)

    def table(self, metrics: Sequence[str] = (), statistic: str = "median") -> pd.DataFrame:
        """Return the trials summed up: a line for each estimator and setting, a column for each metric.

        Without `metrics` the usual ones; `statistic` as for `cellslam table`. Raises InputError.
        """
        import pandas as pd

        from cellslam.benchmarks.tables.summaries import Layout, groups, row_keys, summary

        layout = Layout(metrics=metrics, statistics=(statistic,))
        lines = groups(summary(self.folder, layout), row_keys(self.folder, layout))
        return pd.DataFrame([{**keys, **dict(zip(some["metric"], some["value"], strict=True))} for keys, some in lines])

    def __repr__(self) -> str:
        return f"sweep in {self.folder}\n{self.table().round(3).to_string()}"

    def _repr_html_(self) -> str:
        return str(self.table().round(3).to_html())


def names_of(estimators: Estimators) -> tuple[str, ...]:
    """Return estimators, one or several, as names; a class is "module:Class"."""
    several = (estimators,) if isinstance(estimators, str | type) else tuple(estimators)
    wrong = [one for one in several if not isinstance(one, str | type)]
    if wrong:
        raise InputError(f"estimator {wrong[0]!r}: give a name, 'module:Class', or the class itself")
    return tuple(one if isinstance(one, str) else f"{one.__module__}:{one.__qualname__}" for one in several)


def _table(trials: Iterable[Trial], on_error: OnError) -> pd.DataFrame:
    import pandas as pd

    if on_error not in get_args(OnError):
        raise unknown_name("on_error", str(on_error), get_args(OnError))
    outcomes = (outcome for trial in trials for outcome in trial.outcomes)
    frame = pd.DataFrame((_row(outcome, on_error) for outcome in outcomes), columns=list(ROW_KEYS))
    numbers = [key for key in ROW_KEYS if key in METRIC_KEYS or key.endswith(("_s", "_m", "_seconds", "_factor"))]
    return frame.astype(dict.fromkeys(numbers, "float64"))


def _row(outcome: Outcome, on_error: OnError) -> Row:
    if outcome.error is None or on_error == "row":
        return outcome.row
    if isinstance(outcome.error, ExternalError):
        outcome.error.add_note(outcome.error.details)  # the traceback of the estimator's own process
    raise outcome.error
