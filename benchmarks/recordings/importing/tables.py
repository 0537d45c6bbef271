"""Columns of a text or MATLAB file as numbers, every fault named by file, column and row."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.benchmarks.recordings.importing.manifest import FileTable
from cellslam.benchmarks.recordings.importing.matlab import variables
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording import Floats

TEXT = (".csv", ".txt", ".tsv", ".dat")


class TableFile:
    """A table's file, read once: `numbers` and `labels` return its columns. Raises InputError."""

    def __init__(self, folder: Path, table: FileTable) -> None:
        self.path = folder / table.file
        if not self.path.is_file():
            names = sorted(p.name for p in folder.iterdir() if p.is_file())
            near = nearest_name(table.file, names)
            raise InputError(f"{self.path}: no such file{near} (the folder holds: {', '.join(names[:20])})")
        suffix = self.path.suffix.lower()
        if suffix == ".mat":
            self._columns: Mapping[str, Any] = _struct(self.path, table.variable)
        elif suffix in TEXT:
            self._columns = _text_columns(self.path, "\t" if suffix == ".tsv" else table.delimiter)
        else:
            raise InputError(f"{self.path}: '{suffix}' files are not read; export it as .csv or .mat")

    def numbers(self, name: str) -> Floats:
        """Return a column as floats (N,), in the unit of the file; an empty cell is NaN. Raises InputError."""
        raw = self._raw(name)
        try:
            values = np.asarray(raw, np.float64)
        except (TypeError, ValueError):
            row, text = next((i, t) for i, t in enumerate(raw) if not _is_number(t))
            where = f" (line {row + 2})" if self.path.suffix.lower() in TEXT else ""
            raise InputError(
                f"{self.path}: column '{name}', row {row}{where}: '{text}' is not a number; leave the cell empty where "
                "nothing was measured"
            ) from None
        return values

    def labels(self, name: str) -> list[str]:
        """Return a column as text; whole numbers without decimals."""
        out = []
        for row, value in enumerate(self._raw(name)):
            if isinstance(value, float | np.floating) and not np.isfinite(value):
                raise InputError(f"{self.path}: column '{name}', row {row}: is empty; name the link of every row")
            out.append(
                str(int(value)) if isinstance(value, float | np.floating) and value == int(value) else str(value)
            )
        return out

    def _raw(self, name: str) -> Any:
        if name not in self._columns:
            near = nearest_name(name, self._columns)
            known = ", ".join(list(self._columns)[:20])
            raise InputError(f"{self.path}: no column '{name}'{near} (it has: {known})")
        return self._columns[name]


def _text_columns(path: Path, delimiter: str) -> dict[str, Any]:
    import warnings

    import pandas as pd

    cells = "give every line as many cells as the header, or say the 'delimiter' (numbers have decimal points)"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(path, sep=delimiter, skipinitialspace=True, index_col=False, low_memory=False)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: is empty; it needs a header line with the names of the columns") from None
    except pd.errors.ParserError as error:
        reason = str(error).removeprefix("Error tokenizing data. C error: ").strip()
        raise InputError(f"{path}: {reason}; {cells}") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: is not UTF-8 text ({error.reason} at byte {error.start}); save it as UTF-8"
        ) from error
    except pd.errors.ParserWarning as error:
        raise InputError(f"{path}: lines are longer than the header; {cells}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a table ({str(error).splitlines()[0]})") from error
    names = [str(name).strip() for name in frame.columns]
    for index, name in enumerate(names):
        if name.endswith(".1") and name[:-2] in names:
            raise InputError(f"{path}: two columns are called '{name[:-2]}'; rename one")
        if _is_number(name):
            raise InputError(
                f"{path}: its first line holds numbers ('{name}'); write a header line with the columns' names"
            )
        names[index] = name
    return {name: frame.iloc[:, i].to_numpy() for i, name in enumerate(names)}


def _struct(path: Path, variable: str) -> Mapping[str, Any]:
    found: Any = variables(path, (variable,) if variable else ())
    found = found[variable] if variable else found
    if not isinstance(found, Mapping):
        raise InputError(f"{path}: '{variable}' is no struct; put the columns into a struct, or leave 'variable' out")
    return {name: _flat(path, name, value) for name, value in found.items()}


def _flat(path: Path, name: str, value: Any) -> Any:
    if isinstance(value, list):
        return [item if isinstance(item, str) else _one(path, name, row, item) for row, item in enumerate(value)]
    array = np.asarray(value)
    return array.ravel(order="F") if array.ndim else array.reshape(1)


def _one(path: Path, name: str, row: int, item: Any) -> Any:
    array = np.asarray(item)
    if array.size != 1:
        raise InputError(
            f"{path}: '{name}', cell {row} holds {array.size} values, not one; write one row a measurement"
        )
    return array.ravel()[0]


def _is_number(text: Any) -> bool:
    try:
        float(text)
    except (TypeError, ValueError):
        return False
    return True
