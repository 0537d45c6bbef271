"""Compiled: particles copied at resampling, and the map of one particle read out for an estimate.

Source: Thrun, Burgard and Fox, "Probabilistic robotics", 2005, chapter 13: a particle is copied with its whole map.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import prange

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.fastslam.parts.clock import offset_belief
from cellslam.slam.fastslam.parts.part_types import Parts, cached_and_not
from cellslam.slam.fastslam.running.prefetch import prefetch_column
from cellslam.slam.fastslam.state.lanes_kernel import covariance_at, mat_at, sym_at, theta_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    GAIN,
    HIGH,
    LANES,
    LOW,
    NEAR,
    SIGMA,
    THETA0,
    WIDTH,
    Blocks,
    Tracks,
)
from cellslam.slam.fastslam.state.spherical_vt_kernel import locate
from cellslam.slam.fastslam.state.tracks_kernel import UNKNOWN, link_of
from cellslam.slam.model.matrices_kernel import Sym3, Vec3, congruence, sym_plus, vec_minus

B = LANES


@njit(cache=True, parallel=True)
def move_within(steps: Ints, starts: Ints, state: Floats, tracks: Tracks) -> None:
    """Copy particles to other lanes of their own block, by index.

    steps (n, 3) = block, from, to, sorted; starts (G + 1,): first step of each block.
    """
    status, records, order, counts = tracks.status, tracks.records, tracks.order, tracks.counts
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
def move_between(steps: Ints, state: Floats, tracks: Tracks, to_state: Floats, to: Tracks) -> None:
    """Copy particles to lanes of other blocks, by index; tracks are matched by identity.

    steps (n, 4) = block, lane, to block, to lane.
    """
    rows = tracks.records.shape[3] // B
    for i in range(steps.shape[0]):
        g, a, h, b = steps[i]
        for r in range(state.shape[1] // B):
            to_state[h, r * B + b] = state[g, r * B + a]
        for link in range(tracks.counts.shape[1]):
            to.alike[h, link, :] = UNKNOWN
            for j in range(to.counts[h, link]):
                to.status[h, link, to.order[h, link, j], b] = -1
            for j in range(tracks.counts[g, link]):
                slot = tracks.order[g, link, j]
                s = tracks.status[g, link, slot, a]
                if s < 0:
                    continue
                place, new = _place(tracks.ident[g, link, slot], to, h, link)
                if place < 0:
                    continue
                source, target = tracks.records[g, link, slot], to.records[h, link, place]
                if new:
                    for r in range(rows):
                        target[r * B : (r + 1) * B] = source[r * B + a]
                to.status[h, link, place, b] = s
                to.bounds[h, link, LOW, place] = -math.inf
                to.bounds[h, link, HIGH, place] = math.inf
                to.bounds[h, link, WIDTH, place] = math.inf
                to.bounds[h, link, NEAR, place] = 0.0
                for r in range(rows):
                    target[r * B + b] = source[r * B + a]


@njit(cache=True)
def _place(name: int, tracks: Tracks, block: int, number: int) -> tuple[int, bool]:
    """Return the slot of the track called `name` in one map and whether it had to be taken from the free ones; -1 if
    all are in use."""
    link, counts = link_of(tracks, block, number), tracks.counts
    for j in range(counts[block, number]):
        if link.ident[link.order[j]] == name:
            return link.order[j], False
    if counts[block, number] == link.order.shape[0]:
        return -1, False
    slot = link.order[counts[block, number]]
    counts[block, number] += 1
    link.ident[slot] = name
    link.status[slot, :] = -1
    return slot, True


def _read_map(
    parts: Parts, block: int, lane: int, least: int, size: int, held: Blocks, site_of: Ints, origin: Floats
) -> tuple[Ints, Ints, Floats, Floats]:
    """Return id and link (V,), position (V, 3) and covariance (V, 3, 3) of the VTs of one lane of a block with at least
    class `least`: x = x(mu), cov = J (Sigma + G P G^T) J^T.

    site_of (L,): site of each link, which has a map; origin (3,) is added.
    """
    state, tracks, wanted = held.state[block], held.tracks, 0
    for number in range(tracks.counts.shape[1]):
        for j in range(tracks.counts[block, number]):
            slot = tracks.order[block, number, j]
            s = tracks.status[block, number, slot, lane]
            if s >= 0 and s & 3 >= least:
                prefetch_column(tracks.records[block, number, slot], lane, B)
                wanted += 1
    out_id, out_link = np.empty(wanted, np.int64), np.empty(wanted, np.int64)
    position, covariance = np.empty((wanted, 3)), np.empty((wanted, 3, 3))
    n = 0
    for number in range(tracks.counts.shape[1]):
        site = site_of[number]
        theta, p = theta_at(state, site, size, lane), covariance_at(state, site, size, lane)
        for j in range(tracks.counts[block, number]):
            slot = tracks.order[block, number, j]
            s = tracks.status[block, number, slot, lane]
            if s < 0 or s & 3 < least:
                continue
            rec = tracks.records[block, number, slot]
            offset, variance = offset_belief(parts.clock, rec, lane, state, size, site)
            own = Sym3(variance, p.xy, p.xz, p.yy, p.yz, p.zz)
            spread = sym_plus(congruence(mat_at(rec, GAIN, lane), own), sym_at(rec, SIGMA, lane))
            change = vec_minus(Vec3(offset, theta.y, theta.z), vec_at(rec, THETA0, lane))
            place, jacobian = locate(rec, lane, change)
            c = congruence(jacobian, spread)
            covariance[n].ravel()[:] = (c.xx, c.xy, c.xz, c.xy, c.yy, c.yz, c.xz, c.yz, c.zz)
            position[n] = (place.x + origin[0], place.y + origin[1], place.z + origin[2])
            out_id[n], out_link[n] = tracks.ident[block, number, slot], number
            n += 1
    return out_id, out_link, position, covariance


read_map: Any = cached_and_not(_read_map)
