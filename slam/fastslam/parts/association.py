"""Which measurement of a link belongs to which track, in every particle: parts of the filter."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Ints
from cellslam.slam.api import Snapshot
from cellslam.slam.fastslam.parts.part_types import replaceable, variant
from cellslam.slam.fastslam.state.layout import LANES, W_D2, Link, Rows, Scratch
from cellslam.slam.model.assignment_kernel import LEFT_OUT, assign

B = LANES


class Hungarian(NamedTuple):
    """The assignment with the greatest sum of scores; what gains by none is left to clutter and misses."""


class Told(NamedTuple):
    """The truth: `vt` (M,) of each measurement, -1 for clutter; `of_birth` that of all so far, by number."""

    vt: np.ndarray
    of_birth: np.ndarray


class FromTruth:
    """Shows each snapshot what is `Told`, of a recording whose rows come from the VTs `measurement_vt` (M,)."""

    def __init__(self, measurement_vt: Ints) -> None:
        self._vt, self._of_birth = np.array(measurement_vt, np.int64), np.empty(len(measurement_vt), np.int64)

    def for_snapshot(self, snapshot: Snapshot, born: int) -> Told:
        """Return the truth of a snapshot, `born` measurements having gone before."""
        vt = self._vt[snapshot.row]
        self._of_birth[born : born + len(vt)] = vt
        return Told(vt, self._of_birth)


@replaceable
def associate(part: Any, s: Scratch, found: int, first: int, measured: int, link: Link) -> None:
    """Write s.row_of (measured, LANES): which of the `found` candidates each measurement has in each lane, -1 for none.

    s: scratch, with s.scores (found, measured, LANES) where s.claims (found, measured); first: number of the first
    measurement in the snapshot.
    """
    if take_best(s, found, measured):
        for l in range(B):
            if _clash(s.row_of, measured, l):
                tabulate(s, found, measured, l)
                assign(s.table, found, measured, s.column, s.floats, s.ints)
                for k in range(measured):
                    s.row_of[k, l] = s.column[k]


@variant(associate, Told)
def _told(part: Told, s: Scratch, found: int, first: int, measured: int, link: Link) -> None:
    """Take the tracks of the VTs that measurements came from."""
    for k in range(measured):
        s.row_of[k, :] = -1
        vt = part.vt[first + k]
        for q in range(found):
            own = vt >= 0 and part.of_birth[link.ident[s.near[q]]] == vt
            s.claims[q, k] = own
            if own:
                for l in range(B):
                    s.row_of[k, l] = q if link.status[s.near[q], l] >= 0 else s.row_of[k, l]


@replaceable
def may_be_born(part: Any, k: int) -> bool:
    """Say whether measurement k of the snapshot may begin a track."""
    return True


@variant(may_be_born, Told)
def _may_be_born(part: Told, k: int) -> bool:
    """Say whether it came from a VT."""
    return bool(part.vt[k] >= 0)


@njit(cache=True, error_model="numpy")
def take_best(s: Scratch, found: int, measured: int) -> bool:
    """Let each measurement take the track with the greatest positive score, lane by lane; return whether any track
    could be claimed twice. Where it is not, nothing can be better."""
    w, scores, claims, row_of = s.w, s.scores, s.claims, s.row_of
    for k in range(measured):
        _take_best_of(w, scores, claims, found, k, row_of[k])
    for q in range(found):
        total = 0
        for k in range(measured):
            total += claims[q, k]
        if total > 1:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _take_best_of(w: Rows, scores: Rows, claims: Rows, found: int, k: int, mine: Rows) -> None:
    """Let measurement k take the best of the tracks that it may be of."""
    F = w.dtype.type
    for l in range(B):
        mine[l] = -1
        w[W_D2 * B + l] = F(0.0)
    for q in range(found):
        if claims[q, k]:
            gain, track = scores[q, k], np.int32(q)
            for l in range(B):
                better = gain[l] > w[W_D2 * B + l]
                mine[l] = track if better else mine[l]
                w[W_D2 * B + l] = gain[l] if better else w[W_D2 * B + l]


@njit(cache=True, error_model="numpy")
def _clash(row_of: Rows, measured: int, l: int) -> bool:
    """Return whether two measurements have the same track in lane l."""
    for k in range(1, measured):
        for i in range(k):
            if row_of[k, l] >= 0 and row_of[k, l] == row_of[i, l]:
                return True
    return False


@njit(cache=True, error_model="numpy")
def tabulate(s: Scratch, found: int, measured: int, l: int) -> None:
    """Write lane l's scores (found, measured) at s.table, LEFT_OUT where a pair is no candidate."""
    table, scores, claims = s.table, s.scores, s.claims
    for q in range(found):
        for k in range(measured):
            table[q, k] = scores[q, k, l] if claims[q, k] else LEFT_OUT
