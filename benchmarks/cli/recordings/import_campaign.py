"""`cellslam import`: measured data made a recording."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.benchmarks.cli.arguments import DONE
from cellslam.benchmarks.trials.output_files import check_file

if TYPE_CHECKING:
    pass


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("folder", metavar="FOLDER", help="folder with recording.toml and the tables that it names")
    parser.add_argument("--out", metavar="FILE.h5", required=True, help="the recording to write")
    parser.add_argument(
        "--adapter",
        metavar="NAME",
        help="instead of recording.toml: victoria-park, tampere-60ghz, or your own as module:function",
    )


def command(arguments: Namespace) -> int:
    """Carry out `cellslam import`."""
    from cellslam.benchmarks.recordings.adapters.adapter_loading import import_adapter
    from cellslam.benchmarks.recordings.importing.importing import import_folder
    from cellslam.benchmarks.recordings.inspection.suspicions import suspicions

    out, folder = Path(arguments.out), Path(arguments.folder)
    check_file(out)
    recording = import_adapter(folder, arguments.adapter) if arguments.adapter else import_folder(folder)
    recording.save(out)
    if not arguments.quiet:
        sys.stderr.write(
            f"{out}: {len(recording.time_s)} snapshots, {len(recording.links)} links, "
            f"{len(recording.measurements)} measurements\n"
        )
        for suspicion in suspicions(recording):
            sys.stderr.write(f"suspicious: {suspicion.text}\n")
    return DONE
