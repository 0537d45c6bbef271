"""How these campaigns' HDF5 files are laid out; and `tui.toml`: what the files do not say, asked of the user.

Value times `UnitScaler` is in `BaseUnit`; every dimension has a label, and the scales of a dimension lie in
`MetaData/LABEL`; complex numbers are compounds of `real` and `imag`. Source: TU Ilmenau, Electronic Measurements and
Signal Processing group, basic data specification, https://ems-tu-ilmenau.github.io, docu/basicdataspecs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from cellslam.recordings.importing.manifest import Table, read_tables
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording import Floats
from cellslam.sim.recording.damage import refuse_elsewhere

NAME = "tui.toml"
DEGREES = ("deg", "degree", "degrees", "°")
SI = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "m": 1.0, "Hz": 1.0, "rad": 1.0}
SI |= dict.fromkeys(DEGREES, np.pi / 180.0)
Unit = Literal["s", "ms", "us", "ns", "m", "rad", "deg", "Hz"]


class Container:
    """An open file of a campaign. Raises InputError that names file and path in it."""

    def __init__(self, path: Path, file: Any, units: Mapping[str, str]) -> None:
        self.path, self.file, self.units = path, file, units

    def dataset(self, place: str) -> Any:
        """Return the data set at a path in the file."""
        import h5py

        found = self.file.get(place)
        if not isinstance(found, h5py.Dataset):
            group, _, name = place.rpartition("/")
            known = list(self.file[group]) if group in self.file else list(self.file)
            raise InputError(
                f"{self.path}: has no data set '{place}'{nearest_name(name, known)} (there is: {', '.join(known)})"
            )
        return found

    def factor(self, place: str) -> float:
        """Return what a data set's values times this are in: m, s, Hz or rad."""
        attributes, name = self.dataset(place).attrs, place.rpartition("/")[2]
        if name in self.units:
            return SI[self.units[name]]
        unit, scaler = attributes.get("BaseUnit", ""), attributes.get("UnitScaler")
        unit = (unit.decode() if isinstance(unit, bytes) else str(unit)).strip()
        if not unit or unit not in SI or scaler is None:
            problem = f"its unit is '{unit}'" if unit and scaler is not None else "it states no unit and scale"
            raise InputError(f"{self.path}: {place}: {problem}; write it into the sheet, as in units.{name} = 'deg'")
        return SI[unit] * float(np.ravel(scaler)[0])

    def values(self, place: str) -> Floats:
        """Return a data set of numbers (...,) in m, s, Hz or rad."""
        found = np.asarray(self.dataset(place)[()], np.float64) * self.factor(place)
        return np.asarray(found, np.float64)

    def axes(self, place: str, given: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Return the labels of a data set's dimensions; `given` where it has none."""
        found = self.dataset(place)
        labels = tuple(str(dimension.label) for dimension in found.dims)
        if not all(labels):
            labels = given
        if len(labels) != found.ndim:
            raise InputError(
                f"{self.path}: {place} has {found.ndim} dimensions without labels; name them in the sheet, in order: "
                "axes = ['Tx', 'Rx', 'Frequency', 'Snapshot']"
            )
        return labels

    def ports(self, group: str, label: str) -> list[int]:
        """Return the numbers of the ports of a dimension."""
        return [int(port) for port in np.ravel(self.dataset(f"{group}/MetaData/{label}/AntennaPortID")[()])]


@contextmanager
def opened(path: Path, units: Mapping[str, str]) -> Iterator[Container]:
    """Give a file of a campaign, open for reading. Raises InputError."""
    import h5py

    if not path.is_file():
        raise InputError(f"{path}: no such file; download it, or correct its name in the sheet")
    try:
        with h5py.File(path, "r") as file:
            try:
                refuse_elsewhere(file)
            except InputError as error:
                raise InputError(f"{path}: {error}") from error
            yield Container(path, file, units)
    except OSError as error:
        raise InputError(f"{path}: not an HDF5 file, or a damaged one ({str(error).splitlines()[0]})") from error


def complex_of(values: Any) -> Any:
    """Return complex numbers (...,) of a compound of `real` and `imag`, or of what is complex already."""
    array = np.asarray(values)
    return array["real"] + 1j * array["imag"] if array.dtype.names else array.astype(np.complex128)


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


class Transmitter(Table):
    """[transmitter]: where it stands, which estimators then know: the mean of a log that was made while it stood."""

    file: str = Field("LocationTx.h5", description="from the sheet's folder on")


class Sheet(Table):
    """The whole of `tui.toml`."""

    clock_offset_std_m: float = Field(ge=0, description="deviation of the delays' unknown common offset, m; 0: none")
    plane: bool = Field(False, description="array, sources and reflections lie in one horizontal plane")
    odometry: Literal["none", "simulated"] = Field(description="simulated: from the location, with noise")
    paths: Estimated | None = None
    responses: Responses | None = None
    location: Location | None = None
    transmitter: Transmitter | None = None
    units: dict[str, Unit] = Field(default_factory=dict, description="unit by data set, where a file states none")


def load_sheet(folder: Path) -> Sheet:
    """Return the sheet of a folder. Raises InputError."""
    path = folder / NAME
    if not path.is_file():
        raise InputError(f"{path}: no such file; write what the files do not say (docs/reference/data/tui.md)")
    sheet = read_tables(path, Sheet)
    if (sheet.paths is None) == (sheet.responses is None):
        raise InputError(f"{path}: give one of [paths] and [responses]: what the measurements are made of")
    if sheet.odometry == "simulated" and (sheet.location is None or sheet.location.yaw is None):
        raise InputError(f"{path}: odometry = 'simulated' needs [location] with its yaw")
    if sheet.transmitter is not None and sheet.location is None:
        raise InputError(f"{path}: [transmitter] needs [location]: without it the start of the drive is unknown")
    return sheet
