"""`cellslam run`, and what it shares with `replay`: the loop over trials, the files, what is printed."""

from __future__ import annotations

import json
import shlex
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellslam.benchmarks.tables.trials_table import bound_row, results_table
from cellslam.benchmarks.trials.estimation import compile_ahead
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.benchmarks.trials.trials import DEFAULT_ESTIMATORS, Trial, check_counts, simulated_trials
from cellslam.cli.arguments import DONE, FAILED, INTERRUPTED, add_estimation, add_scenario, add_seed, limits, whole
from cellslam.cli.between_drives.calibration_files import add_calibration, calibrated, save
from cellslam.cli.between_drives.map_files import add_map, add_save_map, check_map, save_map, with_map
from cellslam.cli.progress_bars import bars
from cellslam.cli.results_folder import Folder
from cellslam.scenarios import external_options
from cellslam.scenarios.estimator_options import Request, with_options
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.errors import InputError
from cellslam.slam import registry

if TYPE_CHECKING:
    from cellslam.scenarios.scenario import Scenario
    from cellslam.sim.progress import Progress
    from cellslam.sim.world import World

PIPE_WIDTH = 120


@dataclass
class Job:
    """What one command does, and what it has done so far."""

    arguments: Namespace
    scenario: Scenario | None
    name: str
    requests: tuple[Request, ...]
    trials: int
    folder: Folder
    rows: list[dict[str, Any]] = field(default_factory=list)
    bounds: list[dict[str, Any]] = field(default_factory=list)
    first: Trial | None = None
    open_store: Callable[[], Callable[[Trial], None] | None] = lambda: None
    keep: Callable[[Trial], None] | None = None
    unsaved: str = ""

    def note(self, text: str) -> None:
        """Say something, if it is something, on stderr, unless --quiet."""
        if text and not self.arguments.quiet:
            sys.stderr.write(f"{text}\n")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scenario(parser)
    add_estimation(parser)
    add_calibration(parser)
    add_map(parser)
    add_save_map(parser)
    parser.add_argument("--rays", action="store_true", help="draw the drive's rays, also as an interactive page")
    trials_help = "trials 0 to N-1, one after the other; 'sweep' takes all cores (default: 1)"
    parser.add_argument("--trials", metavar="N", type=whole, default=1, help=trials_help)
    add_seed(parser, 0, "root seed of all random draws (default: 0)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/SCENARIO-SEED)")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam run`."""
    if arguments.rays:
        from cellslam.benchmarks.report.page import check_plotly

        check_plotly()
    overrides = with_map(arguments, parse_all(arguments.sets))
    scenario = load(arguments.scenario, overrides)
    check_counts(arguments.trials, arguments.seed)
    asked = arguments.estimators or DEFAULT_ESTIMATORS
    requests = external_options.requests(scenario.estimator, asked, overrides)
    requests, note = calibrated(arguments, requests, arguments.trials)
    note_left_out(arguments)
    out = Path(arguments.out or f"results/{scenario.name}-{arguments.seed}")
    check_folder(out)
    folder = Folder(out, several=arguments.trials > 1)
    job = Job(arguments, with_options(scenario, requests), scenario.name, requests, arguments.trials, folder)
    job.note(note)
    known = scenario.map.known is not None or scenario.map.drives > 1
    job.note(check_map(arguments, known, requests, arguments.trials))
    with ExternalProcesses(limits(arguments, 1)) as external, bars(arguments.quiet) as progress, ExitStack() as stack:
        compile_ahead(requests)
        external.begin(requests)
        job.open_store = partial(_open_store, job, scenario, stack)
        trials = simulated_trials(scenario, requests, arguments.trials, arguments.seed, external, progress)
        interrupted = work_off(job, trials, progress)
    status = report(job, interrupted)
    if not interrupted:
        job.note(worth_trying(job))
    return status


def worth_trying(job: Job) -> str:
    """Return the commands that one may want to give next, each with what it does."""
    again, folder = shlex.join(["cellslam", *job.arguments.words]), shlex.quote(str(job.folder.path))
    commands = {f"cellslam report {folder}": "one page of it, with a playback"} if job.keep is not None else {}
    if job.trials == 1:
        commands[f"{again} --trials 10"] = "ten drives: one says little"
    else:
        commands[f"cellslam consistency {folder}"] = "do estimators know how wrong they are?"
    if not job.arguments.estimators:
        commands[f"{again} --estimator all"] = "the other estimators, on the same drives"
    else:
        commands[f"cellslam show {shlex.quote(job.arguments.scenario)}"] = "what --set can change"
    width = max(map(len, commands))
    return "\n".join(["worth trying next:", *(f"  {line:{width}}  {what}" for line, what in commands.items())])


def _open_store(job: Job, scenario: Scenario, stack: ExitStack) -> Callable[[Trial], None] | None:
    """Return what keeps trials as a sweep's, too; None, said, where the disk has no locks, as on a network."""
    from cellslam.benchmarks.sweeps.sweeping import keeping

    words, seed = shlex.join(["cellslam", *job.arguments.words]), job.arguments.seed
    try:
        return stack.enter_context(keeping(job.folder.path, scenario, job.requests, job.trials, seed, words))
    except InputError as error:
        job.note(f"without a store for 'cellslam report': {error}")
        return None


def note_left_out(arguments: Namespace) -> None:
    """Say which estimators `all` does not stand for, unless they are asked for by name."""
    asked = arguments.estimators or ()
    if registry.ALL in asked and not arguments.quiet:
        for name, why in registry.left_out().items():
            if name not in asked:
                sys.stderr.write(f"left out of all: {name} ({why})\n")


def work_off(job: Job, trials: Iterator[Trial], progress: Progress) -> bool:
    """Go through the trials, writing what each leaves; return whether the user interrupted."""
    try:
        for trial in trials:
            _keep(job, trial)
        if job.first is not None and not job.arguments.no_figures:
            world = _world_of(job)
            job.folder.draw(job.first, world.scene.city if world else None, progress)
            if world is not None and getattr(job.arguments, "rays", False):
                from cellslam.benchmarks.report.city_page import draw_rays

                draw_rays(world, job.folder.path)
    except KeyboardInterrupt:
        if job.rows:
            job.folder.write_summary(job.rows, _about(job))
        return True
    return False


def report(job: Job, interrupted: bool) -> int:
    """Print the rows and return the exit status."""
    if job.arguments.json:
        lines = ",\n".join(json.dumps(row, allow_nan=False) for row in job.rows)
        sys.stdout.write(f"[\n{lines}\n]\n" if job.rows else "[]\n")
    elif job.rows:
        _print_table(job)
    if interrupted:
        return _interrupted(job)
    job.note(f"results are in {job.folder.path}")
    return FAILED if job.unsaved or any(row["status"] == "failed" for row in job.rows) else DONE


def _keep(job: Job, trial: Trial) -> None:
    if job.first is None:
        job.folder.clear()
    job.rows.extend(outcome.row for outcome in trial.outcomes)
    job.bounds.extend([row] if (row := bound_row(trial)) else [])
    if trial.unbound:
        job.note(f"without the bound: {trial.unbound}")
    job.folder.write_trial(trial)
    if job.first is None:
        job.first, job.keep = trial, job.open_store()
        if job.scenario is not None:
            job.folder.write_scenario(job.scenario.toml())
    if job.keep is not None:
        job.keep(trial)
    job.folder.write_summary(job.rows, _about(job))
    for outcome in trial.outcomes:
        if outcome.row["status"] == "failed":
            job.note(f"trial {trial.number}, {outcome.row['estimator']} failed: {outcome.row['error']}")
        for remark in outcome.result.remarks if outcome.result is not None else ():
            job.note(f"trial {trial.number}, {outcome.row['estimator']}: {remark}")
    for saved in (save, save_map):
        unsaved = saved(job.arguments, job.requests, trial)
        job.unsaved = unsaved or job.unsaved
        job.note(unsaved)


def _about(job: Job) -> dict[str, Any]:
    provenance = job.first.recording.provenance if job.first and job.first.recording else {}
    return {
        "command": shlex.join(["cellslam", *job.arguments.words]),
        "scenario": job.name,
        "trials": job.trials,
        "versions": provenance.get("versions", {}),
        "resolved": job.scenario.resolved if job.scenario is not None else None,
    }


def _world_of(job: Job) -> World | None:
    """Return the world of the first trial, for the maps; None for a recording without scenario."""
    if job.scenario is None or job.first is None or job.first.recording is None:
        return None
    from cellslam.sim.world import prepare

    seed = int(job.first.recording.provenance.get("seed", 0))
    return prepare(job.scenario.world, seed, job.first.number)


def _print_table(job: Job) -> None:
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=PIPE_WIDTH)
    oracles = frozenset(request.name for request in job.requests if request.oracle)
    console.print(results_table([*job.rows, *job.bounds], _title(job), oracles, console.width))


def _title(job: Job) -> str:
    row = job.rows[0]
    many = f"medians of {job.trials} trials, " if job.trials > 1 else ""
    length = f", {row['distance_m']:.0f} m" if row["distance_m"] is not None else ""
    drive = f"{row['snapshots']} snapshots, {row['duration_s']:.1f} s{length}"
    drive += ", estimates ALIGNED to the truth" if "alignment" in row else ""
    return f"{job.name}, seed {row['seed']}: {many}{drive}"


def _interrupted(job: Job) -> int:
    done = len({row["trial"] for row in job.rows})
    if done:
        text = f"{done} of {job.trials} trials are finished and kept in {job.folder.path}"
    else:
        text = "no trial was finished and nothing was written"
    again = shlex.join(["cellslam", *job.arguments.words])
    sys.stderr.write(f"interrupted: {text}; to do it all, repeat: {again}\n")
    return INTERRUPTED
