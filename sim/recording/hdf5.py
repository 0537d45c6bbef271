"""Recordings as HDF5 files: one dataset a column, with units; written atomically, checked on reading.

The layout is plain enough for `h5read` of MATLAB and for Julia: 64-bit floats and integers, UTF-8 strings, no
compound types. (MATLAB shows a matrix (T, 6) as 6 x T.) `columns.COLUMNS` is the whole layout.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording import damage, tables
from cellslam.sim.recording.columns import COLUMNS, FORMAT, SCHEMA_VERSION, Column, check_shapes
from cellslam.sim.recording.packing import LEFT_OUT, OFFSET, SCALE, SNAPSHOT, Packed, attributes_of, packed, step_of

Kind = TypeVar("Kind")
# The class of each table, inner ones first.
_TABLES = {
    "odometry_model": tables.OdometryModel,
    "links": tables.Links,
    "sites": tables.Sites,
    "measurements": tables.Measurements,
    "truth/vts": tables.VirtualTransmitters,
    "truth/clock_steps": tables.ClockSteps,
    "truth/vehicles": tables.Vehicles,
    "truth": tables.Truth,
    "reference": tables.Reference,
}
# Those that a recording may lack as a whole, with all that is in them.
_MAY_MISS = ("truth", "truth/clock_steps", "truth/vehicles", "reference")
_KINDS = {"float": "fiu", "int": "iu", "text": "OS"}


def save(columns: Mapping[str, Any], path: Path, pack: bool = False) -> None:
    """Write a recording's columns, by path, to `path`: all or nothing. `pack`: in fewer bytes (`packing`).

    Raises InputError when the folder is missing or cannot be written, or the provenance is not JSON.
    """
    try:
        values = {**columns, "provenance": json.dumps(dict(columns["provenance"]), allow_nan=False)}
    except (TypeError, ValueError) as error:
        raise InputError(f"provenance cannot be written as JSON: {error}") from error
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; create it first")
    if pack:
        values = {name: value for name, value in values.items() if name not in LEFT_OUT}

    def fill(file: h5py.File) -> None:
        file.attrs["format"] = FORMAT
        file.attrs["schema_version"] = SCHEMA_VERSION
        for column in COLUMNS:
            if column.path in values and not _is_absent(column, values[column.path]):
                _write(file, column, values[column.path], step_of(column, values) if pack else None)
        _declare_absent(file, values)

    try:
        damage.write(path, fill)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)})") from error


def load(path: Path, make: Callable[..., Kind], accept_changed: bool = False) -> Kind:
    """Read a file as `make`, which checks it. `accept_changed`: also where it was changed since it was written.

    Raises InputError naming file, table, row and remedy.
    """
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the .h5 file of a recording")
    if not path.is_file():  # a device may have no end
        raise InputError(f"{path}: no such file; 'cellslam record' writes recordings")
    try:
        with damage.opened(path, accept_changed) as file:
            _check_header(file)
            _check_names(file)
            values = _read_all(file)
        return _recording(values, make)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except PermissionError as error:
        raise InputError(f"{path}: no permission to read it") from error
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError, SystemError) as error:
        raise InputError(
            f"{path}: not an HDF5 file, or a truncated one ({_reason(error)}); record or copy it again"
        ) from error


def _write(file: h5py.File, column: Column, value: Any, step: Any) -> None:
    """Write a column; `step`: of its values where it is packed (`packing.step_of`), None where it is not."""
    if column.kind == "text":
        text = value if column.shape == () else np.array(value, dtype=object)
        dataset = file.create_dataset(column.path, data=text, dtype=h5py.string_dtype("utf-8"))
    else:
        array = np.asarray(value, np.int64 if column.kind == "int" else np.float64, order="C")
        stored = Packed(array) if step is None else packed(array, step)
        compressed = array.size > 4096 and (step is None or column.path == SNAPSHOT)
        filters = {"compression": "gzip", "shuffle": True, "fletcher32": True} if compressed else {}
        dataset = file.create_dataset(column.path, data=stored.codes, **filters)
        if stored.scale is not None:
            dataset.attrs[SCALE], dataset.attrs[OFFSET] = stored.scale, stored.offset
    dataset.attrs["unit"] = column.unit
    if column.labels:
        dataset.attrs["columns"] = list(column.labels)


def _is_absent(column: Column, value: Any) -> bool:
    """Return whether a column that may be absent holds nothing: NaN, or -1 for integers, in every row."""
    if not column.absent or len(value) == 0:
        return False
    return bool((np.asarray(value) == -1).all() if column.kind == "int" else np.isnan(value).all())


def _declare_absent(file: h5py.File, values: dict[str, Any]) -> None:
    """Say in each table's attribute `absent` which columns it lacks, and in odometry's which components."""
    for table in sorted({column.table for column in COLUMNS if column.absent and column.table in file}):
        names = [c.path for c in COLUMNS if c.table == table and c.absent and c.path not in file]
        file[table].attrs["absent"] = _names([name.removeprefix(f"{table}/") for name in names])
    components = next(column.labels for column in COLUMNS if column.path == "odometry")
    never = np.isnan(values["odometry"]).all(axis=0)
    file["odometry"].attrs["absent"] = _names([c for c, gone in zip(components, never, strict=True) if gone])


def _names(names: list[str]) -> Any:
    return np.array(names, dtype=h5py.string_dtype("utf-8")) if names else h5py.Empty(h5py.string_dtype("utf-8"))


def _absent_of(file: h5py.File, table: str) -> tuple[str, ...]:
    value = file[table].attrs.get("absent") if table in file else None
    if value is None or isinstance(value, h5py.Empty):
        return ()
    return tuple(_text(name) for name in np.atleast_1d(value))


def _check_header(file: h5py.File) -> None:
    if "format" not in file.attrs or _text(file.attrs["format"]) != FORMAT:
        raise InputError(
            f"not a recording: its attribute 'format' is not '{FORMAT}'; 'cellslam record' writes recordings"
        )
    version = file.attrs.get("schema_version")
    if not isinstance(version, int | np.integer):
        raise InputError("its attribute 'schema_version' is missing or no integer; record it again")
    if version != SCHEMA_VERSION:
        remedy = "update cellslam" if version > SCHEMA_VERSION else "record it again"
        raise InputError(f"schema version {version}, but this cellslam reads version {SCHEMA_VERSION}; {remedy}")


def _check_names(file: h5py.File) -> None:
    """Refuse what the schema does not know: a misspelled optional column must not pass for an absent one."""
    known = {column.path for column in COLUMNS}
    groups = {column.table for column in COLUMNS} | set(_MAY_MISS)
    for path, is_group in _members(file):
        if is_group and path not in groups:
            raise InputError(f"unknown table '{path}'{nearest_name(path, groups - {''})}")
        if not is_group and path not in known:
            raise InputError(f"unknown column '{path}'{nearest_name(path, known)}")
    for column in COLUMNS:
        missing = (whole for whole in _MAY_MISS if whole not in file)
        if column.optional or any(column.path.startswith(f"{whole}/") for whole in missing):
            continue
        table = column.table
        if table and table not in file:
            needed = ", ".join(c.path.removeprefix(f"{table}/") for c in COLUMNS if c.path.startswith(f"{table}/"))
            raise InputError(f"table '{table}' is missing; it needs the columns {needed}")
        declared = column.absent and column.path.removeprefix(f"{table}/") in _absent_of(file, table)
        if column.path not in file and not declared:
            remedy = f", or name it in the attribute 'absent' of '{table}'" if column.absent else ""
            raise InputError(f"column '{column.path}' is missing; expected {column.described}{remedy}")


def _members(group: h5py.Group) -> Iterator[tuple[str, bool]]:
    for name in group:
        path = f"{group.name}/{name}".lstrip("/")
        try:
            member = group[name]
        except KeyError as error:
            raise InputError(f"'{path}' is a broken link; record it again") from error
        yield path, isinstance(member, h5py.Group)
        if isinstance(member, h5py.Group):
            yield from _members(member)


def _read_all(file: h5py.File) -> dict[str, Any]:
    out = {column.path: _read(file[column.path], column) for column in COLUMNS if column.path in file}
    sizes = check_shapes(out)
    for column in COLUMNS:
        if column.absent and column.path not in out and column.table in file:
            shape = tuple(sizes[size] if isinstance(size, str) else size for size in column.shape)
            out[column.path] = np.full(shape, -1, np.int64) if column.kind == "int" else np.full(shape, np.nan)
    return out


def _read(dataset: h5py.Dataset, column: Column) -> Any:
    kind = getattr(dataset, "dtype", None)
    if kind is None or dataset.shape is None or kind.kind not in _KINDS[column.kind]:
        raise InputError(f"column '{column.path}' holds {kind or 'a table'}; write {column.described}")
    unit = dataset.attrs.get("unit")
    if unit is None or _text(unit) != column.unit:
        given = "has no unit" if unit is None else f"has unit '{_text(unit)}'"
        raise InputError(
            f"column '{column.path}' {given}; write it in '{column.unit}' and say so in its attribute 'unit'"
        )
    if column.kind == "text":
        try:
            text = dataset.asstr()[()]
        except (UnicodeDecodeError, TypeError) as error:
            raise InputError(f"column '{column.path}' is no UTF-8 text; write it as UTF-8") from error
        return text if isinstance(text, str) else tuple(text.tolist())
    values = Packed(dataset[()], *attributes_of(dataset))[()]
    return np.asarray(values, np.int64 if column.kind == "int" else np.float64)


def _recording(values: dict[str, Any], make: Callable[..., Kind]) -> Kind:
    own: dict[str, Any] = values | {
        "provenance": _provenance(values["provenance"]), "plane": bool(values.get("plane")),
        "range_scale_std": float(values.get("range_scale_std", 0.0)), "scatterers": bool(values.get("scatterers")),
    }  # fmt: skip
    for table, kind in _TABLES.items():
        inside = {path for path in own if path.rpartition("/")[0] == table}
        if inside:
            own[table] = kind(**{path.rpartition("/")[2]: own.pop(path) for path in inside})
    return make(**own)


def _provenance(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"provenance is not JSON ({error}); write a JSON object, '{{}}' if there is none") from error
    if not isinstance(value, dict):
        raise InputError("provenance is not a JSON object; write '{}' if there is none")
    return value


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    return str(error).splitlines()[0] if str(error) else type(error).__name__
