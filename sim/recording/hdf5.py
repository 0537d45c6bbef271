"""Recordings as HDF5 files: one dataset a column, with units; written atomically, checked on reading.

The layout is plain enough for `h5read` of MATLAB and for Julia: 64-bit floats and integers, UTF-8 strings, no
compound types. (MATLAB shows a matrix (T, 6) as 6 x T.) `hdf5_layout.COLUMNS` is the whole layout.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np

from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording import damage
from cellslam.sim.recording.hdf5_layout import COLUMNS, FORMAT, SCHEMA_VERSION, TABLES_THAT_MAY_MISS, Column
from cellslam.sim.recording.tables import (
    ClockSteps,
    Links,
    Measurements,
    OdometryModel,
    RecordingData,
    Reference,
    Sites,
    Truth,
    Vehicles,
    VirtualTransmitters,
)

Kind = TypeVar("Kind", bound=RecordingData)
_KINDS = {"float": "fiu", "int": "iu", "text": "OS"}


def save(recording: RecordingData, path: Path) -> None:
    """Write `recording` to `path`: first to a temporary file beside it, which then takes its place.

    Raises InputError when the folder is missing or cannot be written, or the provenance is not JSON.
    """
    values = _values(recording)
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}; create it first")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with h5py.File(temporary, "w", libver=("v108", "v108"), userblock_size=damage.USER_BLOCK) as file:
            file.attrs["format"] = FORMAT
            file.attrs["schema_version"] = SCHEMA_VERSION
            for column in COLUMNS:
                if column.path in values and not _is_absent(column, values[column.path]):
                    _write(file, column, values[column.path])
            _declare_absent(file, values)
        damage.seal(temporary)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)})") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def load(path: Path, make: type[Kind]) -> Kind:
    """Read a file as `make`, whose own checks it must pass. Raises InputError naming file, table, row and remedy."""
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the .h5 file of a recording")
    if not path.exists():
        raise InputError(f"{path}: no such file; 'cellslam record' writes recordings")
    try:
        damage.check(path)
        with h5py.File(path, "r") as file:
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


def _values(recording: RecordingData) -> dict[str, Any]:
    """Return the value of every column that the recording has, by path."""
    out: dict[str, Any] = {}
    for column in COLUMNS:
        value: Any = recording
        for name in column.path.split("/"):
            value = None if value is None else getattr(value, name)
        if value is not None:
            out[column.path] = value
    try:
        out["provenance"] = json.dumps(dict(recording.provenance), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"provenance cannot be written as JSON: {error}") from error
    return out


def _write(file: h5py.File, column: Column, value: Any) -> None:
    if column.kind == "text":
        text = value if column.shape == () else np.array(value, dtype=object)
        dataset = file.create_dataset(column.path, data=text, dtype=h5py.string_dtype("utf-8"))
    else:
        array = np.asarray(value, np.int64 if column.kind == "int" else np.float64, order="C")
        packed = {"compression": "gzip", "shuffle": True, "fletcher32": True} if array.size > 4096 else {}
        dataset = file.create_dataset(column.path, data=array, **packed)
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
    for table in sorted({column.table for column in COLUMNS if column.absent}):
        names = [c.path for c in COLUMNS if c.table == table and c.absent and _is_absent(c, values[c.path])]
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
    groups = {column.table for column in COLUMNS} | set(TABLES_THAT_MAY_MISS)
    for path, is_group in _members(file):
        if is_group and path not in groups:
            raise InputError(f"unknown table '{path}'{nearest_name(path, groups - {''})}")
        if not is_group and path not in known:
            raise InputError(f"unknown column '{path}'{nearest_name(path, known)}")
    for column in COLUMNS:
        missing = (whole for whole in TABLES_THAT_MAY_MISS if whole not in file)
        if column.optional or any(column.path.startswith(f"{whole}/") for whole in missing):
            continue
        table = column.table
        if table and table not in file:
            raise InputError(f"table '{table}' is missing; it needs the columns {_columns_of(table)}")
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
    sizes: dict[str, tuple[int, str]] = {}
    out: dict[str, Any] = {}
    for column in COLUMNS:
        if column.path in file:
            out[column.path] = _read(file[column.path], column, sizes)
    for column in COLUMNS:
        if column.absent and column.path not in out:
            count = sizes[str(column.shape[0])][0]
            out[column.path] = np.full(count, -1, np.int64) if column.kind == "int" else np.full(count, np.nan)
    return out


def _read(dataset: h5py.Dataset, column: Column, sizes: dict[str, tuple[int, str]]) -> Any:
    """Return the values of a column; `sizes` holds each symbol's size and the column that set it."""
    kind = getattr(dataset, "dtype", None)
    if kind is None or dataset.shape is None or kind.kind not in _KINDS[column.kind]:
        raise InputError(f"column '{column.path}' holds {kind or 'a table'}; write {column.described}")
    unit = dataset.attrs.get("unit")
    if unit is None or _text(unit) != column.unit:
        given = "has no unit" if unit is None else f"has unit '{_text(unit)}'"
        raise InputError(
            f"column '{column.path}' {given}; write it in '{column.unit}' and say so in its attribute 'unit'"
        )
    _check_shape(dataset.shape, column, sizes)
    if column.kind == "text":
        try:
            return dataset.asstr()[()]
        except (UnicodeDecodeError, TypeError) as error:
            raise InputError(f"column '{column.path}' is no UTF-8 text; write it as UTF-8") from error
    return np.asarray(dataset[()], np.int64 if column.kind == "int" else np.float64)


def _check_shape(shape: tuple[int, ...], column: Column, sizes: dict[str, tuple[int, str]]) -> None:
    if len(shape) != len(column.shape):
        raise InputError(f"column '{column.path}' has shape {shape}; write {column.described}")
    for size, wanted in zip(shape, column.shape, strict=True):
        expected, source = sizes.setdefault(wanted, (size, column.path)) if isinstance(wanted, str) else (wanted, "")
        if size != expected:
            why = f" rows like '{source}'" if source else f"; write {column.described}"
            raise InputError(f"column '{column.path}' has shape {shape}, expected {expected}{why}")


def _recording(values: dict[str, Any], make: type[Kind]) -> Kind:
    def table(name: str) -> dict[str, Any]:
        start = f"{name}/"
        found = {path.removeprefix(start): v for path, v in values.items() if path.startswith(start)}
        return {column: v for column, v in found.items() if "/" not in column}

    truth = None
    if "truth/poses" in values:
        own = table("truth/vehicles")
        vehicles = Vehicles(**(own | {"kind": tuple(own["kind"].tolist())})) if own else None
        steps = ClockSteps(**table("truth/clock_steps")) if "truth/clock_steps/site" in values else None
        vts = VirtualTransmitters(**table("truth/vts"))
        truth = Truth(**table("truth"), vts=vts, vehicles=vehicles, clock_steps=steps)
    reference = Reference(**table("reference")) if "reference/time_s" in values else None
    sites = table("sites")
    return make(
        time_s=values["time_s"],
        odometry=values["odometry"],
        odometry_model=OdometryModel(**table("odometry_model")),
        links=Links(**table("links")),
        sites=Sites(**(sites | {"name": tuple(sites["name"].tolist())})),
        measurements=Measurements(**table("measurements")),
        start_pose=values["start_pose"],
        start_std=values["start_std"],
        provenance=_provenance(values["provenance"]),
        truth=truth,
        reference=reference,
        plane=bool(values.get("plane", 0)),
    )


def _provenance(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"provenance is not JSON ({error}); write a JSON object, '{{}}' if there is none") from error
    if not isinstance(value, dict):
        raise InputError("provenance is not a JSON object; write '{}' if there is none")
    return value


def _columns_of(table: str) -> str:
    return ", ".join(c.path.removeprefix(f"{table}/") for c in COLUMNS if c.path.startswith(f"{table}/"))


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    return str(error).splitlines()[0] if str(error) else type(error).__name__
