"""`cellslam figures`: the figures of a sweep, or that of a calibration."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.cli.arguments import add, number
from cellslam.cli.output import note
from cellslam.sim.errors import InputError

EXAMPLES = ("figures load",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder", help="folder of a sweep, or a file that --save-calibration wrote")
    x_help = "key along the sweep curve (default: the first that varies, a number if any is)"
    parser.add_argument("--x", metavar="KEY", help=x_help)
    parser.add_argument("--metric", metavar="NAME", default="position_rmse_m", help="default: position_rmse_m")
    parser.add_argument("--statistic", metavar="NAME", default="median", help="as for 'table' (default: median)")
    interval_help = "confidence of the intervals (default: 95)"
    parser.add_argument("--interval", metavar="PERCENT", type=number, default=95.0, help=interval_help)
    add(parser, "--out", metavar="FOLDER", help="where to write (default: DIR/figures, or beside the file)")


def command(arguments: Namespace) -> None:
    from cellslam.benchmarks.figures.sweep.sweep_data import CurveChoice
    from cellslam.benchmarks.figures.sweep.sweep_figures import draw_sweep
    from cellslam.benchmarks.sweeps.store import lost_in_words
    from cellslam.benchmarks.trials.output_files import check_folder
    from cellslam.progress_bars import bars

    folder = Path(arguments.folder)
    if folder.is_file():
        _draw_calibration(arguments, folder)
        return
    choice = CurveChoice(arguments.x, arguments.metric, arguments.statistic, arguments.interval / 100)
    out = Path(arguments.out) if arguments.out else folder / "figures"
    check_folder(out)
    with bars(arguments.quiet) as progress:
        written = draw_sweep(folder, out, choice, progress=progress)
    note(arguments, lost_in_words(folder))
    note(arguments, f"{len(written)} files are in {out}: {', '.join(sorted({p.stem for p in written}))}")


def _draw_calibration(arguments: Namespace, file: Path) -> None:
    """Draw the figure of a calibration, as FILE.png and FILE.pdf."""
    from matplotlib.figure import Figure

    from cellslam.benchmarks.figures import style
    from cellslam.benchmarks.figures.trial.array_calibration import draw
    from cellslam.benchmarks.trials.output_files import check_folder
    from cellslam.slam.model.calibration import Calibration

    calibration, out = Calibration.load(file), Path(arguments.out) if arguments.out else file.parent
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    with style.context():
        figure = Figure(layout="constrained")
        if not draw(figure, calibration, calibration.provenance.get("recording", {})):
            raise InputError(f"{file}: no direction was met: there is nothing to draw")
        written = [style.save(figure, out / f"{file.stem}.{kind}") for kind in ("png", "pdf")]
    note(arguments, f"written: {', '.join(map(str, written))}")
