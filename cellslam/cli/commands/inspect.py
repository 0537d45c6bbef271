"""`cellslam inspect`: what is in a recording."""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import at_once, check_file
from cellslam.cli.arguments import FLAG, SET_HELP, add
from cellslam.cli.output import note
from cellslam.sim.recording import Recording

EXAMPLES = ("inspect drive.h5",)


def add_arguments(parser: ArgumentParser) -> None:
    judge_help = "run this estimator, too: is its estimate worse than the odometry alone? may be repeated"
    add(parser, "file", "--accept-changed")
    add(parser, "--estimator", help=judge_help)
    add(parser, "--set", help=SET_HELP.format("estimator.fastslam.particles=300"))
    add(parser, "--options", "--fit")
    add(parser, "--seed", default=None, help="seed of the estimators' random draws (default: the recording's own)")
    add(parser, "--json", help="print one JSON object on stdout, nothing else")
    parser.add_argument("--figure", metavar="FILE.png", help="where to draw (default: the recording's name with .png)")
    parser.add_argument("--no-figure", help="do not draw", **FLAG)


def command(arguments: Namespace) -> None:
    from cellslam.recordings.inspection.inspection import as_text, inspected

    path = Path(arguments.file)
    figure = Path(arguments.figure) if arguments.figure else path.with_suffix(".png")
    if not arguments.no_figure:
        check_file(figure)
    recording = Recording.load(path, arguments.accept_changed)
    found = inspected(recording)
    if arguments.estimators:
        from cellslam.cli.recording_estimates import estimates_by, warnings_by

        found["estimators"] = warnings_by(*estimates_by(arguments, recording, path, arguments.estimators))
    as_json = json.dumps(found, indent=1, allow_nan=False) + "\n" if arguments.json else ""
    sys.stdout.write(as_json or as_text(path, recording, found))
    if not arguments.no_figure:
        from cellslam.recordings.inspection.inspection import plot

        with at_once(figure) as place:
            plot(recording).savefig(place, format="png")
        note(arguments, f"figure: {figure}")
