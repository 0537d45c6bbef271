"""Compiled: VTs that have turned out to be one and the same."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.fastslam.snapshot.predict_kernel import predict
from cellslam.slam.fastslam.state.layout import (
    HIGH,
    HITS,
    LANES,
    LOW,
    O_A,
    O_FLAT,
    O_FULL,
    O_OFFSET,
    O_S,
    O_X,
    O_Y,
    O_Z,
    W_MASK,
    W_P,
)
from cellslam.slam.fastslam.state.tracks_kernel import CONFIRMED, DEAD, UNKNOWN

B = LANES
EVERY = 64  # snapshots from one look for doubles to the next
# Two VTs are one if they differ by so little, squared and over its covariance, and would be told apart at so much: m,
# rad, rad.
ALIKE, TELLING = 2.0, (2.0, math.radians(2.5), math.radians(3.5))


@njit(error_model="numpy")
def merge(parts, s, link, count):
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
def _confirmed(row):
    """Say whether any lane has confirmed a track."""
    any_ = np.int32(0)
    for l in range(B):
        any_ |= np.int32((row[l] >= 0) & (row[l] & 3 == CONFIRMED))
    return any_ != 0


@njit(cache=True, error_model="numpy")
def _compare(w, one, other, status, other_status):
    """Set W_MASK to 1 in the lanes in which two predicted tracks are one VT; return whether there are any.

    They are compared as they would be measured: e over S_1 + S_2 + (A_1 - A_2) P (A_1 - A_2)^T, since what they have in
    common through the nuisances is no difference.
    """
    F = w.dtype.type
    t0, t1, t2 = F(TELLING[0] ** 2), F(TELLING[1] ** 2), F(TELLING[2] ** 2)
    alike, any_ = F(ALIKE), np.int32(0)
    for l in range(B):
        f1, f2, u1, u2 = one[O_FLAT * B + l], other[O_FLAT * B + l], one[O_FULL * B + l], other[O_FULL * B + l]
        x1, x2, y1, y2 = one[O_X * B + l], other[O_X * B + l], one[O_Y * B + l], other[O_Y * B + l]
        e0 = u1 + one[O_OFFSET * B + l] - u2 - other[O_OFFSET * B + l]
        e1 = (x2 * y1 - x1 * y2) / (f1 * f2)
        e2 = (one[O_Z * B + l] * f2 - other[O_Z * B + l] * f1) / (u1 * u2)
        ahead = x1 * x2 + y1 * y2 > F(0.0)
        p0, p1, p2 = w[W_P * B + l], w[(W_P + 1) * B + l], w[(W_P + 2) * B + l]
        p3, p4, p5 = w[(W_P + 3) * B + l], w[(W_P + 4) * B + l], w[(W_P + 5) * B + l]
        a0, a1 = one[O_A * B + l] - other[O_A * B + l], one[(O_A + 1) * B + l] - other[(O_A + 1) * B + l]
        a2, a3 = one[(O_A + 2) * B + l] - other[(O_A + 2) * B + l], one[(O_A + 3) * B + l] - other[(O_A + 3) * B + l]
        a4, a5 = one[(O_A + 4) * B + l] - other[(O_A + 4) * B + l], one[(O_A + 5) * B + l] - other[(O_A + 5) * B + l]
        a6, a7 = one[(O_A + 6) * B + l] - other[(O_A + 6) * B + l], one[(O_A + 7) * B + l] - other[(O_A + 7) * B + l]
        a8 = one[(O_A + 8) * B + l] - other[(O_A + 8) * B + l]
        b0, b1, b2 = a0 * p0 + a1 * p1 + a2 * p2, a0 * p1 + a1 * p3 + a2 * p4, a0 * p2 + a1 * p4 + a2 * p5
        b3, b4, b5 = a3 * p0 + a4 * p1 + a5 * p2, a3 * p1 + a4 * p3 + a5 * p4, a3 * p2 + a4 * p4 + a5 * p5
        b6, b7, b8 = a6 * p0 + a7 * p1 + a8 * p2, a6 * p1 + a7 * p3 + a8 * p4, a6 * p2 + a7 * p4 + a8 * p5
        a = one[O_S * B + l] + other[O_S * B + l] + b0 * a0 + b1 * a1 + b2 * a2
        b = one[(O_S + 1) * B + l] + other[(O_S + 1) * B + l] + b0 * a3 + b1 * a4 + b2 * a5
        c = one[(O_S + 2) * B + l] + other[(O_S + 2) * B + l] + b0 * a6 + b1 * a7 + b2 * a8
        d = one[(O_S + 3) * B + l] + other[(O_S + 3) * B + l] + b3 * a3 + b4 * a4 + b5 * a5
        e = one[(O_S + 4) * B + l] + other[(O_S + 4) * B + l] + b3 * a6 + b4 * a7 + b5 * a8
        f = one[(O_S + 5) * B + l] + other[(O_S + 5) * B + l] + b6 * a6 + b7 * a7 + b8 * a8
        m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
        det = a * m0 + b * m1 + c * m2
        d2 = m0 * e0 * e0 + (a * f - c * c) * e1 * e1 + (a * d - b * b) * e2 * e2
        d2 += F(2.0) * (m1 * e0 * e1 + m2 * e0 * e2 + (b * c - a * e) * e1 * e2)
        known = (a < t0) & (d < t1) & (f < t2) & ahead & (status[l] >= 0) & (other_status[l] >= 0)
        known &= (status[l] & 3 == CONFIRMED) & (other_status[l] & 3 == CONFIRMED) & (det > F(0.0))
        on = known & (d2 < alike * det)
        w[W_MASK * B + l] = F(1.0) if on else F(0.0)
        any_ |= np.int32(on)
    return any_ != 0


@njit(cache=True, error_model="numpy")
def _drop(w, one, other, status, other_status):
    """Give up, where W_MASK is 1, the track with fewer hits."""
    for l in range(B):
        if w[W_MASK * B + l] > 0.5:
            if one[HITS * B + l] > other[HITS * B + l]:
                other_status[l] = DEAD
            else:
                status[l] = DEAD
