"""`cellslam fit-noise`: the sizes of all errors, detection and clutter as a recording shows them."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.cli.arguments import add
from cellslam.progress_bars import bars
from cellslam.sim.recording import Recording

EXAMPLES = ("fit-noise drive.h5",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "file", "--accept-changed")


def command(arguments: Namespace) -> None:
    from cellslam.recordings.fitting.fit_sizes import learn, toml
    from cellslam.scenarios.recording_origin import Origin

    path = Path(arguments.file)
    recording = Recording.load(path, arguments.accept_changed)
    with bars(arguments.quiet) as progress:
        learnt = learn(recording, Origin.of(recording, path).assumed(), progress)
    sys.stdout.write(toml(path, learnt))
