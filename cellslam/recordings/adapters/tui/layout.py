"""The rules by which these campaigns' HDF5 files are laid out: units as attributes, axes by label, complex compounds.

Source: TU Ilmenau, Electronic Measurements and Signal Processing group, basic data specification
(https://ems-tu-ilmenau.github.io, docu/basicdataspecs): value times `UnitScaler` is in `BaseUnit`; every dimension has
a label, and the scales of a dimension lie in `MetaData/LABEL`; complex numbers are compounds of `real` and `imag`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording import Floats

DEGREES = ("deg", "degree", "degrees", "°")
SI = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "m": 1.0, "Hz": 1.0, "rad": 1.0}
SI |= dict.fromkeys(DEGREES, np.pi / 180.0)


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

    def has(self, place: str) -> bool:
        """Return whether there is something at a path in the file."""
        return place in self.file

    def factor(self, place: str) -> float:
        """Return what a data set's values times this are in: m, s, Hz or rad."""
        attributes, name = self.dataset(place).attrs, place.rpartition("/")[2]
        if name in self.units:
            return SI[self.units[name]]
        unit, scaler = attributes.get("BaseUnit", ""), attributes.get("UnitScaler")
        unit = (unit.decode() if isinstance(unit, bytes) else str(unit)).strip()
        if not unit or unit not in SI or scaler is None:
            said = f"its unit is '{unit}'" if unit and scaler is not None else "it states no unit and scale"
            raise InputError(f"{self.path}: {place}: {said}; say it in the sheet, as in units.{name} = 'deg'")
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

    def scale(self, group: str, label: str, name: str) -> str:
        """Return the path of a scale of a dimension."""
        return f"{group}/MetaData/{label}/{name}"


@contextmanager
def opened(path: Path, units: Mapping[str, str]) -> Iterator[Container]:
    """Give a file of a campaign, open for reading. Raises InputError."""
    import h5py

    if not path.is_file():
        raise InputError(f"{path}: no such file; download it, or correct its name in the sheet")
    try:
        with h5py.File(path, "r") as file:
            yield Container(path, file, units)
    except OSError as error:
        raise InputError(f"{path}: not an HDF5 file, or a damaged one ({str(error).splitlines()[0]})") from error


def complex_of(values: Any) -> Any:
    """Return complex numbers (...,) of a compound of `real` and `imag`, or of what is complex already."""
    array = np.asarray(values)
    return array["real"] + 1j * array["imag"] if array.dtype.names else array.astype(np.complex128)
