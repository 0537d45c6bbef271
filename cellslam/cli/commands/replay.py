"""`cellslam replay`: estimators on a recording."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from cellslam.benchmarks.trials import trials
from cellslam.benchmarks.trials.earlier_drives import Before
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.cli.arguments import ESTIMATION, SET_HELP, add, limits
from cellslam.cli.between_drives import check_map, with_calibration
from cellslam.cli.output import note
from cellslam.cli.recording_estimates import assumed_by, warnings_by
from cellslam.cli.results import Results, left_out
from cellslam.progress_bars import bars
from cellslam.recordings.fitting.fit_sizes import in_words, toml
from cellslam.scenarios.estimator_options import with_options
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.recording_origin import Origin
from cellslam.scenarios.scenario import MapConfig
from cellslam.sim.errors import InputError
from cellslam.sim.lte.radio_config import NAMING
from cellslam.sim.recording import Recording

EXAMPLES = ("replay tiny.h5 --estimator fastslam", "replay drive.h5 --fit")


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "file", "--accept-changed")
    add(parser, "--set", help=SET_HELP.format("estimator.fastslam.particles=300"))
    add(parser, "--options", "--fit", *ESTIMATION)
    align_help = "align each estimate with the truth before it is scored; its row says so"
    parser.add_argument("--align", action="store_true", help=align_help)
    add(parser, "--seed", default=None, help="seed of the estimators' random draws (default: the recording's own)")
    add(parser, "--out", help="folder for the results (default: results/replay-FILE)")


def command(arguments: Namespace) -> int:
    path = Path(arguments.file)
    recording = Recording.load(path, arguments.accept_changed)
    if arguments.align and recording.truth is None and recording.reference is None:
        raise InputError(f"--align: {path} has neither truth nor reference to align to; leave the option out")
    origin = Origin.of(recording, path, parse_all(arguments.sets))
    seed = origin.seed if arguments.seed is None else arguments.seed
    trials.check_counts(1, seed)
    note(arguments, left_out(arguments))
    out = Path(arguments.out or f"results/replay-{path.stem}")
    check_folder(out)
    names = arguments.estimators or trials.DEFAULT_ESTIMATORS
    with bars(arguments.quiet) as progress:
        given = assumed_by(arguments, recording, origin, names, progress, arguments.time_limit)
    requests, without = with_calibration(arguments, given.requests, 1)
    scenario = with_options(origin.scenario, requests) if origin.scenario is not None else None
    results = Results(arguments, origin.name, requests, out, scenario=scenario)
    if given.why:
        results.note(f"nothing learnt from {path}: {given.why}")
    elif given.learnt is not None:
        results.write("fit.toml", toml(path, given.learnt))
        results.note("\n".join(in_words(given.learnt)))
    missing = () if origin.measured else [origin.unasked(key) for key in origin.code if key in NAMING]
    results.note("\n".join(f"without the city in figures: {why}" for why in missing))
    results.note(without)
    before = Before(MapConfig(file=arguments.map))
    results.note(check_map(arguments, arguments.map is not None, requests, 1))
    with ExternalProcesses(limits(arguments, 1)) as external, bars(arguments.quiet) as display:
        progress = results.time_spent.of(display)
        external.begin(requests)

        def only() -> Iterator[trials.Trial]:
            yield trials.score_recording(
                recording, origin.name, requests, origin.trial, seed, external=external, progress=progress,
                align=arguments.align, sheet=given.odometry_model, before=before,
            )  # fmt: skip

        interrupted = results.work_off(only(), progress)
    status = results.report(interrupted)
    if results.first is not None and results.first.drive.recording is not None:
        found = [outcome.result for outcome in results.first.outcomes if outcome.result is not None]
        results.note("\n".join(chain(*warnings_by(results.first.drive.recording, found, given.fitted).values())))
    return status
