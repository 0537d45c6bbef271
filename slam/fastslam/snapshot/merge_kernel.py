"""Compiled: VTs that have turned out to be one and the same."""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.parts.part_types import Parts
from cellslam.slam.fastslam.snapshot.predict_kernel import predict
from cellslam.slam.fastslam.state.lanes_kernel import five_at, mat_at, sym_at
from cellslam.slam.fastslam.state.layout import (
    HIGH,
    HITS,
    LANES,
    LOW,
    O_A,
    O_S,
    O_X,
    W_MASK,
    W_P,
    Link,
    Rows,
    Scratch,
)
from cellslam.slam.fastslam.state.tracks_kernel import CONFIRMED, DEAD, UNKNOWN
from cellslam.slam.model.matrices_kernel import (
    Vec3,
    adjugate,
    congruence,
    determinant,
    mat_minus,
    quadratic,
    sym_plus,
)

B = LANES
EVERY = 64  # snapshots from one look for doubles to the next
# Two VTs are one if they differ by so little, squared and over its covariance, and would be told apart at so much: m,
# rad, rad.
ALIKE, TELLING = 2.0, (2.0, math.radians(2.5), math.radians(3.5))


@njit(error_model="numpy")
def merge(parts: Parts, s: Scratch, link: Link, count: int) -> None:
    """Give up one of each two confirmed VTs of a link that are one in a lane: that which was seen less often."""
    order, status, records, bounds, rows, w = link.order, link.status, link.records, link.bounds, s.rows, s.w
    near, found = s.near, 0
    for i in range(count):
        if _confirmed(status[order[i]]):
            near[found] = order[i]
            predict(parts, w, records[order[i]], rows[found])
            found += 1
    for i in range(1, found):
        for j in range(i):
            a, b = near[i], near[j]
            if bounds[LOW, a] > bounds[HIGH, b] + TELLING[0] or bounds[LOW, b] > bounds[HIGH, a] + TELLING[0]:
                continue
            if _compare(w, rows[i], rows[j], status[a], status[b]):
                _drop(w, records[a], records[b], status[a], status[b])
                link.alike[a], link.alike[b] = UNKNOWN, UNKNOWN


@njit(cache=True, error_model="numpy")
def _confirmed(row: Rows) -> bool:
    """Say whether any lane has confirmed a track."""
    any_ = np.int32(0)
    for l in range(B):
        any_ |= np.int32((row[l] >= 0) & (row[l] & 3 == CONFIRMED))
    return bool(any_ != 0)


@njit(cache=True, error_model="numpy")
def _compare(w: Rows, one: Rows, other: Rows, status: Rows, other_status: Rows) -> bool:
    """Set W_MASK to 1 in the lanes in which two predicted tracks are one VT; return whether there are any.

    They are compared as they would be measured: e over S_1 + S_2 + (A_1 - A_2) P (A_1 - A_2)^T, since what they have in
    common through the nuisances is no difference.
    """
    F = w.dtype.type
    t0, t1, t2 = F(TELLING[0] ** 2), F(TELLING[1] ** 2), F(TELLING[2] ** 2)
    alike, any_ = F(ALIKE), np.int32(0)
    for l in range(B):
        x1, y1, z1, flat1, full1 = five_at(one, O_X, l)
        x2, y2, z2, flat2, full2 = five_at(other, O_X, l)
        ahead = x1 * x2 + y1 * y2 > F(0.0)
        apart = Vec3(
            full1 - full2,
            (x2 * y1 - x1 * y2) / (flat1 * flat2),
            (z1 * flat2 - z2 * flat1) / (full1 * full2),
        )
        shared = congruence(mat_minus(mat_at(one, O_A, l), mat_at(other, O_A, l)), sym_at(w, W_P, l))
        s = sym_plus(sym_plus(sym_at(one, O_S, l), sym_at(other, O_S, l)), shared)
        adjugate_of_s = adjugate(s)
        det, d2 = determinant(s, adjugate_of_s), quadratic(adjugate_of_s, apart)
        known = (s.xx < t0) & (s.yy < t1) & (s.zz < t2) & ahead & (status[l] >= 0) & (other_status[l] >= 0)
        known &= (status[l] & 3 == CONFIRMED) & (other_status[l] & 3 == CONFIRMED) & (det > F(0.0))
        on = known & (d2 < alike * det)
        w[W_MASK * B + l] = F(1.0) if on else F(0.0)
        any_ |= np.int32(on)
    return bool(any_ != 0)


@njit(cache=True, error_model="numpy")
def _drop(w: Rows, one: Rows, other: Rows, status: Rows, other_status: Rows) -> None:
    """Give up, where W_MASK is 1, the track with fewer hits."""
    for l in range(B):
        if w[W_MASK * B + l] > 0.5:
            if one[HITS * B + l] > other[HITS * B + l]:
                other_status[l] = DEAD
            else:
                status[l] = DEAD
