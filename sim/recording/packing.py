"""Columns in fewer bytes, for sets of drives: as fine as each is measured, and mapped into memory instead of read.

value = add_offset + scale_factor * code, code 0 for NaN: the attributes are those of the CF conventions.

A code has one byte, or two, where equal steps as fine as `step_of` says fit into it; otherwise the values are 32-bit
floats where these are as fine, and stay as they are where not. Integers are as narrow as they fit. What is left out and
what is lost: docs/how-to/training-sets.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.recording import damage
from cellslam.sim.recording.columns import COLUMNS, Column

SHARE_OF_STD, SHARE_OF_CLAIM = 0.1, 0.03  # steps of what is measured, and of the deviations that are claimed of it
# Steps of other values, by unit; where there is none, values keep all their digits.
STEPS = {"m": 1e-3, "rad": 1e-5, "m/s": 1e-4, "rad/s": 1e-5, "dB": 0.25}
SMALL = 256  # values: fewer are written as they are
# Of these the first follows from the world, the others are only of worth with all digits.
LEFT_OUT = ("truth/persisting_std", "truth/merging_shift", "truth/measurement_std")
SNAPSHOT = "measurements/snapshot"  # compressed: it is read whole, as the first row of each snapshot
SCALE, OFFSET = "scale_factor", "add_offset"
_NUMBERS = {column.path for column in COLUMNS if column.kind != "text"}
_TABLES = {column.table for column in COLUMNS}


@dataclass(frozen=True)
class Packed:
    """A column as it lies in a file: `codes` (N, ...), and the floats or (k,) arrays that make values of them."""

    codes: NDArray[Any]
    scale: Any = None
    offset: Any = None

    def __getitem__(self, rows: Any) -> NDArray[Any]:
        """Return the values of some rows: floats where they were packed, otherwise what is stored."""
        codes: NDArray[Any] = self.codes[rows]
        if self.scale is None:
            return codes
        return np.asarray(np.where(codes == 0, np.nan, self.offset + self.scale * codes.astype(np.float64)))


def step_of(column: Column, values: Mapping[str, Any]) -> Any:
    """Return how far apart two values of a column may lie that are stored as neighbours: one number, or one for each
    part of a row; 0: all digits stay.
    """
    name, unit = column.path.removesuffix("_m").removesuffix("_rad"), column.unit
    claimed = values.get(f"{name}_std_{unit}")
    if claimed is not None:
        return SHARE_OF_STD * _least(claimed)
    if column.rule == "claim":
        return SHARE_OF_CLAIM * _least(values[column.path])
    units = unit.split(", ")
    width = int(column.shape[-1]) // len(units) if len(units) > 1 else 1
    steps = np.repeat([STEPS.get(one, 0.0) for one in units], width)
    return steps if len(units) > 1 else steps[0]


def packed(array: NDArray[Any], step: Any) -> Packed:
    """Return a column (N, ...) of floats or integers in as few bytes as a step allows (see `step_of`)."""
    if array.size <= SMALL or np.isinf(array).any():
        return Packed(array)
    if array.dtype.kind == "i":
        kinds = (np.int8, np.int16, np.int32)
        fits = (k for k in kinds if np.iinfo(k).min <= array.min() and array.max() <= np.iinfo(k).max)
        return Packed(array.astype(next(fits, np.int64)))
    known, rows = ~np.isnan(array), tuple(range(max(array.ndim - 1, 1)))
    low, high = np.min(array, rows, initial=np.inf, where=known), np.max(array, rows, initial=-np.inf, where=known)
    low, high = np.where(low > high, 0.0, low), np.where(low > high, 0.0, high)  # of a component that is never known
    for kind in (np.uint8, np.uint16):
        scale = (high - low) / (np.iinfo(kind).max - 1)
        if (scale <= step).all():
            codes = 1.0 + np.rint((array - low) / np.where(scale > 0.0, scale, 1.0))
            return Packed(np.where(known, codes, 0.0).astype(kind), scale, low - scale)
    largest = np.maximum(np.abs(low), np.abs(high))
    if (largest * np.finfo(np.float32).eps > step).any():
        return Packed(array)
    narrow = array.astype(np.float32)
    # Towards zero: an angle of pi must not become larger.
    return Packed(np.where(np.abs(narrow) > np.abs(array), np.nextafter(narrow, np.float32(0.0)), narrow))


def _least(std: NDArray[np.float64]) -> float:
    return float(np.nanmin(std)) if np.isfinite(std).any() else 0.0


def attributes_of(dataset: h5py.Dataset) -> tuple[Any, Any]:
    """Return scale and offset of a data set in a file; None and None where its values are stored as they are."""
    return (dataset.attrs[SCALE], dataset.attrs[OFFSET]) if SCALE in dataset.attrs else (None, None)


def mapped(path: Path) -> dict[str, Packed]:
    """Return the columns of numbers of a recording's file, by path, in memory that the file is mapped to.

    What is compressed is read. The file must be as it was written: its digest is checked, not the contract, which it
    was checked by when it was made. Raises InputError where it is not, OSError where it cannot be read.
    """
    damage.check(path)
    memory = np.asarray(np.memmap(path, np.uint8, "r"))
    with h5py.File(path, "r") as file:
        return dict(_columns(file.id, "", memory))


def _columns(group: Any, table: str, memory: NDArray[np.uint8]) -> Iterator[tuple[str, Packed]]:
    """Yield the columns of numbers in a group; h5py's lower level takes a tenth of the time of the upper one."""
    for k in range(group.get_num_objs()):
        name = group.get_objname_by_idx(k)
        path = f"{table}{name.decode()}"
        if group.links.get_info(name).type != h5py.h5l.TYPE_HARD:
            raise InputError(f"'{path}' is a link into another file; make it again")
        if path in _NUMBERS:
            yield path, _mapped(h5py.h5d.open(group, name), memory)
        elif path in _TABLES:
            yield from _columns(h5py.h5g.open(group, name), f"{path}/", memory)


def _mapped(dataset: Any, memory: NDArray[np.uint8]) -> Packed:
    begin, attributes = dataset.get_offset(), (None, None)
    if h5py.h5a.exists(dataset, SCALE.encode()):
        attributes = attributes_of(h5py.Dataset(dataset))
    if begin is None:
        damage.refuse_elsewhere(h5py.Dataset(dataset))
        return Packed(h5py.Dataset(dataset)[()], *attributes)
    codes = memory[begin : begin + dataset.get_storage_size()].view(dataset.dtype)
    return Packed(codes.reshape(dataset.shape), *attributes)
