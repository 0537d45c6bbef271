"""Compiled: what a snapshot says of the noise in speed and yaw rate since the last one, before it is used."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.fastslam.parts.association import associate
from cellslam.slam.fastslam.parts.clock import clock_moves, load_clock
from cellslam.slam.fastslam.parts.part_types import Parts, cached_and_not
from cellslam.slam.fastslam.running.borrow import borrowed, borrowed_blocks, borrowed_scratch, borrowed_step
from cellslam.slam.fastslam.running.turns_kernel import all_done, done, take
from cellslam.slam.fastslam.snapshot.candidates_kernel import candidates, middle
from cellslam.slam.fastslam.snapshot.motion_kernel import advance, load_site, prepare
from cellslam.slam.fastslam.snapshot.nuisance_kernel import forget
from cellslam.slam.fastslam.snapshot.pair_kernel import innovate, invert
from cellslam.slam.fastslam.snapshot.update_kernel import mask
from cellslam.slam.fastslam.state.lanes_kernel import five_at, sym_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    LANES,
    O_X,
    W_E,
    W_INV,
    W_MASK,
    W_POSE,
    Blocks,
    Rows,
    Scene,
    Scratch,
    Step,
    Tracks,
)
from cellslam.slam.fastslam.state.tracks_kernel import link_of
from cellslam.slam.model.matrices_kernel import Vec3, dot, sym_vec

B = LANES
SEEN = 5  # rows of what is seen: y (2) and I (00 01 11) over displacement ahead (m) and turn (rad)


def _sight_blocks(turns: Ints, blocks: int, parts: Parts, step: Step, held: Blocks, seen: Floats, s: Scratch) -> None:
    """Write seen (G, SEEN, LANES), for all blocks that nobody else takes, as if they had moved by step.velocity for
    step.dt.

    Particles and maps stay as they are, but for what tracks could show; turns: see `turns_kernel`.
    """
    moved, way = np.empty_like(held.state[0]), np.empty_like(held.travelled[0])
    turns, seen = borrowed(turns), borrowed(seen)
    given, shared, own = borrowed_step(step), borrowed_blocks(held), borrowed_scratch(s)
    g = take(turns)
    while g < blocks:
        moved[:], way[:] = shared.state[g], shared.travelled[g]
        seen[g] = 0.0
        _sight(g, parts, given, moved, way, shared.tracks, seen[g], own)
        done(turns)
        g = take(turns)
    all_done(turns, blocks)


sight_blocks: Any = cached_and_not(_sight_blocks)


@njit(error_model="numpy")
def _sight(
    g: int, parts: Parts, step: Step, state: Rows, travelled: Floats, tracks: Tracks, seen: Floats, s: Scratch
) -> None:
    """Write what one block sees, moving its state and what it has travelled."""
    now, measured, size = step.now, step.measured, travelled.shape[0] + 1
    links = len(measured.site_of)
    advance(state, travelled, step.velocity[g], step.dt, size)
    clock_moves(parts.clock, state, travelled, step.dt, size)
    prepare(s.w, state)
    psi, psi_spread = middle(s.w, W_POSE + 3)
    forget(s.w, s.v, size)
    for number in range(links):
        first, last, site = measured.first[number], measured.first[number + 1], measured.site_of[number]
        if last == first:
            continue
        link, share = link_of(tracks, g, number), measured.shares[number]
        load_site(s.w, state, site, size)
        load_clock(parts.clock, s.w, state, site, size)
        scene = Scene(first, last, share, travelled[site], travelled[size - 2], psi, psi_spread)
        found = candidates(parts, s, now, link, tracks.counts[g, number], scene, measured.z, step.rules)
        turn = (now * links + number) * len(tracks.counts) + g
        associate(parts.association, s, found, first, last - first, link, turn, share)
        for q in range(found):
            for k in range(first, last):
                if s.claims[q, k - first] and mask(s.w, s.row_of[k - first], q):
                    innovate(s.w, s.rows[q], measured.many[k])
                    invert(s.w, s.rows[q], measured.many[k], 1.0)
                    _add(s.w, s.rows[q], seen)


@njit(cache=True, error_model="numpy")
def _add(w: Rows, out: Rows, seen: Floats) -> None:
    """Add what a pair says: going ahead shortens the way to what lies ahead, a turn takes itself off the azimuth."""
    for l in range(B):
        if not w[W_MASK * B + l] > 0.5:
            continue
        x, y, z, flat, full = five_at(out, O_X, l)
        inverse, e = sym_at(w, W_INV, l), vec_at(w, W_E, l)
        ahead = Vec3(-x / full, y / (flat * flat), x * z / (full * full * flat))
        weighed = sym_vec(inverse, ahead)
        seen[0, l] += dot(weighed, e)
        seen[1, l] -= sym_vec(inverse, e).y
        seen[2, l] += dot(weighed, ahead)
        seen[3, l] -= weighed.y
        seen[4, l] += inverse.yy
