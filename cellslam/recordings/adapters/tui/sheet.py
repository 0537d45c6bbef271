"""`tui.toml`: what the files of a campaign do not say, asked of the user."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from cellslam.scenarios.keys import validate
from cellslam.sim.errors import InputError

NAME = "tui.toml"
Unit = Literal["s", "ms", "us", "ns", "m", "rad", "deg", "Hz"]


class Table(BaseModel):
    """What all tables of the sheet share."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Turned(Table):
    """How their angle becomes ours: ours = zero_deg + sign * theirs."""

    sign: Literal[1, -1] = Field(description="-1: theirs grows the other way (clockwise, co-elevation)")
    zero_deg: float = Field(description="our angle where theirs is zero, deg")


class Angle(Turned):
    """An angle in a data set."""

    dataset: str = Field(description="name of the data set that holds it")


class Estimated(Table):
    """[paths]: paths that the authors have estimated, a list a snapshot."""

    file: str = Field(description="Results_*.h5, from the sheet's folder on")
    delay: str = Field("Delay", description="data set of the delays")
    azimuth: Angle | None = Field(None, description="azimuth of arrival, in the vehicle's frame")
    elevation: Angle | None = Field(None, description="elevation of arrival; a co-elevation has sign -1 and zero 90")


class Responses(Table):
    """[responses]: frequency responses, in which our own estimator looks for paths."""

    file: str = Field("FrequencyResponses.h5", description="from the sheet's folder on")
    array: str = Field(description="file with the patterns of the receiving array, as ../../ArrayData/ArrayRx.h5")
    array_azimuth: Turned = Field(description="azimuth in the vehicle's frame from that of the patterns")
    tx_ports: tuple[int, ...] = Field(min_length=1, description="AntennaPortIDs to send from; each is a link")
    port_interval_s: float = Field(ge=0, description="time from one receiving port to the next, as filed; 0: at once")
    every: int = Field(1, ge=1, description="take one snapshot of so many")
    axes: tuple[str, ...] = Field((), description="names of Data's dimensions, where the file has none")


class Location(Table):
    """[location]: where the array was."""

    file: str = Field("LocationRx.h5", description="from the sheet's folder on")
    yaw: Angle | None = Field(None, description="yaw of the vehicle, counter-clockwise from east")
    std_m: float | None = Field(None, gt=0, description="deviation of its positions, m")
    crs: str = Field("", description="where to project latitude and longitude to; empty: their UTM zone")


class Sheet(Table):
    """The whole of `tui.toml`."""

    clock_offset_std_m: float = Field(ge=0, description="deviation of the delays' unknown common offset, m; 0: none")
    plane: bool = Field(False, description="array, sources and reflections lie in one horizontal plane")
    odometry: Literal["none", "simulated"] = Field(description="simulated: from the location, with noise")
    paths: Estimated | None = None
    responses: Responses | None = None
    location: Location | None = None
    units: dict[str, Unit] = Field(default_factory=dict, description="unit by data set, where a file states none")


def load_sheet(folder: Path) -> Sheet:
    """Return the sheet of a folder. Raises InputError with file, key, value and what is allowed."""
    path = folder / NAME
    if not path.is_file():
        raise InputError(f"{path}: no such file; write what the files do not say (docs/reference/data/tui.md)")
    try:
        sheet = validate(Sheet, tomllib.loads(path.read_text("utf-8")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not TOML ({error}); correct it there") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if (sheet.paths is None) == (sheet.responses is None):
        raise InputError(f"{path}: give one of [paths] and [responses]: what the measurements are made of")
    if sheet.odometry == "simulated" and (sheet.location is None or sheet.location.yaw is None):
        raise InputError(f"{path}: odometry = 'simulated' needs [location] with its yaw")
    return sheet
