"""`cellslam inspect`: what is in a recording."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.cli.arguments import DONE
from cellslam.benchmarks.trials.output_files import check_file
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    pass
from cellslam.benchmarks.cli.recordings.write_at_once import at_once


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE.h5", help="a recording")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout, nothing else")
    parser.add_argument("--figure", metavar="FILE.png", help="where to draw (default: the recording's name with .png)")
    parser.add_argument("--no-figure", action="store_true", help="do not draw")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam inspect`."""
    from cellslam.benchmarks.recordings.inspection.inspection import as_json, as_text, inspected

    path = Path(arguments.file)
    figure = Path(arguments.figure) if arguments.figure else path.with_suffix(".png")
    if not arguments.no_figure:
        check_file(figure)
    recording = Recording.load(path)
    found = inspected(recording)
    sys.stdout.write(as_json(found) if arguments.json else as_text(path, recording, found))
    if not arguments.no_figure:
        from cellslam.benchmarks.recordings.inspection.inspection_figure import draw

        at_once(figure, lambda place: draw(recording, place))
        if not arguments.quiet:
            sys.stderr.write(f"figure: {figure}\n")
    return DONE
