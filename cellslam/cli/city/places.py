"""Cities and tables of positions as the command line names them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.trials.output_files import check_file
from cellslam.scenarios.loading import load, preset_names
from cellslam.sim.city import City, MeshCityConfig, build_city
from cellslam.sim.errors import InputError
from cellslam.sim.rays.paths import Floats, Paths

if TYPE_CHECKING:
    from cellslam.sim.rays.exchange import Traced

COLUMNS, VELOCITIES = ("x", "y", "z"), ("vx", "vy", "vz")
HEAD = "receiver,order,length_m,azimuth_rad,elevation_rad,gain_db,vt_x,vt_y,vt_z,x1,y1,z1,x2,y2,z2,transmitter,edge"


def find_city(name: str, **options: str | float | None) -> City:
    """Return the city of a mesh file, a scene of sionna-rt, a preset or a scenario file. Raises InputError.

    `options`: keys of MeshCityConfig for files that are no scenario; None leaves a key at its default.
    """
    given = {key: value for key, value in options.items() if value is not None}
    if name in preset_names() or name.endswith(".toml"):
        from cellslam.sim.world import city_rng

        if given:
            raise InputError(f"{', '.join(given)}: options of meshes; '{name}' is a scenario, which says it all")
        scenario = load(name)
        return build_city(scenario.city, city_rng(scenario.world, 0, 0))
    return build_city(_mesh_config(name, given), np.random.default_rng(0))


def _mesh_config(name: str, given: dict[str, str | float]) -> MeshCityConfig:
    from pydantic import ValidationError

    try:
        return MeshCityConfig.model_validate({"path": name, **given})
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{'.'.join(map(str, first['loc']))} = {first['input']}: {first['msg']}") from None


def parse_positions(texts: list[str], option: str) -> Floats:
    """Return positions (S, 3) in m written as X,Y,Z. Raises InputError."""
    rows = []
    for text in texts:
        try:
            row = [float(part) for part in text.split(",")]
        except ValueError:
            row = []
        if len(row) != 3 or not np.isfinite(row).all():
            raise InputError(f"{option} '{text}': write X,Y,Z in metres, as in {option}=12.5,-40,25")
        rows.append(row)
    return np.array(rows, np.float64)


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


def write_paths(path: Path, paths: Paths, doppler_hz: Floats | None = None) -> None:
    """Write N paths as CSV, nine decimals, with their Doppler shifts (N,) in Hz. Raises InputError.

    Points that do not exist are empty cells, `edge` is -1 without diffraction.
    """
    rows = [HEAD if doppler_hz is None else f"{HEAD},doppler_hz"]
    numbers = np.column_stack(
        [paths.length_m, paths.azimuth_rad, paths.elevation_rad, paths.gain_db, paths.vt_position_m]
    )
    points = paths.points_m.reshape(-1, 6)
    for index in range(len(paths)):
        values = ",".join(f"{v:.9f}" for v in numbers[index])
        places = ",".join("" if np.isnan(v) else f"{v:.9f}" for v in points[index])
        row = f"{paths.receiver[index]},{paths.order[index]},{values},{places},{paths.transmitter[index]}"
        shift = "" if doppler_hz is None else f",{doppler_hz[index]:.6f}"
        rows.append(f"{row},{paths.edge[index]}{shift}")
    try:
        path.write_text("\n".join(rows) + "\n", "utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


def check_export(path: Path, kind: str) -> None:
    """Raise InputError where paths cannot be written to `path` as "csv", "sionna" or "deepmimo"."""
    if kind == "sionna" and path.suffix != ".npz":
        raise InputError(f"--out {path}: --format sionna writes an .npz; give a name that ends so")
    if kind == "deepmimo" and path.exists():
        raise InputError(f"--out {path}: exists already; give the name of a new folder")
    check_file(path)


def export_paths(path: Path, kind: str, traced: Traced, carrier_hz: float) -> None:
    """Write paths as "sionna" or "deepmimo". Raises InputError."""
    from cellslam.sim.rays.exchange import write_deepmimo, write_sionna

    try:
        (write_sionna if kind == "sionna" else write_deepmimo)(path, traced, carrier_hz)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None
