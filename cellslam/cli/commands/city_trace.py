"""`cellslam city trace`: all paths from transmitters to receivers."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.trials.output_files import check_file, writing
from cellslam.cli.arguments import FLAG, add, whole
from cellslam.cli.cities import add_mesh, add_transmitters, city_of, read_positions, write_pictures
from cellslam.cli.output import note
from cellslam.progress_bars import bars
from cellslam.sim.errors import InputError
from cellslam.sim.rays.exchange import Traced, write_deepmimo, write_sionna

if TYPE_CHECKING:
    from cellslam.sim.rays import Paths
    from cellslam.sim.rays.paths import Floats

EXAMPLES = ("city trace sionna-rt:munich --bs=42,-50,30 --rx rx.csv --out paths.csv",)


def add_arguments(parser: ArgumentParser) -> None:
    add_mesh(parser, "MESH")
    add_transmitters(parser, required=True, help="transmitter in metres; may be repeated")
    parser.add_argument("--rx", metavar="RX.csv", required=True, help="receivers: columns x,y,z (vx,vy,vz: Doppler)")
    add(parser, "--out", metavar="PATHS", required=True, help="the table, .npz or folder to write")
    format_help = "csv: a row a path; sionna: .npz as of Sionna RT; deepmimo: a scenario's folder (default: csv)"
    parser.add_argument("--format", choices=("csv", "sionna", "deepmimo"), default="csv", help=format_help)
    parser.add_argument("--max-order", metavar="N", type=whole, default=1, help="reflections: 0, 1 or 2 (default: 1)")
    parser.add_argument("--carrier", metavar="HZ", type=float, default=2.66e9, help="carrier in Hz (default: 2.66e9)")
    parser.add_argument("--ground", help="let the ground reflect too", **FLAG)
    parser.add_argument("--diffraction", help="add single diffractions at roof edges and corners", **FLAG)
    parser.add_argument("--plan", metavar="FILE.png", help="draw the rays on the plan")
    parser.add_argument("--view", metavar="FILE.png", help="draw the rays in a view from above")
    parser.add_argument("--html", metavar="FILE.html", help="write an interactive page (extra 'report')")


def command(arguments: Namespace) -> None:
    from cellslam.sim.city.inside import OUTSIDE, check_outside, enclosing
    from cellslam.sim.rays import prepare, trace

    out = Path(arguments.out)
    _check_files(arguments, out)
    transmitters = np.array(arguments.bs)
    receivers, velocity = read_positions(Path(arguments.rx))
    with bars(arguments.quiet) as progress:
        with progress("reading the city", 1):
            city = city_of(arguments)
        check_outside(city, transmitters, "--bs: transmitter")
        paths = trace(
            prepare(city), transmitters, receivers, arguments.max_order, carrier_hz=arguments.carrier,
            ground_reflection=arguments.ground, diffraction=arguments.diffraction, progress=progress,
        )  # fmt: skip
        rays = Traced(paths, transmitters, receivers)
        with writing(out):
            if arguments.format == "csv":
                write_csv(out, paths, None if velocity is None else paths.doppler_hz(velocity, arguments.carrier))
            else:
                write = write_sionna if arguments.format == "sionna" else write_deepmimo
                write(out, rays, arguments.carrier)
        write_pictures(city, arguments.plan, arguments.view, arguments.html, rays)
    inside = int(np.count_nonzero(enclosing(city, receivers) != OUTSIDE))
    counts = np.bincount(paths.order[paths.edge < 0], minlength=arguments.max_order + 1)
    kinds = ", ".join(f"{count} of order {order}" for order, count in enumerate(counts))
    kinds += f", {np.count_nonzero(paths.edge >= 0)} diffracted" if arguments.diffraction else ""
    note(arguments, f"{out}: {len(paths)} paths to {len(receivers)} receivers ({kinds})")
    if inside:
        note(arguments, f"note: {inside} of {len(receivers)} receivers are inside buildings or under the ground")


def _check_files(arguments: Namespace, out: Path) -> None:
    """Raise InputError where paths or pictures cannot be written."""
    if arguments.format == "sionna" and out.suffix != ".npz":
        raise InputError(f"--out {out}: --format sionna writes an .npz; give a name that ends so")
    if arguments.format == "deepmimo" and out.exists():
        raise InputError(f"--out {out}: exists already; give the name of a new folder")
    for path in (out, arguments.plan, arguments.view, arguments.html):
        if path:
            check_file(Path(path))
    if arguments.html:
        from cellslam.benchmarks.report.page import check_plotly

        check_plotly()


def write_csv(path: Path, paths: Paths, doppler_hz: Floats | None) -> None:
    """Write N paths as CSV, nine decimals, with their Doppler shifts (N,) in Hz.

    Points that do not exist are empty cells, `edge` is -1 without diffraction.
    """
    import pandas as pd

    columns = {
        "receiver": paths.receiver,
        "order": paths.order,
        "length_m": paths.length_m,
        "azimuth_rad": paths.azimuth_rad,
        "elevation_rad": paths.elevation_rad,
        "gain_db": paths.gain_db,
        **dict(zip(("vt_x", "vt_y", "vt_z"), paths.vt_position_m.T, strict=True)),
        **dict(zip(("x1", "y1", "z1", "x2", "y2", "z2"), paths.points_m.reshape(-1, 6).T, strict=True)),
        "transmitter": paths.transmitter,
        "edge": paths.edge,
    }
    if doppler_hz is not None:
        columns["doppler_hz"] = np.char.mod("%.6f", doppler_hz)
    pd.DataFrame(columns).to_csv(path, index=False, float_format="%.9f")
