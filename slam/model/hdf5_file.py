"""What one drive leaves to the next, as an HDF5 file: arrays with their units, and where they are from, as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.data_files import MOST_DEFLATED
from cellslam.sim.errors import InputError


class Kind(NamedTuple):
    """A kind of file: its `name`, which the file holds as its format; the unit of each array; what writes it."""

    name: str
    units: Mapping[str, str]
    writer: str


def check_shapes(of: Any, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InputError unless the arrays of an object have these shapes and hold finite numbers, or text."""
    for name, shape in shapes.items():
        value = getattr(of, name)
        if value.shape != shape or (value.dtype.kind != "U" and not np.isfinite(value).all()):
            raise InputError(f"{name} has shape {value.shape}, or is not finite; expected finite numbers {shape}")


def write(path: str | Path, kind: Kind, arrays: Mapping[str, Any], provenance: Mapping[str, Any]) -> None:
    """Write the arrays of a kind, all or nothing. Raises InputError where the file cannot be written."""
    import h5py

    from cellslam.sim.recording import damage

    def fill(file: h5py.File) -> None:
        file.attrs["format"] = f"cellslam {kind.name}"
        file.attrs["schema_version"] = 1
        file.attrs["provenance"] = json.dumps(dict(provenance))
        for name, unit in kind.units.items():
            values = np.asarray(arrays[name])
            stored = values.astype(h5py.string_dtype()) if values.dtype.kind == "U" else values
            file.create_dataset(name, data=stored).attrs["unit"] = unit

    try:
        damage.write(Path(path), fill)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error


def read(path: str | Path, kind: Kind) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the arrays of a file, of text or of 64-bit numbers, and its provenance.

    Raises InputError where it is none of this kind, or not whole.
    """
    from cellslam.sim.recording import damage

    writes = f"'{kind.writer}' writes one"
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file; {writes}")
    try:
        with damage.opened(Path(path)) as file:
            if file.attrs.get("format") != f"cellslam {kind.name}":
                raise InputError(f"not a {kind.name}")
            arrays = {name: _values(file[name]) for name in kind.units}
            return arrays, dict(json.loads(str(file.attrs["provenance"])))
    except InputError as error:
        raise InputError(f"{path}: {error}; {writes}") from error
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError) as error:
        raise InputError(f"{path}: not a {kind.name}, or a truncated one ({error}); {writes}") from error


def _values(dataset: Any) -> Any:
    import h5py

    if dataset.size * 8 > MOST_DEFLATED * max(dataset.id.get_storage_size(), 8):
        raise ValueError(
            f"'{dataset.name}' declares {dataset.size} values and holds {dataset.id.get_storage_size()} bytes"
        )
    if h5py.check_string_dtype(dataset.dtype) is not None:
        return np.asarray(dataset.asstr()[()], np.str_)
    return np.asarray(dataset[()], np.float64)
