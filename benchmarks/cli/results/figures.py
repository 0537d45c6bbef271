"""`cellslam figures`: the figures of a sweep."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.cli.arguments import DONE, number


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("folder", metavar="DIR", help="folder of a sweep")
    parser.add_argument("--x", metavar="KEY", help="key along the sweep curve (default: the first number that varies)")
    parser.add_argument("--metric", metavar="NAME", default="position_rmse_m", help="default: position_rmse_m")
    parser.add_argument("--statistic", metavar="NAME", default="median", help="as for 'table' (default: median)")
    interval_help = "confidence of the intervals (default: 95)"
    parser.add_argument("--interval", metavar="PERCENT", type=number, default=95.0, help=interval_help)
    parser.add_argument("--out", metavar="FOLDER", help="where to write (default: DIR/figures)")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam figures`."""
    from cellslam.benchmarks.cli.progress_bars import bars
    from cellslam.benchmarks.figures.sweep.sweep_figures import draw_sweep
    from cellslam.benchmarks.figures.sweep.sweep_look import Look
    from cellslam.benchmarks.trials.output_files import check_folder

    folder = Path(arguments.folder)
    look = Look(arguments.x, arguments.metric, arguments.statistic, arguments.interval / 100)
    out = Path(arguments.out) if arguments.out else folder / "figures"
    check_folder(out)
    with bars(arguments.quiet) as progress:
        written = draw_sweep(folder, out, look, progress=progress)
    if not arguments.quiet:
        sys.stderr.write(f"{len(written)} files are in {out}: {', '.join(sorted({p.stem for p in written}))}\n")
    return DONE
