"""`cellslam city trace`: all paths from transmitters to receivers."""

from __future__ import annotations

import re
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.cli.arguments import DONE, whole
from cellslam.cli.city.places import check_export, export_paths, find_city, parse_positions, read_positions, write_paths
from cellslam.cli.city.shared import MESH_HELP, add_mesh_options, mesh_options, note
from cellslam.cli.progress_bars import bars
from cellslam.sim.city import City

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths
    from cellslam.sim.rays.paths import Floats


def add_arguments(parser: ArgumentParser) -> None:
    """Add the arguments of this command."""
    # What starts with a minus and a digit is a position, no option.
    parser._negative_number_matcher = re.compile(r"-\.?\d")
    parser.add_argument("mesh", metavar="MESH", help=MESH_HELP)
    add_mesh_options(parser)
    parser.add_argument(
        "--bs", metavar="X,Y,Z", action="append", required=True,
        help="transmitter in metres; may be repeated",
    )  # fmt: skip
    parser.add_argument("--rx", metavar="RX.csv", required=True, help="receivers: columns x,y,z (vx,vy,vz: Doppler)")
    parser.add_argument("--out", metavar="PATHS", required=True, help="the table, .npz or folder to write")
    format_help = "csv: a row a path; sionna: .npz as of Sionna RT; deepmimo: a scenario's folder (default: csv)"
    parser.add_argument("--format", choices=("csv", "sionna", "deepmimo"), default="csv", help=format_help)
    parser.add_argument("--max-order", metavar="N", type=whole, default=1, help="reflections: 0, 1 or 2 (default: 1)")
    parser.add_argument("--carrier", metavar="HZ", type=float, default=2.66e9, help="carrier in Hz (default: 2.66e9)")
    parser.add_argument("--ground", action="store_true", help="let the ground reflect too")
    parser.add_argument("--diffraction", action="store_true", help="add single diffractions at roof edges and corners")
    parser.add_argument("--plan", metavar="FILE.png", help="draw the rays on the plan")
    parser.add_argument("--view", metavar="FILE.png", help="draw the rays in a view from above")
    parser.add_argument("--html", metavar="FILE.html", help="write an interactive page (extra 'report')")


def command(arguments: Namespace) -> int:
    """Carry out `cellslam city trace`."""
    from cellslam.sim.city.inside import OUTSIDE, check_outside, enclosing
    from cellslam.sim.rays import prepare, trace
    from cellslam.sim.rays.exchange import Traced

    pictures = [Path(p) for p in (arguments.plan, arguments.view, arguments.html) if p]
    check_export(Path(arguments.out), arguments.format)
    for path in pictures:
        check_file(path)
    if arguments.html:
        from cellslam.benchmarks.report.page import check_plotly

        check_plotly()
    transmitters = parse_positions(arguments.bs, "--bs")
    receivers, velocity = read_positions(Path(arguments.rx))
    with bars(arguments.quiet) as progress:
        with progress("reading the city", 1):
            city = find_city(arguments.mesh, **mesh_options(arguments))
        check_outside(city, transmitters, "--bs: transmitter")
        scene = prepare(city)
        paths = trace(
            scene, transmitters, receivers, arguments.max_order, carrier_hz=arguments.carrier,
            ground_reflection=arguments.ground, diffraction=arguments.diffraction, progress=progress,
        )  # fmt: skip
        doppler = None if velocity is None else paths.doppler_hz(velocity, arguments.carrier)
        if arguments.format == "csv":
            write_paths(Path(arguments.out), paths, doppler)
        else:
            traced = Traced(paths, transmitters, receivers)
            export_paths(Path(arguments.out), arguments.format, traced, arguments.carrier)
        _draw(arguments, city, paths, transmitters, receivers)
    inside = int(np.count_nonzero(enclosing(city, receivers) != OUTSIDE))
    counts = np.bincount(paths.order[paths.edge < 0], minlength=arguments.max_order + 1)
    kinds = ", ".join(f"{count} of order {order}" for order, count in enumerate(counts))
    kinds += f", {np.count_nonzero(paths.edge >= 0)} diffracted" if arguments.diffraction else ""
    note(arguments, f"{arguments.out}: {len(paths)} paths to {len(receivers)} receivers ({kinds})")
    if inside:
        note(arguments, f"note: {inside} of {len(receivers)} receivers are inside buildings or under the ground")
    return DONE


def _draw(arguments: Namespace, city: City, paths: Paths, transmitters: Floats, receivers: Floats) -> None:
    if arguments.plan or arguments.view:
        from cellslam.benchmarks.figures.city_pictures import draw_plan, draw_view

        for path, draw in ((arguments.plan, draw_plan), (arguments.view, draw_view)):
            if path:
                draw(Path(path), city, paths, transmitters, receivers)
    if arguments.html:
        from cellslam.benchmarks.report.city_page import write_city

        write_city(Path(arguments.html), city, paths, transmitters, receivers)
