"""`cellslam city inspect`: what a city consists of."""

from __future__ import annotations

import dataclasses
import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

from cellslam.benchmarks.trials.output_files import check_folder, file_name
from cellslam.cli.arguments import FLAG, add
from cellslam.cli.cities import add_mesh, city_of, write_pictures
from cellslam.cli.output import note
from cellslam.progress_bars import bars
from cellslam.sim.city.city_summary import summarise

EXAMPLES = ("city inspect lund-530",)


def add_arguments(parser: ArgumentParser) -> None:
    add_mesh(parser, "FILE")
    add(parser, "--out", help="folder for the pictures (default: results/city-NAME)")
    add(parser, "--no-figures", help="do not draw pictures")
    add(parser, "--json", help="print the summary as JSON on stdout, nothing else")
    parser.add_argument("--html", help="also write an interactive page (extra 'report')", **FLAG)


def command(arguments: Namespace) -> None:
    if arguments.html:
        from cellslam.benchmarks.report.page import check_plotly

        check_plotly()
    out = Path(arguments.out or f"results/city-{file_name(Path(arguments.mesh).name.partition('.')[0])}")
    draws = arguments.html or not arguments.no_figures
    if draws:
        check_folder(out)
    with bars(arguments.quiet) as progress, progress("reading the city", 1):
        city = city_of(arguments)
    summary = summarise(city)
    if arguments.json:
        print(json.dumps(dataclasses.asdict(summary), indent=1, default=lambda array: array.tolist()), flush=True)
    else:
        print("\n".join(summary.lines()), flush=True)
    if draws:
        plan, view = (None, None) if arguments.no_figures else (out / "plan.png", out / "view.png")
        written = write_pictures(city, plan, view, out / "city.html" if arguments.html else None)
        note(arguments, f"pictures: {', '.join(map(str, written))}")
