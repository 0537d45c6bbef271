"""MATLAB files of both kinds as plain arrays: version 5 to 7 (SciPy) and 7.3, which is HDF5."""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.sim.data_files import MOST_DEFLATED
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording.damage import LIMIT_S, LIMIT_S_PER_BYTE, refuse_elsewhere

_READ = """
import pickle, sys
from scipy.io import loadmat
try:
    found = loadmat(sys.argv[1], simplify_cells=False)
except Exception as error:
    found = str(error).partition("\\n")[0] or type(error).__name__
pickle.dump(found, sys.stdout.buffer)
"""


def variables(path: Path, names: Sequence[str] = ()) -> dict[str, Any]:
    """Return the variables of a .mat file: numbers as arrays in MATLAB's shape, structs as dicts, cells as lists.

    Raises InputError where the file is none, or lacks one of `names`.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; download or export it first")
    import h5py

    found = _read_hdf5(path) if h5py.is_hdf5(path) else _read_old(path)
    for name in names:
        if name not in found:
            near = nearest_name(name, found)
            raise InputError(f"{path}: no variable '{name}'{near} (it has: {', '.join(sorted(found)) or 'none'})")
    return found


def _read_old(path: Path) -> dict[str, Any]:
    # SciPy may crash on a damaged file, now or the next time: another process reads it, and hands over what it has.
    limit_s = LIMIT_S + LIMIT_S_PER_BYTE * path.stat().st_size
    try:
        ended = subprocess.run([sys.executable, "-P", "-c", _READ, str(path)], capture_output=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise InputError(f"{path}: damaged: it was not read in {limit_s:.0f} s; export it again") from None
    if ended.returncode < 0:
        name = signal.Signals(-ended.returncode).name
        raise InputError(f"{path}: damaged: SciPy crashes on it ({name}); export it again")
    raw = pickle.loads(ended.stdout) if ended.returncode == 0 else f"exit status {ended.returncode}"
    if isinstance(raw, str):
        raise InputError(f"{path}: not a MATLAB file, or a damaged one ({raw}); export it again")
    return {name: _old_value(value) for name, value in raw.items() if not name.startswith("__")}


def _old_value(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.names:
        items = [{name: _old_value(item[name]) for name in value.dtype.names} for item in value.ravel()]
        return items[0] if len(items) == 1 else items
    if isinstance(value, np.ndarray) and value.dtype == object:
        return [_old_value(item) for item in value.ravel(order="F")]
    if isinstance(value, np.ndarray) and value.dtype.kind in "US":
        rows = [str(item) for item in value.ravel()]
        return rows[0] if len(rows) == 1 else rows
    return value


def _read_hdf5(path: Path) -> dict[str, Any]:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            refuse_elsewhere(file)
            return {name: _hdf5_value(file, item) for name, item in file.items() if not name.startswith("#")}
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, RuntimeError, KeyError) as error:
        raise InputError(
            f"{path}: a damaged MATLAB 7.3 file ({str(error).splitlines()[0]}); export it again"
        ) from error


def _hdf5_value(file: Any, item: Any) -> Any:
    import h5py

    if isinstance(item, h5py.Group):
        return {name: _hdf5_value(file, inner) for name, inner in item.items()}
    if item.size * item.dtype.itemsize > MOST_DEFLATED * max(item.id.get_storage_size(), item.dtype.itemsize):
        raise OSError(f"'{item.name}' declares {item.size} values and holds {item.id.get_storage_size()} bytes")
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if item.attrs.get("MATLAB_empty", 0):
        return "" if kind == "char" else ([] if kind == "cell" else np.zeros(tuple(int(n) for n in item[()].ravel())))
    if item.dtype == h5py.ref_dtype:
        led_to = [file[reference] for reference in np.asarray(item[()]).ravel()]
        for inner in led_to:
            refuse_elsewhere(inner)  # no link may lead to it
        return [_hdf5_value(file, inner) for inner in led_to]
    if kind == "char":
        return "".join(chr(code) for code in np.asarray(item[()]).T.ravel(order="F"))
    value = np.asarray(item[()])
    return value.T  # MATLAB stores by columns
