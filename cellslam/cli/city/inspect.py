"""`cellslam city inspect`: what a city consists of."""

from __future__ import annotations

import dataclasses
import json
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

import numpy as np

from cellslam.benchmarks.trials.output_files import check_folder, file_name
from cellslam.cli.arguments import DONE
from cellslam.cli.city.places import find_city
from cellslam.cli.city.shared import MESH_HELP, add_mesh_options, mesh_options, note, write_pictures
from cellslam.cli.progress_bars import bars
from cellslam.sim.city.city_summary import Summary, summarise


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("mesh", metavar="FILE", help=MESH_HELP)
    add_mesh_options(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for the pictures (default: results/city-NAME)")
    parser.add_argument("--no-figures", action="store_true", help="do not draw pictures")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON on stdout, nothing else")
    parser.add_argument("--html", action="store_true", help="also write an interactive page (extra 'report')")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam city inspect`."""
    if arguments.html:
        from cellslam.benchmarks.report.page import check_plotly

        check_plotly()
    out = Path(arguments.out or f"results/city-{file_name(Path(arguments.mesh).name.partition('.')[0])}")
    draws = arguments.html or not arguments.no_figures
    if draws:
        check_folder(out)
    with bars(arguments.quiet) as progress, progress("reading the city", 1):
        city = find_city(arguments.mesh, **mesh_options(arguments))
    summary = summarise(city)
    sys.stdout.write(_json(summary) if arguments.json else "\n".join(summary.lines()) + "\n")
    sys.stdout.flush()
    if draws:
        written = write_pictures(city, out, plain=not arguments.no_figures, html=arguments.html)
        note(arguments, f"pictures: {', '.join(map(str, written))}")
    return DONE


def _json(summary: Summary) -> str:
    plain = {
        key: value.tolist() if isinstance(value, np.ndarray) else value
        for key, value in dataclasses.asdict(summary).items()
    }
    return json.dumps(plain, indent=1) + "\n"
