"""`cellslam import`: measured data made a recording."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.cli.arguments import DONE
from cellslam.sim.errors import InputError


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("folder", metavar="FOLDER", help="folder with recording.toml and the tables that it names")
    parser.add_argument("--out", metavar="FILE.h5", required=True, help="the recording to write")
    parser.add_argument(
        "--adapter",
        metavar="NAME",
        help="not recording.toml, but victoria-park, tampere-60ghz, mrclam, plaza, tui, or your own as module:function",
    )
    set_help = "an option of the adapter, as in robot=2; may be repeated"
    parser.add_argument("--set", metavar="KEY=VALUE", action="append", default=[], dest="sets", help=set_help)


def command(arguments: Namespace) -> int:
    """Carry out `cellslam import`."""
    from cellslam.recordings.adapters.adapter_loading import import_adapter
    from cellslam.recordings.importing.importing import import_folder
    from cellslam.recordings.inspection.suspicions import suspicions
    from cellslam.scenarios.overrides import parse_all

    out, folder = Path(arguments.out), Path(arguments.folder)
    check_file(out)
    options = parse_all(arguments.sets)
    if options and not arguments.adapter:
        raise InputError(
            "--set is for options of an adapter; what a folder of tables means stands in its recording.toml"
        )
    recording = import_adapter(folder, arguments.adapter, options) if arguments.adapter else import_folder(folder)
    recording.save(out)
    if not arguments.quiet:
        sys.stderr.write(
            f"{out}: {len(recording.time_s)} snapshots, {len(recording.links)} links, "
            f"{len(recording.measurements)} measurements\n"
        )
        for suspicion in suspicions(recording):
            sys.stderr.write(f"suspicious: {suspicion.text}\n")
    return DONE
