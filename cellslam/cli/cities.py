"""Cities and tables of positions as the command line names them, and pictures of a city."""

from __future__ import annotations

import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.cli.arguments import REPEATED
from cellslam.cli.output import note
from cellslam.scenarios.keys import validate
from cellslam.scenarios.loading import load, preset_names
from cellslam.sim.city import City, MeshCityConfig, build_city
from cellslam.sim.errors import InputError
from cellslam.sim.rays.paths import Floats

if TYPE_CHECKING:
    from cellslam.sim.rays.exchange import Traced
    from cellslam.sim.vehicle.route import Route
    from cellslam.sim.world import WorldConfig

COLUMNS, VELOCITIES = ("x", "y", "z"), ("vx", "vy", "vz")
MESH_HELP = "mesh, CityJSON, OpenStreetMap or Mitsuba file, sionna-rt:NAME, a preset's name, or a scenario's .toml"
STREET_M, OFF_STREETS = 15.0, 0.05  # so far from its middle one is on no street; of a route this share is remarked on
SHIPPED = "sionna-rt:"  # cities of that package
MESH_OPTIONS = ("material", "up", "plane_tolerance_m", "angle_tolerance_deg")


def add_mesh(parser: ArgumentParser, metavar: str) -> None:
    """Add a city, and how a mesh file of one is read."""
    parser.add_argument("mesh", metavar=metavar, help=MESH_HELP)
    parser.add_argument("--material", metavar="NAME", help="ITU-R P.2040 material of surfaces that name none")
    parser.add_argument("--up", choices=("auto", "z", "y"), help="the file's upward axis (default: by its format)")
    plane, angle = MESH_OPTIONS[2:]
    plane_help = "join triangles whose corners lie within this distance of a facet's plane, in m (default: 0.002)"
    parser.add_argument("--plane-tolerance", metavar="M", type=float, dest=plane, help=plane_help)
    angle_help = "and which are turned from it by at most this angle (default: 1)"
    parser.add_argument("--angle-tolerance", metavar="DEG", type=float, dest=angle, help=angle_help)


def city_of(arguments: Namespace) -> City:
    """Return the city that was asked for. Raises InputError."""
    return find_city(arguments.mesh, **{key: getattr(arguments, key) for key in MESH_OPTIONS})


def find_city(name: str, **options: Any) -> City:
    """Return the city of a mesh file, a scene of sionna-rt, a preset or a scenario file. Raises InputError.

    `options`: keys of MeshCityConfig for files that are no scenario; None leaves a key at its default.
    """
    given = {key: value for key, value in options.items() if value is not None}
    if name in preset_names() or name.endswith(".toml"):
        from cellslam.sim.world import city_rng

        if given:
            raise InputError(f"{', '.join(given)}: options of meshes; '{name}' is a scenario, which says it all")
        scenario = load(name, code=False)
        return build_city(scenario.city, city_rng(scenario.world, 0, 0))
    return build_city(validate(MeshCityConfig, {"path": name, **given}), np.random.default_rng(0))


def note_oddities(arguments: Namespace, city: City, route: Route) -> None:
    """Say on stderr, unless --quiet, what was odd about a city's file, and a route of which a part is on no street."""
    import shapely

    for remark in city.notes:
        note(arguments, f"note: {remark}")
    if city.streets:
        away = shapely.distance(shapely.points(route.points_m), shapely.MultiLineString(list(city.streets))) > STREET_M
        if (share := float(away.mean())) > OFF_STREETS:
            x, y = route.points_m[int(np.argmax(away))]
            where = f"more than {STREET_M:g} m from every street, first at ({x:.0f}, {y:.0f})"
            note(arguments, f"note: {100 * share:.0f} % of the route are {where}: is it of this city?")


def note_own_city(arguments: Namespace, world: WorldConfig, seed: int = 0, trial: int = 0) -> None:
    """Say on stderr, unless --quiet, what is odd about a city of the user's own and the route in it.

    Where a scenario has no file of a city none is built. Raises InputError where there is no such city or route.
    """
    from cellslam.sim.world import city_and_route

    if world.city.kind == "mesh" and not world.city.path.startswith(SHIPPED):
        scene, route = city_and_route(world, seed, trial)
        note_oddities(arguments, scene.city, route)


def add_transmitters(parser: ArgumentParser, **more: Any) -> None:
    """Add --bs, positions of transmitters; what starts with a minus and a digit is a position, not an option."""
    parser._negative_number_matcher = re.compile(r"-\.?\d")
    parser.add_argument("--bs", metavar="X,Y,Z", type=_position, **REPEATED | more)


def _position(text: str) -> tuple[float, ...]:
    """Return x, y, z in m. Raises ArgumentTypeError."""
    try:
        position = tuple(float(part) for part in text.split(","))
    except ValueError:
        position = ()
    if len(position) != 3 or not np.isfinite(position).all():
        raise ArgumentTypeError(f"'{text}': write X,Y,Z in metres, as in --bs=12.5,-40,25")
    return position


def read_positions(path: Path) -> tuple[Floats, Floats | None]:
    """Return positions (N, 3) in m and, where a CSV file has the columns vx, vy, vz, velocities (N, 3) in m/s.

    Raises InputError.
    """
    import pandas as pd

    try:
        table = pd.read_csv(path, skipinitialspace=True)
    except (OSError, ValueError, pd.errors.ParserError) as error:
        raise InputError(f"cannot read '{path}': {' '.join(str(error).split())[:160]}") from None
    table.columns = [str(name).strip().lower() for name in table.columns]
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(f"'{path}' has no column {', '.join(missing)}: its first line must name x,y,z")
    if not len(table):
        raise InputError(f"'{path}' has no rows: give at least one position")
    names = [*COLUMNS, *VELOCITIES] if set(VELOCITIES) <= set(table.columns) else list(COLUMNS)
    values = np.column_stack([pd.to_numeric(table[name], errors="coerce") for name in names]).astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise InputError(f"'{path}', row {bad[0]}: {', '.join(names)} are not all finite numbers")
    return values[:, :3], values[:, 3:] if len(names) > 3 else None


def write_pictures(
    city: City, plan: str | Path | None, view: str | Path | None, page: str | Path | None, rays: Traced | None = None
) -> list[Path]:
    """Write the plan, the view and the interactive page of a city into the files that are given; return these."""
    from cellslam.benchmarks.figures.city_pictures import draw_plan, draw_view
    from cellslam.benchmarks.report.city_page import write_city

    asked = [(Path(file), draw) for file, draw in ((plan, draw_plan), (view, draw_view), (page, write_city)) if file]
    for file, draw in asked:
        file.parent.mkdir(parents=True, exist_ok=True)
        draw(file, city, rays)
    return [file for file, _ in asked]
