"""Arguments that the commands of `cellslam city` share."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import Any

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
