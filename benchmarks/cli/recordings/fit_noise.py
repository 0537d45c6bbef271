"""`cellslam fit-noise`: noise, detection and clutter as a recording shows them."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.cli.arguments import DONE
from cellslam.benchmarks.cli.progress_bars import bars
from cellslam.sim.recording import Recording

if TYPE_CHECKING:
    pass


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("file", metavar="FILE.h5", help="a recording")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam fit-noise`."""
    from cellslam.benchmarks.recordings.fitting.fit_noise import fit
    from cellslam.benchmarks.recordings.fitting.fitted_lines import lines

    path = Path(arguments.file)
    recording = Recording.load(path)
    with bars(arguments.quiet) as progress:
        fitted = fit(recording, progress)
    sys.stdout.write(lines(path, recording, fitted))
    return DONE
