"""`cellslam import`: measured data made a recording."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.cli.arguments import add
from cellslam.cli.output import note, size_of
from cellslam.recordings.adapters.adapter_loading import ADAPTERS, import_adapter
from cellslam.sim.errors import InputError

EXAMPLES = ("import campaign --out drive.h5", "import --adapter victoria-park park --out park.h5")


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("folder", metavar="FOLDER", help="folder with recording.toml and the tables that it names")
    add(parser, "--out", metavar="FILE.h5", required=True, help="the recording to write")
    adapter_help = f"not recording.toml, but {', '.join(ADAPTERS)}, or your own as module:function"
    parser.add_argument("--adapter", metavar="NAME", help=adapter_help)
    add(parser, "--set", help="an option of the adapter, as in robot=2; may be repeated")


def command(arguments: Namespace) -> None:
    from cellslam.recordings.importing.importing import import_folder
    from cellslam.recordings.importing.manifest import files_outside
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
    outside = [name for key in ("manifest", "sheet") for name in files_outside(folder, recording.provenance.get(key))]
    note(arguments, f"files outside {folder} were read: {', '.join(dict.fromkeys(outside))}" if outside else "")
    recording.save(out)
    if not arguments.quiet:
        note(arguments, f"{out}: {size_of(recording)}")
        for suspicion in suspicions(recording):
            note(arguments, f"suspicious: {suspicion.text}")
