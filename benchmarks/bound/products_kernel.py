"""Compiled products of the bound's recursion: H x, H being sparse, and P - G^T G."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.arrays_kernel import downdate


class Sparse(NamedTuple):
    """A matrix of r rows: row i has `load` (e,) in the columns `column` (e,), entries begin[i] up to begin[i + 1]."""

    begin: Ints
    column: Ints
    load: Floats


class Loads(NamedTuple):
    """The matrix H (k, n) of k components. Measurements of one view share its loads: H is rows `of` (k,) of what is
    `shared` (v, n), with the `load` (k,) of each component on a state `own` (k,) to it."""

    shared: Sparse
    of: Ints
    own: Ints
    load: Floats


@njit(cache=True)
def times(H: Loads, x: Floats) -> Floats:
    """Return H x (k, l), x (n, l)."""
    shared, width = H.shared, x.shape[1]
    views, out = np.zeros((len(shared.begin) - 1, width)), np.empty((len(H.of), width))
    for r in range(len(views)):
        row = views[r]
        for i in range(shared.begin[r], shared.begin[r + 1]):
            load, other = shared.load[i], x[shared.column[i]]
            for j in range(width):
                row[j] += load * other[j]
    for k in range(len(out)):
        row, view, load, other = out[k], views[H.of[k]], H.load[k], x[H.own[k]]
        for j in range(width):
            row[j] = view[j] + load * other[j]
    return out


@njit(cache=True)
def subtract_gains(P: Floats, G: Floats) -> None:
    """Subtract G^T G, G (k, n), from the symmetric P (n, n)."""
    gains = np.empty((len(G) + 3, len(P)))  # with three rows more, as `downdate` asks
    gains[: len(G)] = G
    downdate(P, len(P), gains, len(G))
