"""Columns of a text or MATLAB file as numbers, every fault named by file, column and row.

A text file's columns are separated by commas, semicolons, tabs or white space; lines that begin with # or % are
comments. Its names stand in the first line, or in the comment before it; columns without a name, and those of a MATLAB
matrix, are called by their number, from 1.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from cellslam.recordings.importing.matlab import variables
from cellslam.sim.errors import InputError, nearest_name
from cellslam.sim.recording import Floats

MOST_COLUMNS = 10_000  # of a table: more are lines without their ends
TEXT = (".csv", ".txt", ".tsv", ".dat")


class TableFile:
    """A table's file, read once: `numbers` and `labels` return its columns. Raises InputError."""

    def __init__(self, path: Path, variable: str = "", delimiter: str = "") -> None:
        """`variable`: struct or matrix of a MATLAB file; `delimiter`: of a text file; empty: as the file has it."""
        self.path = path
        self._head: Head | None = None
        if not path.is_file():
            names = sorted(p.name for p in path.parent.glob("*") if p.is_file())
            near = nearest_name(path.name, names)
            raise InputError(f"{path}: no such file{near} (the folder holds: {', '.join(names[:20]) or 'no file'})")
        suffix = path.suffix.lower()
        if suffix == ".mat":
            self._columns: Mapping[str, Any] = _struct(path, variable)
        elif suffix in TEXT:
            self._head = Head.of(path, delimiter)
            self._columns = _text_columns(path, self._head)
        else:
            raise InputError(f"{path}: '{suffix}' files are not read; export it as .csv or .mat")

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self._columns)

    def numbers(self, name: str) -> Floats:
        """Return a column as floats (N,), in the unit of the file; an empty cell is NaN. Raises InputError."""
        raw = self._raw(name)
        try:
            return np.asarray(raw, np.float64)
        except (TypeError, ValueError):
            row, text = next((i, t) for i, t in enumerate(raw) if not _is_number(t))
            where = f" (line {self._line(row, self._head)})" if self._head is not None else ""
            raise InputError(
                f"{self.path}: column '{name}', row {row}{where}: '{text}' is not a number; leave the cell empty where "
                "nothing was measured; numbers have decimal points"
            ) from None

    def labels(self, name: str) -> list[str]:
        """Return a column as text; whole numbers without decimals."""
        out = []
        for row, value in enumerate(self._raw(name)):
            number = isinstance(value, float | np.floating)
            if number and not np.isfinite(value):
                raise InputError(f"{self.path}: column '{name}', row {row}: is empty; name the link of every row")
            out.append(str(int(value)) if number and value == int(value) else str(value))
        return out

    def _line(self, row: int, head: Head) -> int:
        content = (i for i, line in enumerate(_lines(self.path)) if line.strip() and i not in set(head.comments))
        return 1 + next(islice(content, row + head.named_first, None), 0)

    def _raw(self, name: str) -> Any:
        if name not in self._columns:
            near = nearest_name(name, self.names)
            known = ", ".join(self.names[:20])
            how = "; without names, columns go by their number" if "1" in self._columns else ""
            raise InputError(f"{self.path}: no column '{name}'{near} (it has: {known}{how})")
        return self._columns[name]


@dataclass(frozen=True)
class Head:
    """How a text file begins: its separator, names of its columns if it has them, and the lines that are comments.

    `named_first`: the names are the first line that is no comment.
    """

    separator: str
    names: tuple[str, ...]
    named_first: bool
    comments: tuple[int, ...]

    @classmethod
    def of(cls, path: Path, delimiter: str) -> Head:
        """Read the beginning of a file; `delimiter` empty: the one that its first line has. Raises InputError."""
        comments: list[int] = []
        first, before = "", ""
        try:
            for i, line in enumerate(_lines(path)):
                if line.lstrip()[:1] in (b"#", b"%"):
                    comments.append(i)
                    before = before if first else line.decode("utf-8").strip().lstrip("#% \t")
                elif not first and line.strip():
                    first = line.decode("utf-8-sig").strip("\r\n")
        except UnicodeDecodeError as error:
            raise InputError(f"{path}: is not UTF-8 text ({error.reason}); save it as UTF-8") from error
        if not first:
            raise InputError(f"{path}: is empty; it needs a header line with the names of the columns, or numbers")
        separator = delimiter.replace(" ", "") or _separator(first)
        try:
            cells = _cells(first, separator)
            above = [_cells(before, mark) for mark in (_separator(before), separator, "")]
        except csv.Error as error:
            raise InputError(f"{path}: {error}; end each line with a line feed") from error
        if not any(_is_number(cell) for cell in cells):
            return cls(separator, tuple(cells), True, tuple(comments))
        named = next((names for names in above if len(names) == len(cells)), [])
        numbers = [str(k + 1) for k in range(len(cells))]
        if len(set(named)) != len(named) or any(_is_number(name) for name in named):
            named = []
        return cls(separator, tuple(named or numbers), False, tuple(comments))


def _lines(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            yield from file
    except OSError as error:
        raise InputError(f"{path}: cannot be read as a table ({error.strerror})") from error


def _separator(line: str) -> str:
    """Return what separates the cells of a line: the first of comma, semicolon, tab that it has; empty: white space."""
    found = next((mark for mark in ",;\t" if mark in line), "")
    aligned = all(_is_number(cell) for cell in line.split()) and not all(_is_number(c) for c in line.split("\t"))
    return "" if found == "\t" and aligned else found


def _cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line. Raises csv.Error."""
    cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True)) if separator else line.split()
    if len(cells) > MOST_COLUMNS:
        raise csv.Error(f"a line has {len(cells)} cells, the most are {MOST_COLUMNS}")
    return [cell.strip() for cell in cells]


def _text_columns(path: Path, head: Head) -> dict[str, Any]:
    import warnings

    import pandas as pd
    from packaging.version import Version

    # Before version 3.1 pandas reads numbers to their last digit only where it is asked to.
    exact: dict[str, Any] = {} if Version(pd.__version__) >= Version("3.1") else {"float_precision": "round_trip"}
    cells = (
        "give every line as many cells as the header or first line, or say 'delimiter' (numbers have decimal points)"
    )
    names = list(head.names)
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise InputError(f"{path}: two columns are called '{twice}'; rename one")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(
                path, sep=head.separator or r"\s+", skipinitialspace=True, index_col=False, low_memory=False,
                header=0 if head.named_first else None, names=names, skiprows=list(head.comments) or None,
                **exact,
            )  # fmt: skip
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
    columns = {name: frame.iloc[:, i].to_numpy() for i, name in enumerate(names)}
    numbered = {} if head.named_first else {str(i + 1): column for i, column in enumerate(columns.values())}
    return columns | numbered


def _struct(path: Path, variable: str) -> Mapping[str, Any]:
    found: Any = variables(path, (variable,) if variable else ())
    found = found[variable] if variable else found
    if isinstance(found, np.ndarray) and found.ndim == 2:
        return {str(i + 1): column for i, column in enumerate(found.T)}
    if not isinstance(found, Mapping):
        raise InputError(
            f"{path}: '{variable}' is neither struct nor matrix; put the columns into one, or leave 'variable' out"
        )
    # A matrix beside other variables: its columns, too.
    parts = {
        f"{name}:{i + 1}": column
        for name, value in found.items()
        if isinstance(value, np.ndarray) and value.ndim == 2 and min(value.shape) > 1
        for i, column in enumerate(value.T)
    }
    return {name: _flat(path, name, value) for name, value in found.items()} | parts


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
