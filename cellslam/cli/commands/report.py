"""`cellslam report`: one HTML page of a sweep."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.cli.arguments import FLAG, add, whole
from cellslam.cli.output import note

EXAMPLES = ("report load --out load.html",)


def add_arguments(parser: ArgumentParser) -> None:
    add(parser, "folder")
    add(parser, "--out", metavar="FILE.html", help="the page to write (default: DIR/report.html)")
    parser.add_argument("--worst", metavar="N", type=whole, default=3, help="trials with a section each (default: 3)")
    metric_help = "metric by which trials are the worst (default: position_rmse_m)"
    parser.add_argument("--metric", metavar="NAME", default="position_rmse_m", help=metric_help)
    load_help = (
        "load the code and files that the results name for their worlds, too, to make those of the worst trials again"
    )
    parser.add_argument("--load", help=load_help, **FLAG)
    whose_help = "estimator whose worst trials are shown; may be repeated (default: the one with the best median)"
    add(parser, "--estimator", help=whose_help)


def command(arguments: Namespace) -> None:
    from cellslam.benchmarks.report.page import write_report
    from cellslam.benchmarks.report.worst_trials import Choice, load_code
    from cellslam.benchmarks.sweeps.store import lost_in_words
    from cellslam.progress_bars import bars

    choice = Choice(arguments.worst, arguments.metric, tuple(arguments.estimators))
    folder, out = Path(arguments.folder), Path(arguments.out) if arguments.out else None
    if arguments.load:
        load_code(folder)
    with bars(arguments.quiet) as progress:
        path = write_report(folder, out, choice, progress)
    note(arguments, lost_in_words(folder))
    note(arguments, f"the report is in {path} ({path.stat().st_size / 1e6:.1f} MB)")
