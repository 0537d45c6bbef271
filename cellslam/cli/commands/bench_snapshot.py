"""`cellslam bench snapshot`: one snapshot at signal level."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.benchmarks.trials.trials import check_counts
from cellslam.cli.arguments import add, whole
from cellslam.progress_bars import bars
from cellslam.sim.errors import InputError

EXAMPLES = ("bench snapshot lund-530",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "scenario", "--set", "--seed")
    parser.add_argument("--at", metavar="N", type=whole, default=0, help="number of the snapshot (default: 0)")
    parser.add_argument("--link", metavar="N", type=whole, help="link to show (default: the four with most paths)")
    add(parser, "--out", metavar="FILE.png", default="snapshot.png", help="where to write (default: snapshot.png)")


def command(arguments: Namespace) -> None:
    from cellslam.benchmarks.figures.signal_snapshot import draw_snapshot
    from cellslam.scenarios.loading import load
    from cellslam.scenarios.overrides import parse_all
    from cellslam.sim.world import prepare

    check_counts(1, arguments.seed)
    out = Path(arguments.out)
    check_file(out)
    if out.suffix != ".png":
        raise InputError(f"--out {out}: give the name of a .png file")
    scenario = load(arguments.scenario, parse_all([*arguments.sets, "radio.front_end=signal"]))
    with bars(arguments.quiet) as progress:
        world = prepare(scenario.world, arguments.seed, 0, progress)
        last = len(world.drive.poses) - 1
        if not 0 <= arguments.at <= last:
            raise InputError(f"--at {arguments.at}: the drive has snapshots 0 to {last}")
        for line in draw_snapshot(world, arguments.at, arguments.link, out):
            print(line)
