"""`cellslam record`: a simulated drive, kept as a recording."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.cli.arguments import (
    DONE,
    add_scenario,
    add_seed,
    whole,
)
from cellslam.benchmarks.cli.progress_bars import bars
from cellslam.benchmarks.trials import trials
from cellslam.benchmarks.trials.output_files import check_file
from cellslam.scenarios.estimator_options import resolve
from cellslam.scenarios.loading import load
from cellslam.scenarios.overrides import parse_all
from cellslam.scenarios.simulation import simulate
from cellslam.sim.errors import InputError


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    add_scenario(parser)
    parser.add_argument("--out", metavar="FILE.h5", required=True, help="the HDF5 file to write")
    add_seed(parser, 0, "root seed of all random draws (default: 0)")
    parser.add_argument("--trial", metavar="N", type=whole, default=0, help="which trial to record (default: 0)")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam record`."""
    overrides = parse_all(arguments.sets)
    scenario = load(arguments.scenario, overrides)
    resolve(scenario.estimator, (), overrides)
    trials.check_counts(1, arguments.seed)
    if arguments.trial < 0:
        raise InputError(f"trial = {arguments.trial}: must be 0 or more")
    path = Path(arguments.out)
    check_file(path)
    with bars(arguments.quiet) as progress:
        recording = simulate(scenario, arguments.seed, arguments.trial, progress=progress)
        recording.save(path)
    if not arguments.quiet:
        sys.stderr.write(
            f"{path}: {len(recording.time_s)} snapshots, {len(recording.links)} links, "
            f"{len(recording.measurements)} measurements\n"
        )
    return DONE
