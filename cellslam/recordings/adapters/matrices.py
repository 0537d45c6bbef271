"""Tables of numbers without names: text files of published campaigns."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats


def matrix(path: Path, columns: tuple[str, ...]) -> Floats:
    """Return a text file's rows (N, C) of numbers between white space, in file order; # begins a comment.

    `columns` are what its C columns hold, for the message. Raises InputError where it is something else.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; download it into this folder")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of an empty file
            rows = np.loadtxt(path, ndmin=2)
    except (ValueError, OSError) as error:
        raise InputError(
            f"{path}: not a table of numbers ({' '.join(str(error).split())}); download it again"
        ) from error
    if not rows.size:
        raise InputError(f"{path}: has no row; download it again")
    if rows.shape[1] != len(columns):
        raise InputError(f"{path}: has {rows.shape[1]} columns, expected {len(columns)}: {', '.join(columns)}")
    return rows


def increasing(rows: Floats) -> Floats:
    """Return the rows (N, C) in the order of their first column, a time in s, and one of those that share it."""
    kept: Floats = rows[np.unique(rows[:, 0], return_index=True)[1]]
    return kept
