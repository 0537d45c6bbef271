"""`cellslam inspect`: what is in a recording."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.cli.arguments import DONE, add_options_file, add_seed, add_set
from cellslam.cli.recordings.write_at_once import at_once
from cellslam.sim.recording import Recording


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    judge_help = "run this estimator, too, and say whether it is worth less than the odometry alone; may be repeated"
    parser.add_argument("--estimator", metavar="NAME", action="append", default=[], dest="estimators", help=judge_help)
    add_set(parser, "estimator.fastslam.particles=300")
    add_options_file(parser)
    add_seed(parser, None, "seed of the estimators' random draws (default: the recording's own)")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout, nothing else")
    parser.add_argument("--figure", metavar="FILE.png", help="where to draw (default: the recording's name with .png)")
    parser.add_argument("--no-figure", action="store_true", help="do not draw")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam inspect`."""
    from cellslam.recordings.inspection.inspection import as_json, as_text, inspected

    path = Path(arguments.file)
    figure = Path(arguments.figure) if arguments.figure else path.with_suffix(".png")
    if not arguments.no_figure:
        check_file(figure)
    recording = Recording.load(path)
    found = inspected(recording)
    if arguments.estimators:
        from cellslam.cli.recordings.estimator_options import doubts, estimate_by

        found["estimators"] = doubts(*estimate_by(arguments, recording, path, arguments.estimators))
    sys.stdout.write(as_json(found) if arguments.json else as_text(path, recording, found))
    if not arguments.no_figure:
        from cellslam.recordings.inspection.inspection_figure import draw

        at_once(figure, lambda place: draw(recording, place))
        if not arguments.quiet:
            sys.stderr.write(f"figure: {figure}\n")
    return DONE
