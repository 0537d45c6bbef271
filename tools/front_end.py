"""`python -m tools front-end`: what the path estimator finds."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace

from cellslam.cli.arguments import DONE
from cellslam.progress_bars import bars
from cellslam.sim.errors import InputError
from tools.studies_tables import print_studies

TECHNOLOGIES = ("lte", "nr")
STUDIES = ("single", "many", "resolution", "collision", "ghosts", "motion", "speed")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument(
        "--study", metavar="NAME", action="append", default=[], choices=STUDIES, dest="studies",
        help=f"one study: {', '.join(STUDIES)}; may be repeated (default: all)",
    )  # fmt: skip
    parser.add_argument(
        "--technology", metavar="NAME", default="lte", choices=TECHNOLOGIES,
        help="waveform: lte (20 MHz at 2.66 GHz) or nr (100 MHz at 3.5 GHz; no collisions) (default: lte)",
    )  # fmt: skip
    parser.add_argument("--runs", metavar="N", type=int, default=150, help="random scenes of each point (default: 150)")
    parser.add_argument("--seed", metavar="S", type=int, default=0, help="seed of the scenes (default: 0)")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON on stdout, nothing else")


def command(arguments: Namespace) -> int:
    """Carry out `python -m tools front-end`."""
    if arguments.runs < 2 or arguments.seed < 0:
        raise InputError(f"--runs {arguments.runs} --seed {arguments.seed}: at least 2 runs and a seed from 0 on")
    from threadpoolctl import threadpool_limits

    from tools.front_end_tables import studies

    with bars(arguments.quiet) as progress, threadpool_limits(1):
        rows = studies(arguments.studies, arguments.runs, arguments.seed, progress, arguments.technology)
    if arguments.json:
        sys.stdout.write(json.dumps(rows, indent=1) + "\n")
    else:
        print_studies(rows)
    return DONE
