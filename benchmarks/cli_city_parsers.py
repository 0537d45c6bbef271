"""The arguments of `cellslam city` and `cellslam bench`; light, as every start of the command line loads them."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable

from cellslam.benchmarks.cli_fastslam_parsers import add_fastslam
from cellslam.benchmarks.cli_front_end_parsers import add_front_end

Add = Callable[[str, str, str], argparse.ArgumentParser]

MESH_HELP = "mesh, CityJSON, OpenStreetMap or Mitsuba file, sionna-rt:NAME, a preset's name, or a scenario's .toml"


def add_city(add: Add) -> None:
    """Add `inspect`, `generate` and `trace`; `add(name, target, summary)` makes a sub-command's parser."""
    inspect = add("inspect", "cli_city:inspect", "what a city consists of, and pictures of it")
    inspect.add_argument("mesh", metavar="FILE", help=MESH_HELP)
    _add_mesh_options(inspect)
    inspect.add_argument("--out", metavar="DIR", help="folder for the pictures (default: results/city-NAME)")
    inspect.add_argument("--no-figures", action="store_true", help="do not draw pictures")
    inspect.add_argument("--json", action="store_true", help="print the summary as JSON on stdout, nothing else")
    inspect.add_argument("--html", action="store_true", help="also write an interactive page (extra 'report')")
    generate = add("generate", "cli_city:generate", "draw a city, and write it with a scenario that drives in it")
    generate.add_argument("--seed", metavar="S", type=_whole, default=1, help="seed of the city (default: 1)")
    generate.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[], dest="sets",
        help="change one key of the generator, as in open_share=0.8; may be repeated",
    )  # fmt: skip
    generate.add_argument("--out", metavar="DIR", help="folder to write to (default: results/city-SEED)")
    generate.add_argument("--no-figures", action="store_true", help="do not draw pictures")
    _add_trace(add("trace", "cli_city:trace_paths", "all paths from transmitters to receivers, as a table"))


def _add_trace(parser: argparse.ArgumentParser) -> None:
    # What starts with a minus and a digit is a position, no option.
    parser._negative_number_matcher = re.compile(r"-\.?\d")
    parser.add_argument("mesh", metavar="MESH", help=MESH_HELP)
    _add_mesh_options(parser)
    parser.add_argument(
        "--bs", metavar="X,Y,Z", action="append", required=True,
        help="transmitter in metres; may be repeated",
    )  # fmt: skip
    parser.add_argument("--rx", metavar="RX.csv", required=True, help="receivers: columns x,y,z (vx,vy,vz: Doppler)")
    parser.add_argument("--out", metavar="PATHS.csv", required=True, help="the table to write")
    parser.add_argument("--max-order", metavar="N", type=_whole, default=1, help="reflections: 0, 1 or 2 (default: 1)")
    parser.add_argument("--carrier", metavar="HZ", type=float, default=2.66e9, help="carrier in Hz (default: 2.66e9)")
    parser.add_argument("--ground", action="store_true", help="let the ground reflect too")
    parser.add_argument("--diffraction", action="store_true", help="add single diffractions at roof edges and corners")
    parser.add_argument("--plan", metavar="FILE.png", help="draw the rays on the plan")
    parser.add_argument("--view", metavar="FILE.png", help="draw the rays in a view from above")
    parser.add_argument("--html", metavar="FILE.html", help="write an interactive page (extra 'report')")


def add_bench(add: Add) -> None:
    """Add the benches of parts; `add(name, target, summary)` makes a sub-command's parser."""
    add_front_end(add)
    add_fastslam(add)
    rays = add("rays", "cli_bench_rays:rays", "time the ray tracer, beside Sionna RT and DiffeRT where installed")
    rays.add_argument("--mesh", metavar="FILE", default="sionna-rt:munich", help="city (default: sionna-rt:munich)")
    rays.add_argument(
        "--receivers", metavar="N,N,...", default="100,1000,6850,100000", help="numbers of receivers to time"
    )
    rays.add_argument("--transmitters", metavar="N,N,...", default="1,12", help="numbers of transmitters to time")
    rays.add_argument("--max-order", metavar="N", type=_whole, default=1, help="reflections: 0, 1 or 2 (default: 1)")
    rays.add_argument("--repeat", metavar="N", type=_whole, default=5, help="runs of each size; the best counts")
    rays.add_argument("--no-peers", action="store_true", help="leave Sionna RT and DiffeRT out")
    rays.add_argument(
        "--peer-receivers", metavar="N", type=_whole, default=6850, help="receivers that peers are asked for (6850)"
    )
    rays.add_argument("--json", action="store_true", help="print the rows as JSON on stdout, nothing else")


def _add_mesh_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--material", metavar="NAME", help="ITU-R P.2040 material of surfaces that name none")
    parser.add_argument("--up", choices=("auto", "z", "y"), help="the file's upward axis (default: by its format)")
    parser.add_argument(
        "--plane-tolerance", metavar="M", type=float, dest="plane_tolerance_m",
        help="join triangles whose corners are at most so far from a facet's plane (default: 0.002)",
    )  # fmt: skip
    parser.add_argument(
        "--angle-tolerance", metavar="DEG", type=float, dest="angle_tolerance_deg",
        help="and which are turned from it by at most this angle (default: 1)",
    )  # fmt: skip


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number") from None
