"""Compiled: particles copied at resampling, and the map of one particle read out for an estimate."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit, prange

from cellslam.slam.fastslam.parts.clock import offset_belief
from cellslam.slam.fastslam.parts.landmarks import locate
from cellslam.slam.fastslam.parts.part_types import cached_and_not
from cellslam.slam.fastslam.running.prefetch import prefetch_column
from cellslam.slam.fastslam.state.layout import (
    BIAS0,
    GAIN,
    HIGH,
    LANES,
    LOW,
    NEAR,
    OFFSET0,
    SCALE0,
    SIGMA,
    THETA,
    WIDTH,
)
from cellslam.slam.fastslam.state.tracks_kernel import UNKNOWN

B = LANES


@njit(cache=True, parallel=True)
def move_within(steps, starts, state, status, records, order, counts):
    """Copy particles to other lanes of their own block: steps (n, 3) = block, from, to, sorted; starts (G + 1,)."""
    for g in prange(state.shape[0]):
        a, b = starts[g], starts[g + 1]
        if a == b:
            continue
        for r in range(state.shape[1] // B):
            for i in range(a, b):
                state[g, r * B + steps[i, 2]] = state[g, r * B + steps[i, 1]]
        for link in range(counts.shape[1]):
            for j in range(counts[g, link]):
                slot = order[g, link, j]
                row = status[g, link, slot]
                needed = False
                for i in range(a, b):
                    s = row[steps[i, 1]]
                    row[steps[i, 2]] = s
                    needed = needed or s >= 0
                if needed:
                    record = records[g, link, slot]
                    for r in range(len(record) // B):
                        for i in range(a, b):
                            record[r * B + steps[i, 2]] = record[r * B + steps[i, 1]]


@njit(cache=True)
def move_between(
    steps,
    state,
    status,
    records,
    ident,
    order,
    counts,
    to_state,
    to_status,
    to_alike,
    to_records,
    to_ident,
    to_order,
    to_counts,
    to_bounds,
):
    """Copy particles to lanes of other blocks: steps (n, 4) = block, lane, to block, to lane; tracks are matched by
    identity."""
    for i in range(steps.shape[0]):
        g, a, h, b = steps[i]
        for r in range(state.shape[1] // B):
            to_state[h, r * B + b] = state[g, r * B + a]
        for link in range(counts.shape[1]):
            to_alike[h, link, :] = UNKNOWN
            for j in range(to_counts[h, link]):
                to_status[h, link, to_order[h, link, j], b] = -1
            for j in range(counts[g, link]):
                slot = order[g, link, j]
                s = status[g, link, slot, a]
                if s < 0:
                    continue
                place, new = _place(
                    ident[g, link, slot], to_status[h, link], to_ident[h, link], to_order[h, link], to_counts, h, link
                )
                if place < 0:
                    continue
                rows = records.shape[3] // B
                if new:
                    for r in range(rows):
                        to_records[h, link, place, r * B : (r + 1) * B] = records[g, link, slot, r * B + a]
                to_status[h, link, place, b] = s
                to_bounds[h, link, LOW, place] = -math.inf
                to_bounds[h, link, HIGH, place] = math.inf
                to_bounds[h, link, WIDTH, place] = math.inf
                to_bounds[h, link, NEAR, place] = 0.0
                for r in range(rows):
                    to_records[h, link, place, r * B + b] = records[g, link, slot, r * B + a]


@njit(cache=True)
def _place(name, status, ident, order, counts, block, link):
    """Return the slot of the track called `name` and whether it had to be taken from the free ones; -1 if all are in
    use."""
    for j in range(counts[block, link]):
        if ident[order[j]] == name:
            return order[j], False
    if counts[block, link] == order.shape[0]:
        return -1, False
    slot = order[counts[block, link]]
    counts[block, link] += 1
    ident[slot] = name
    status[slot, :] = -1
    return slot, True


def _read_map(parts, lane, least, size, state, status, records, ident, order, counts, site_of, link_of, origin):
    """Return id and link (V,), position (V, 3) and covariance (V, 3, 3) of the VTs of one lane of a block with at least
    class `least`: x = x(mu), cov = J (Sigma + G P G^T) J^T.

    site_of, link_of: site of each map, and the link that its VTs are reported for; origin (3,) is added.
    """
    wanted = 0
    for own in range(counts.shape[0]):
        for j in range(counts[own]):
            slot = order[own, j]
            s = status[own, slot, lane]
            if s >= 0 and s & 3 >= least:
                prefetch_column(records[own, slot], lane, B)
                wanted += 1
    out_id, out_link = np.empty(wanted, np.int64), np.empty(wanted, np.int64)
    position, covariance = np.empty((wanted, 3)), np.empty((wanted, 3, 3))
    n = 0
    jacobian, gain = np.empty((3, 3)), np.empty((3, 3))
    block, inner = np.empty((3, 3)), np.empty((3, 3))
    for own in range(counts.shape[0]):
        index = (site_of[own], size - 2, size - 1)
        for r in range(3):
            for c in range(3):
                block[r, c] = state[(THETA + size + index[r] * size + index[c]) * B + lane]
        by_bias, by_scale = block[0, 1], block[0, 2]
        for j in range(counts[own]):
            slot = order[own, j]
            s = status[own, slot, lane]
            if s < 0 or s & 3 < least:
                continue
            v = records[own, slot]
            offset, block[0, 0], shared = offset_belief(parts.clock, v, lane, state, size, index[0])
            block[0, 1] = block[1, 0] = shared * by_bias
            block[0, 2] = block[2, 0] = shared * by_scale
            d0 = offset - v[OFFSET0 * B + lane]
            d1 = state[(THETA + size - 2) * B + lane] - v[BIAS0 * B + lane]
            d2 = state[(THETA + size - 1) * B + lane] - v[SCALE0 * B + lane]
            k = 0
            for r in range(3):
                for c in range(3):
                    gain[r, c] = v[(GAIN + 3 * r + c) * B + lane]
            _congruence(gain, block, inner)
            for r in range(3):
                for c in range(r, 3):
                    inner[r, c] += v[(SIGMA + k) * B + lane]
                    inner[c, r] = inner[r, c]
                    k += 1
            locate(parts.landmarks, v, lane, d0, d1, d2, position[n], jacobian)
            _congruence(jacobian, inner, covariance[n])
            position[n] += origin
            out_id[n], out_link[n] = ident[own, slot], link_of[own]
            n += 1
    return out_id, out_link, position, covariance


read_map: Any = cached_and_not(_read_map)


@njit(cache=True, error_model="numpy")
def _congruence(m, s, out):
    """Write M S M^T of 3 x 3 matrices, S symmetric."""
    for r in range(3):
        for c in range(r + 1):
            total = 0.0
            for i in range(3):
                total += m[r, i] * (s[i, 0] * m[c, 0] + s[i, 1] * m[c, 1] + s[i, 2] * m[c, 2])
            out[r, c] = out[c, r] = total
