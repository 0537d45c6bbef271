"""`cellslam map join`: the maps that several cars left, as one."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.cli.arguments import add
from cellslam.sim.errors import InputError

EXAMPLES = ("map join first.h5 second.h5 --out both.h5",)


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("files", metavar="FILE.h5", nargs="+", help="maps that 'cellslam run --save-map' wrote")
    add(parser, "--out", metavar="FILE.h5", required=True, help="file of the map to write")


def command(arguments: Namespace) -> None:
    from cellslam.slam.model.map_joining import join
    from cellslam.slam.model.vt_map import VtMap

    check_file(Path(arguments.out))
    if len(arguments.files) < 2:
        raise InputError("one map alone: give two or more files")
    whole, *others = (VtMap.load(file) for file in arguments.files)
    for file, other in zip(arguments.files[1:], others, strict=True):
        try:
            found = join(whole, other)
        except InputError as error:
            raise InputError(f"{file}: {error}") from error
        kept = f"; {found.apart} pairs near each other do not fit and are kept apart" if found.apart else ""
        before, whole = len(whole), found.map
        print(f"{file}: {len(other)} VTs, {found.same} of them of the {before} so far{kept}")
    whole.save(arguments.out)
    print(f"{arguments.out}: {len(whole)} VTs")
