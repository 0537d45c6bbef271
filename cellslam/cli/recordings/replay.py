"""`cellslam replay`: estimators on a recording."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from cellslam.benchmarks.trials import trials
from cellslam.benchmarks.trials.earlier_drives import Before
from cellslam.benchmarks.trials.external_processes import ExternalProcesses
from cellslam.benchmarks.trials.output_files import check_folder
from cellslam.cli.arguments import add_estimation, add_options_file, add_seed, add_set, limits
from cellslam.cli.between_drives.calibration_files import add_calibration, calibrated
from cellslam.cli.between_drives.map_files import add_map, add_save_map, check_map
from cellslam.cli.progress_bars import bars
from cellslam.cli.recordings.estimator_options import assumed_by, doubts
from cellslam.cli.results_folder import Folder
from cellslam.cli.run import Job, note_left_out, report, work_off
from cellslam.recordings.fitting.assumptions import Assumptions
from cellslam.recordings.fitting.fit_sizes import said, toml
from cellslam.scenarios.estimator_options import with_options
from cellslam.scenarios.recording_origin import Origin
from cellslam.scenarios.scenario import MapConfig
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    add_set(parser, "estimator.fastslam.particles=300")
    add_options_file(parser)
    add_estimation(parser)
    add_calibration(parser)
    add_map(parser)
    add_save_map(parser)
    parser.add_argument(
        "--align",
        action="store_true",
        help="lay each estimate onto the truth before it is scored, and say so in its row",
    )
    add_seed(parser, None, "seed of the estimators' random draws (default: the recording's own)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/replay-FILE)")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam replay`."""
    path = Path(arguments.file)
    recording = Recording.load(path)
    if arguments.align and recording.truth is None and recording.reference is None:
        raise InputError(f"--align: {path} has neither truth nor reference to align to; leave the option out")
    origin = Origin.of(recording, path)
    seed = origin.seed if arguments.seed is None else arguments.seed
    trials.check_counts(1, seed)
    note_left_out(arguments)
    out = Path(arguments.out or f"results/replay-{path.stem}")
    check_folder(out)
    names = arguments.estimators or trials.DEFAULT_ESTIMATORS
    with bars(arguments.quiet) as progress:
        given = assumed_by(arguments, recording, origin, names, progress)
    (requests, note), folder = calibrated(arguments, given.requests, 1), Folder(out)
    _say(given, path, folder, arguments.quiet)
    scenario = with_options(origin.scenario, requests) if origin.scenario is not None else None
    job = Job(arguments, scenario, origin.name, requests, 1, folder)
    job.note(note)
    before = Before(MapConfig(file=arguments.map))
    job.note(check_map(arguments, arguments.map is not None, requests, 1))
    with ExternalProcesses(limits(arguments, 1)) as external, bars(arguments.quiet) as progress:
        external.begin(requests)

        def only() -> Iterator[trials.Trial]:
            yield trials.score_recording(
                recording, origin.name, requests, origin.trial, seed, external=external, progress=progress,
                align=arguments.align, sheet=given.odometry_model, before=before,
            )  # fmt: skip

        interrupted = work_off(job, only(), progress)
    status = report(job, interrupted)
    if job.first is not None and job.first.recording is not None:
        results = [outcome.result for outcome in job.first.outcomes if outcome.result is not None]
        for line in chain(*doubts(job.first.recording, results).values()):
            job.note(line)
    return status


def _say(given: Assumptions, path: Path, folder: Folder, quiet: bool) -> None:
    """Say what was learnt, and keep it."""
    lines = [f"nothing learnt from {path}: {given.why}"] if given.why else []
    if given.learnt is not None:
        lines = said(given.learnt)
        folder.write_fit(toml(path, given.learnt))
    if not quiet:
        sys.stderr.write("".join(f"{line}\n" for line in lines))
