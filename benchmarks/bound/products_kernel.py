"""Compiled product of the bound's recursion: H P, H being sparse. What is dense is left to BLAS."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints


class Sparse(NamedTuple):
    """A matrix of r rows: row i has `load` (e,) in the columns `column` (e,), entries begin[i] up to begin[i + 1]."""

    begin: Ints
    column: Ints
    load: Floats


@njit(cache=True)
def times(H: Sparse, x: Floats) -> Floats:
    """Return H x^T (r, n), x (n, l) in Fortran's order: its columns are added up."""
    out = np.zeros((len(H.begin) - 1, len(x)))
    for r in range(len(out)):
        row = out[r]
        for i in range(H.begin[r], H.begin[r + 1]):
            load, column = H.load[i], x[:, H.column[i]]
            for j in range(len(row)):
                row[j] += load * column[j]
    return out
