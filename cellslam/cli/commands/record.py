"""`cellslam record`: simulated drives, kept as recordings."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials import trials
from cellslam.benchmarks.trials.output_files import check_file, check_folder
from cellslam.cli.arguments import FLAG, add, whole
from cellslam.cli.cities import note_own_city
from cellslam.cli.output import note, note_long, size_of
from cellslam.progress_bars import bars
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording

EXAMPLES = ("record tiny --out tiny.h5", "record tiny --trials 20 --out drives")


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "scenario", "--set")
    out_help = "the HDF5 file to write; with --trials a folder for many"
    add(parser, "--out", metavar="FILE.h5", required=True, help=out_help)
    add(parser, "--seed")
    which = parser.add_mutually_exclusive_group()
    add(which, "--trial")
    trials_help = "a data set: trials 0 to N-1; files that are there already stay"
    which.add_argument("--trials", metavar="N", type=whole, help=trials_help)
    raw_help = "also the raw array responses, of radio.front_end=signal, into NAME-responses.h5 beside the recording"
    parser.add_argument("--responses", help=raw_help, **FLAG)


def beside(path: Path) -> Path:
    """Return the file of a recording's raw responses."""
    return path.with_name(f"{path.stem}-responses.h5")


def command(arguments: Namespace) -> None:
    overrides = parse_all(arguments.sets)
    scenario = load(arguments.scenario, overrides)
    resolve(scenario.estimator, (), overrides)
    many, out = arguments.trials is not None, Path(arguments.out)
    trials.check_counts(arguments.trials if many else 1, arguments.seed)
    if arguments.trial < 0:
        raise InputError(f"trial = {arguments.trial}: must be 0 or more")
    if arguments.responses and scenario.radio.front_end != "signal":
        raise InputError("--responses are of the signal-level front end: --set radio.front_end=signal")
    if many:
        check_folder(out)
        out.mkdir(parents=True, exist_ok=True)
    else:
        check_file(out)
    note_long(arguments, scenario.city, scenario.vehicle)
    note_own_city(arguments, scenario, arguments.seed, arguments.trial)
    with bars(arguments.quiet) as progress:
        for trial in range(arguments.trials) if many else (arguments.trial,):
            path = out / f"{scenario.name}-{arguments.seed}-{trial:04}.h5" if many else out
            if many and path.exists():
                if Recording.load(path).provenance.get("world") != scenario.world.model_dump(mode="json"):
                    raise InputError(f"{path}: is of another scenario, or of other keys; give another --out")
                continue
            recording = simulate(scenario, arguments.seed, trial, progress=progress)
            recording.save(path)
            if arguments.responses:
                from cellslam.sim.world.responses import write_responses

                write_responses(beside(path), scenario.world, arguments.seed, trial, progress)
            note(arguments, f"{path}: {size_of(recording)}")
