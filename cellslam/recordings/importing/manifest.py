"""`recording.toml`: which files a campaign consists of, and the units, signs, axes and clocks of their columns."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from cellslam.recordings.importing.campaign import RANGE_SCALE_STD
from cellslam.scenarios.keys import validate
from cellslam.sim.data_files import text_of, toml_of
from cellslam.sim.errors import InputError

COMMANDS = "commands"  # how a data sheet calls what is no component of the odometry
NAME = "recording.toml"
Triple = tuple[float, float, float]
Tables = TypeVar("Tables", bound=BaseModel)


class Table(BaseModel):
    """What all tables share."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Column(Table):
    """One column: ours = zero + sign * theirs, in `unit`."""

    column: str = Field(description="its name in the header or in the .mat file; without names its number")
    unit: str = Field(description="unit of the column; of a delay s, ns or samples, too")
    sign: Literal[1, -1] = Field(1, description="-1: the column grows the other way (clockwise angles, downward axes)")
    zero: float = Field(0.0, description="our value where the column says 0, in the unit of the column")


class LinkColumn(Table):
    """The column that tells the links apart."""

    column: str = Field(description="name of the column; each value in it is one link")


class Clock(Table):
    """A time base: time of the recording = offset_s + (1 + drift_ppm / 1e6) * time of the table."""

    offset_s: float = Field(0.0, description="what to add to the table's times, s")
    drift_ppm: float = Field(
        0.0, ge=-1e4, le=1e4, description="how much slower than the recording's this clock runs, ppm"
    )


class FileTable(Table):
    """A table in a file of the folder, and which of its columns are ours."""

    columns: dict[str, Column] = Field(description="time_s and what else there is, by our names")
    file: str = Field(description="file in the folder: .csv, .txt, .tsv, .dat or .mat")
    variable: str = Field("", description="struct or matrix of the .mat file with the columns; empty: the file itself")
    delimiter: str = Field(
        "", max_length=1, description="what separates the columns of a text file; empty: comma, semicolon, tab or "
        "white space, as its first line has it",
    )  # fmt: skip
    clock: str = Field("", description="name of one of [clocks]; empty: the recording's own")


class PathTable(FileTable):
    """[measurements]"""

    link: LinkColumn | None = Field(None, description="the column that tells links apart; none: one link")
    sample_rate_hz: float | None = Field(None, gt=0, description="for delays in samples, Hz")
    std: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default_factory=dict, description="deviations of all rows: distance_m, azimuth_deg, elevation_deg"
    )


class Noise(Table):
    """Deviations of one odometry component, in m/s or rad/s."""

    noise_density: float = Field(0.0, ge=0, description="white noise, unit * sqrt(s)")
    bias: float = Field(0.0, ge=0, description="constant error, unit")
    bias_walk_density: float = Field(0.0, ge=0, description="how the bias walks, unit / sqrt(s)")
    scale: float = Field(0.0, ge=0, le=1, description="error of scale, share")


class Commands(Table):
    """How the vehicle follows what it is commanded."""

    time_constant_s: float = Field(ge=0, le=10, description="with which the vehicle follows commands, s; 0: not known")


class DriveTable(FileTable):
    """[odometry]"""

    kind: Literal["velocities", "poses"] = Field(
        "velocities", description="poses: x_m, y_m, z_m, yaw_rad, pitch_rad, roll_rad in a frame of the odometry's own"
    )
    hold: Literal["next", "before", "linear"] = Field(
        "next", description="a row is valid until the next row, since the row before, or in between interpolate"
    )
    valid_s: float | None = Field(
        None, gt=0, description="how long a row is valid at most, s; inf: for ever, as commands are; none: five times "
        "the median interval",
    )  # fmt: skip
    time_constant_s: float | None = Field(
        None, ge=0, le=10, description="these are commands, which the vehicle follows with it, s; 0: not known; none: "
        "they are measured, or, where valid_s is inf, 0",
    )  # fmt: skip
    axes: Literal["forward-left-up", "forward-right-down"] = Field("forward-left-up", description="axes of the body")
    lever_arm_m: Triple = Field((0.0, 0.0, 0.0), description="where the antenna is, from the point that is measured, m")


class ReferenceFile(FileTable):
    """[reference]"""

    axes: Literal["east-north-up", "north-east-down"] = Field("east-north-up", description="axes of x, y, z")
    crs: str = Field("", description="where to project latitude and longitude to, as EPSG:32633; empty: their UTM zone")
    origin_m: tuple[float, float] | None = Field(None, description="taken off projected positions; none: the first fix")
    lever_arm_m: Triple = Field((0.0, 0.0, 0.0), description="where the antenna array is, from the GNSS antenna, m")
    std_m: float | None = Field(None, gt=0, description="deviation of all positions, m; none: unknown")


class Link(Table):
    """[links.VALUE]: one value of the link column."""

    site: str = Field(description="name of the site")
    cell_id: int = Field(-1, ge=-1, description="cell identity; -1: none")
    port: int = Field(-1, ge=-1, description="antenna port; -1: none")
    azimuth_deg: float | None = Field(
        None, description="where the sector's antenna points, counter-clockwise from east, deg; none: not known"
    )


class Site(Table):
    """[sites.NAME]"""

    clock_offset_mean_m: float = Field(0.0, description="expected clock offset times the speed of light, m")
    clock_offset_std_m: float = Field(ge=0, description="its deviation, m; 0: synchronised")
    clock_drift_std_m_s: float = Field(0.0, ge=0, description="deviation of its rate, m/s; 0: the offset is constant")
    clock_walk_m_sqrt_s: float = Field(0.0, ge=0, description="density of the offset's random walk, m/sqrt(s)")
    clock_drift_walk_m_s_sqrt_s: float = Field(0.0, ge=0, description="density of the rate's walk, (m/s)/sqrt(s)")
    clock_step_std_m: float = Field(0.0, ge=0, description="deviation of steps at unknown times, m; 0: none")
    position_m: Triple | None = Field(
        None, description="where its antenna was surveyed to stand, x, y, z in the world frame, m; none: not known"
    )
    position_std_m: Triple = Field((0.0, 0.0, 0.0), description="deviations of the survey in x, y, z, m; 0: exact")


class Start(Table):
    """[start]"""

    source: Literal["given", "reference", "origin"] = Field(
        description="given here, taken from the reference, or the origin of the world frame"
    )
    position_m: Triple = Field((0.0, 0.0, 0.0), description="x, y, z of the antenna, m")
    yaw_deg: float = Field(0.0, description="counter-clockwise from east, deg")
    pitch_deg: float = Field(0.0, description="nose down positive, deg")
    roll_deg: float = Field(0.0, description="deg")
    std_m: Triple | None = Field(
        None, description="deviations of x, y, z, m; none: as the reference has them, 0 where the pose is given"
    )
    std_deg: Triple | None = Field(None, description="deviations of yaw, pitch, roll, deg; none: likewise")


class Manifest(Table):
    """The whole of `recording.toml`."""

    description: str = Field("", description="what, where, when, by whom")
    plane: bool = Field(False, description="array, sources and reflections lie in one horizontal plane")
    range_scale_std: float = Field(
        RANGE_SCALE_STD, ge=0, le=0.5, description="deviation of the scale by which all distances may be measured too "
        "long; 0: it is known to be right",
    )  # fmt: skip
    scatterers: bool = Field(
        True, description="whether points may scatter paths, beside walls that mirror them; false: each path comes "
        "straight from where it seems to, as of landmarks, or over walls",
    )  # fmt: skip
    measurements: PathTable
    start: Start
    snapshots: FileTable | None = None
    odometry: DriveTable | None = None
    reference: ReferenceFile | None = None
    clocks: dict[str, Clock] = Field(default_factory=dict)
    links: dict[str, Link] = Field(default_factory=dict)
    sites: dict[str, Site] = Field(default_factory=dict)
    noise: dict[str, Noise] = Field(
        default_factory=dict,
        description="data sheet by component; of one that is not measured: how the vehicle moves so",
    )


def load_manifest(folder: Path) -> Manifest:
    """Return the manifest of a folder. Raises InputError."""
    path = folder / NAME
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder that holds {NAME} and its tables")
    if not path.is_file():
        raise InputError(
            f"{path}: no such file; write one (docs/reference/campaign-tables.md), or name an adapter: --adapter"
        )
    return read_tables(path, Manifest)


def files_outside(folder: Path, tables: Any) -> list[str]:
    """Return the files that the tables of a manifest or sheet name, as they name them, that lie outside its folder."""
    if not isinstance(tables, Mapping):
        return []
    found = [name for key, name in tables.items() if key in ("file", "array") and isinstance(name, str)]
    outside = [name for name in found if not (folder / name).resolve().is_relative_to(folder.resolve())]
    return [*outside, *(name for inner in tables.values() for name in files_outside(folder, inner))]


def tables_of(path: Path) -> dict[str, Any]:
    """Return a TOML file as plain tables. Raises InputError."""
    try:
        return toml_of(text_of(path))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not TOML ({error}); correct it there") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def read_tables(path: Path, model: type[Tables]) -> Tables:
    """Return a TOML file as a model. Raises InputError with file, key, value and what is allowed."""
    tables = tables_of(path)
    try:
        return validate(model, tables)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
