"""What the commands of `cellslam city` share: how a mesh is read, pictures of a city, notes on stderr."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

from cellslam.sim.city import City

MESH_HELP = "mesh, CityJSON, OpenStreetMap or Mitsuba file, sionna-rt:NAME, a preset's name, or a scenario's .toml"


def add_mesh_options(parser: ArgumentParser) -> None:
    """Add how a mesh file is read."""
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


def mesh_options(arguments: Namespace) -> dict[str, Any]:
    """Return what was asked for of them."""
    return {key: getattr(arguments, key) for key in ("material", "up", "plane_tolerance_m", "angle_tolerance_deg")}


def write_pictures(city: City, out: Path, plain: bool, html: bool) -> list[Path]:
    """Write the plan and the view of a city, or its interactive page, into `out`; return the files."""
    from cellslam.benchmarks.figures.city_pictures import draw_plan, draw_view

    out.mkdir(parents=True, exist_ok=True)
    written = []
    if plain:
        written = [out / "plan.png", out / "view.png"]
        draw_plan(written[0], city)
        draw_view(written[1], city)
    if html:
        from cellslam.benchmarks.report.city_page import write_city

        written.append(out / "city.html")
        write_city(written[-1], city)
    return written


def note(arguments: Namespace, text: str) -> None:
    """Say something on stderr, unless --quiet."""
    if not arguments.quiet:
        sys.stderr.write(f"{text}\n")
