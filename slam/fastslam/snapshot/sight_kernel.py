"""Compiled: what a snapshot says of the noise in speed and yaw rate since the last one, before it is used."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from cellslam.slam.fastslam.parts.association import associate
from cellslam.slam.fastslam.parts.clock import clock_moves, load_clock
from cellslam.slam.fastslam.parts.part_types import cached_and_not
from cellslam.slam.fastslam.running.borrow import borrowed, borrowed_measured, borrowed_scratch, borrowed_tracks
from cellslam.slam.fastslam.running.turns_kernel import all_done, done, take
from cellslam.slam.fastslam.snapshot.candidates_kernel import candidates, middle
from cellslam.slam.fastslam.snapshot.motion_kernel import advance, load_site, prepare
from cellslam.slam.fastslam.snapshot.nuisance_kernel import forget
from cellslam.slam.fastslam.snapshot.pair_kernel import innovate, invert
from cellslam.slam.fastslam.snapshot.update_kernel import mask
from cellslam.slam.fastslam.state.layout import (
    LANES,
    O_FLAT,
    O_FULL,
    O_X,
    O_Y,
    O_Z,
    W_E,
    W_INV,
    W_MASK,
    W_POSE,
    Link,
)

B = LANES
SEEN = 5  # rows of what is seen: y (2) and I (00 01 11) over displacement ahead (m) and turn (rad)


def _sight_blocks(turns, blocks, parts, rules, now, dt, velocity, state, tracks, travelled, measured, seen, s):
    """Write seen (G, SEEN, LANES), for all blocks that nobody else takes, as if they had moved by velocity (G, 6,
    LANES) for dt.

    Particles and maps stay as they are, but for what tracks could show; turns: see `turns_kernel`.
    """
    moved, way, turns = np.empty_like(state[0]), np.empty_like(travelled[0]), borrowed(turns)
    velocity, seen = borrowed(velocity), borrowed(seen)
    own, shared, given = borrowed_scratch(s), borrowed_tracks(tracks), borrowed_measured(measured)
    g = take(turns)
    while g < blocks:
        moved[:], way[:] = state[g], travelled[g]
        seen[g] = 0.0
        _sight(g, parts, rules, now, dt, velocity[g], moved, shared, way, given, seen[g], own)
        done(turns)
        g = take(turns)
    all_done(turns, blocks)


sight_blocks: Any = cached_and_not(_sight_blocks)


@njit(error_model="numpy")
def _sight(g, parts, rules, now, dt, velocity, state, tracks, travelled, measured, seen, s):
    size = travelled.shape[0] + 1
    advance(state, travelled, velocity, dt, size)
    clock_moves(parts.clock, state, travelled, dt, size)
    turned = travelled[size - 2]
    prepare(s.w, state)
    psi, psi_spread = middle(s.w, W_POSE + 3)
    forget(s.w, s.v, size)
    for number in range(len(measured.site_of)):
        first, last, site = measured.first[number], measured.first[number + 1], measured.site_of[number]
        if last == first:
            continue
        link = Link(
            tracks.status[g, number], tracks.alike[g, number], tracks.records[g, number], tracks.ident[g, number],
            tracks.order[g, number], tracks.bounds[g, number],
        )  # fmt: skip
        load_site(s.w, state, site, size)
        load_clock(parts.clock, s.w, state, site, size)
        found = candidates(
            parts, s, now, link, tracks.counts[g, number], travelled[site], turned, psi, psi_spread, measured.z, first,
            last, rules,
        )  # fmt: skip
        turn = (now * len(measured.site_of) + number) * len(tracks.counts) + g
        associate(parts.association, s, found, first, last - first, link, turn, measured.shares[number])
        for q in range(found):
            for k in range(first, last):
                if s.claims[q, k - first] and mask(s.w, s.row_of[k - first], q):
                    innovate(s.w, s.rows[q], measured.many[k])
                    invert(s.w, s.rows[q], measured.many[k], 1.0)
                    _add(s.w, s.rows[q], seen)


@njit(cache=True, error_model="numpy")
def _add(w, out, seen):
    """Add what a pair says: going ahead shortens the way to what lies ahead, a turn takes itself off the azimuth."""
    for l in range(B):
        if not w[W_MASK * B + l] > 0.5:
            continue
        x, y, z = out[O_X * B + l], out[O_Y * B + l], out[O_Z * B + l]
        flat, full = out[O_FLAT * B + l], out[O_FULL * B + l]
        a0, a1, a2 = -x / full, y / (flat * flat), x * z / (full * full * flat)
        i0, i1, i2 = w[W_INV * B + l], w[(W_INV + 1) * B + l], w[(W_INV + 2) * B + l]
        i3, i4, i5 = w[(W_INV + 3) * B + l], w[(W_INV + 4) * B + l], w[(W_INV + 5) * B + l]
        e0, e1, e2 = w[W_E * B + l], w[(W_E + 1) * B + l], w[(W_E + 2) * B + l]
        b0, b1, b2 = i0 * a0 + i1 * a1 + i2 * a2, i1 * a0 + i3 * a1 + i4 * a2, i2 * a0 + i4 * a1 + i5 * a2
        seen[0, l] += b0 * e0 + b1 * e1 + b2 * e2
        seen[1, l] -= i1 * e0 + i3 * e1 + i4 * e2
        seen[2, l] += b0 * a0 + b1 * a1 + b2 * a2
        seen[3, l] -= b1
        seen[4, l] += i3
