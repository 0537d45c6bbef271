"""`cellslam record`: simulated drives, kept as recordings."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials import trials
from cellslam.benchmarks.trials.output_files import check_file, check_folder
from cellslam.cli.arguments import DONE, add_scenario, add_seed, whole
from cellslam.cli.progress_bars import bars
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.scenario import Scenario
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Recording


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scenario(parser)
    parser.add_argument(
        "--out", metavar="FILE.h5", required=True, help="the HDF5 file to write; with --trials a folder for many"
    )
    add_seed(parser, 0, "root seed of all random draws (default: 0)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--trial", metavar="N", type=whole, default=0, help="which trial to record (default: 0)")
    which.add_argument(
        "--trials", metavar="N", type=whole, help="a data set: trials 0 to N-1; files that are there already stay"
    )


def command(arguments: Namespace) -> int:
    """Carry out `cellslam record`."""
    overrides = parse_all(arguments.sets)
    scenario = load(arguments.scenario, overrides)
    resolve(scenario.estimator, (), overrides)
    many, out = arguments.trials is not None, Path(arguments.out)
    trials.check_counts(arguments.trials if many else 1, arguments.seed)
    if arguments.trial < 0:
        raise InputError(f"trial = {arguments.trial}: must be 0 or more")
    if many:
        check_folder(out)
        out.mkdir(parents=True, exist_ok=True)
    else:
        check_file(out)
    with bars(arguments.quiet) as progress:
        for trial in range(arguments.trials) if many else (arguments.trial,):
            path = out / f"{scenario.name}-{arguments.seed}-{trial:04}.h5" if many else out
            if many and path.exists():
                _check_same(path, scenario)
                continue
            recording = simulate(scenario, arguments.seed, trial, progress=progress)
            recording.save(path)
            if not arguments.quiet:
                sys.stderr.write(
                    f"{path}: {len(recording.time_s)} snapshots, {len(recording.links)} links, "
                    f"{len(recording.measurements)} measurements\n"
                )
    return DONE


def _check_same(path: Path, scenario: Scenario) -> None:
    """Raise InputError where a file is no recording of the scenario."""
    if Recording.load(path).provenance.get("world") != scenario.world.model_dump(mode="json"):
        raise InputError(f"{path}: is of another scenario, or of other keys; give another --out")
