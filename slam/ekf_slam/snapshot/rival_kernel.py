"""Compiled: the likeliest other association of a snapshot that would move the vehicle or a clock noticeably.

A rival differs from the best assignment of a link by one measurement: left out, given to a VT that has none, or
exchanged with the measurement of another VT. Most are near doubles that lead to the same estimate, and are no rivals.

Source: Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic Control 24(6), 1979: hypotheses are
kept apart where measurements leave a doubt, and joined where they agree.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import lean
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.ekf_slam.snapshot.association_kernel import TAKEN, Pairs, difference, expect
from cellslam.slam.ekf_slam.snapshot.sight_kernel import Sight, rotations_of
from cellslam.slam.ekf_slam.snapshot.update_kernel import innovate
from cellslam.slam.ekf_slam.state.layout import SHARE, ArrayErrors, Filter, Measured
from cellslam.slam.model.matrices_kernel import Vec3, inverse, sym_vec

NOTICED = 0.25  # squared shift of a state, over its variance, that is noticed
NONE = -1


class Rival(NamedTuple):
    """The best rival of a snapshot: `loss` (1,) of log-likelihood, infinite where there is none; `change` (4,):
    measurement and slot, twice, NONE for no second one."""

    loss: Floats
    change: Ints


@lean
def find_rival(f: Filter, a: ArrayErrors, seen: Measured, link: int, rows: int, s: Sight, w: Pairs, out: Rival) -> None:
    """Search for a rival of the assignment of a link, w.row_of (m,), that loses less than the one in
    `out`."""
    start = seen.first[link]
    columns = seen.first[link + 1] - start
    for c in range(columns):
        own = w.row_of[c]
        held = w.score[own, c] if own >= 0 else 0.0
        if own >= 0 and held < out.loss[0] and _moves(f, a, seen, link, own, c, NONE, s, w):
            _put(out, held, start + c, TAKEN, NONE, NONE)
        for row in range(rows):
            loss, back, other = held - w.score[row, c], TAKEN, NONE
            if row == own or loss == math.inf:
                continue
            for k in range(columns):
                if w.row_of[k] == row:
                    other = k
            if other >= 0:
                loss += w.score[row, other]
                if own >= 0 and w.score[own, other] > 0.0:
                    loss -= w.score[own, other]
                    back = w.chosen[own]
            if loss < out.loss[0] and _moves(f, a, seen, link, row, other, c, s, w):
                _put(out, loss, start + c, w.chosen[row], start + other if other >= 0 else NONE, back)


@lean
def _put(out: Rival, loss: float, measurement: int, slot: int, second: int, second_slot: int) -> None:
    out.loss[0] = loss
    out.change[0], out.change[1], out.change[2], out.change[3] = measurement, slot, second, second_slot


@lean
def _moves(
    f: Filter, a: ArrayErrors, seen: Measured, link: int, row: int, before: int, after: int, s: Sight, w: Pairs
) -> bool:
    """Return whether place, heading or clock would move noticeably if the VT of a row had the measurement `after` of
    the link and not the measurement `before` (NONE: none)."""
    j, start = w.chosen[row], seen.first[link]
    if f.anchor[j, SHARE] < 1.0:  # a guess moves nothing else
        return False
    offset = f.core.first_offset + seen.site_of[link]
    expected, change = expect(f, a, j, offset, rotations_of(f), s), Vec3(0.0, 0.0, 0.0)
    spread = inverse(innovate(change, seen.single[start + max(before, after)], expected.hph).s)
    for k, sign in ((before, 1.0), (after, -1.0)):
        if k >= 0:
            e = difference(seen.z[start + k], expected.z)
            x, y, z = sign * e.x, sign * wrap(e.y), sign * e.z
            change = Vec3(
                change.x + (0.0 if math.isnan(x) else x), change.y + (0.0 if math.isnan(y) else y),
                change.z + (0.0 if math.isnan(z) else z),
            )  # fmt: skip
    u = sym_vec(spread, change)
    for state in (0, 1, 3, offset):
        moved = 0.0
        for k in range(s.size[0]):
            moved += f.p[state, s.at[k]] * (s.by[0, k] * u.x + s.by[1, k] * u.y + s.by[2, k] * u.z)
        if moved * moved > NOTICED * f.p[state, state]:
            return True
    return False
