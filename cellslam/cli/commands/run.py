"""`cellslam run`: simulate a scenario, run estimators on it, score them."""

from __future__ import annotations

import shlex
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.trials.estimation import compile_ahead
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.benchmarks.trials.trials import DEFAULT_ESTIMATORS, Trial, check_counts, simulated_trials
from cellslam.cli.arguments import ESTIMATION, add, limits, whole
from cellslam.cli.between_drives import check_map, with_calibration, with_map
from cellslam.cli.cities import note_own_city
from cellslam.cli.output import note_long
from cellslam.cli.results import Results, left_out
from cellslam.progress_bars import bars
from cellslam.scenarios import external_options
from cellslam.scenarios.estimator_options import with_options
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    from cellslam.scenarios.scenario import Scenario

EXAMPLES = (
    "run tiny",
    "run lund-530 --seed 7 --estimator ekf-slam --estimator fastslam",
    "run munich-530 --set radio.clutter_scale=2 --estimator my_module:MyEstimator",
    "run lund-530 --trials 10 --json",
)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "scenario", "--set", *ESTIMATION)
    parser.add_argument("--rays", action="store_true", help="draw the drive's rays, also as an interactive page")
    trials_help = "trials 0 to N-1, one after the other; 'sweep' takes all cores (default: 1)"
    parser.add_argument("--trials", metavar="N", type=whole, default=1, help=trials_help)
    add(parser, "--seed")
    add(parser, "--out", help="folder for the results (default: results/SCENARIO-SEED)")


def command(arguments: Namespace) -> int:
    if arguments.rays:
        from cellslam.benchmarks.report.page import check_plotly

        check_plotly()
    trials, seed = arguments.trials, arguments.seed
    overrides = with_map(arguments, parse_all(arguments.sets))
    scenario = load(arguments.scenario, overrides)
    check_counts(trials, seed)
    names = arguments.estimators or DEFAULT_ESTIMATORS
    requests = external_options.requests(scenario.estimator, names, overrides, arguments.time_limit)
    requests, without = with_calibration(arguments, requests, trials)
    out = Path(arguments.out or f"results/{scenario.name}-{seed}")
    results = Results(arguments, scenario.name, requests, out, trials, with_options(scenario, requests))
    results.note(left_out(arguments))
    check_folder(out)
    results.note(without)
    known = scenario.map.known is not None or scenario.map.drives > 1
    results.note(check_map(arguments, known, requests, trials))
    note_long(arguments, scenario.city, scenario.vehicle)
    note_own_city(arguments, scenario, seed)
    with ExternalProcesses(limits(arguments, 1)) as external, bars(arguments.quiet) as display, ExitStack() as stack:
        progress = results.time_spent.of(display)
        compile_ahead(requests)
        external.begin(requests)
        results.open_store = lambda: _open_store(results, scenario, stack)
        interrupted = results.work_off(simulated_trials(scenario, requests, trials, seed, external, progress), progress)
    status = results.report(interrupted)
    if not interrupted and any(row["status"] == "ok" for row in results.rows):
        results.note(next_commands(results))
    return status


def next_commands(results: Results) -> str:
    """Return the commands that one may want to give next, each with what it does."""
    again, folder = results.command, shlex.quote(str(results.folder))
    commands = {f"cellslam report {folder}": "one page of it, with a playback"} if results.keep is not None else {}
    if results.trials == 1:
        commands[f"{again} --trials 10"] = "ten drives: one says little"
    else:
        commands[f"cellslam consistency {folder}"] = "do estimators know how wrong they are?"
    if not results.arguments.estimators:
        commands[f"{again} --estimator all"] = "the other estimators, on the same drives"
    else:
        commands[f"cellslam show {shlex.quote(results.arguments.scenario)}"] = "what --set can change"
    width = max(map(len, commands))
    return "\n".join(["worth trying next:", *(f"  {line:{width}}  {what}" for line, what in commands.items())])


def _open_store(results: Results, scenario: Scenario, stack: ExitStack) -> Callable[[Trial], None] | None:
    """Return what keeps trials as a sweep's, too; None, with a note, where the disk has no locks, as on a network."""
    from cellslam.benchmarks.sweeps.sweeping import keeping

    seed = results.arguments.seed
    try:
        return stack.enter_context(
            keeping(results.folder, scenario, results.requests, results.trials, seed, results.command, results.note)
        )
    except InputError as error:
        results.note(f"without a store for 'cellslam report': {error}")
        return None
