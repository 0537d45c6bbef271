"""Compiled: the steps of FastSLAM that are those of the joint filter, for one group of particles at a time.

`predict` moves a group; `score` compares measurements with its VTs; `use` takes a snapshot in as it was associated;
`innovate` linearises a block of snapshots; `end_block` tidies up after the update, which is done in NumPy
(`fastslam.py`); `spread_over_particles` says by how much particles differ in what they expect.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.association_kernel import score_pairs
from cellslam.slam.joint.snapshot.motion_kernel import Interval
from cellslam.slam.joint.snapshot.observation_kernel import coordinates, geometry, rotations_of
from cellslam.slam.joint.snapshot.snapshot_kernel import (
    Workspace,
    advance,
    begin_update,
    count_odds,
    end_update,
    ends,
    give_births,
    new_workspace,
    take_in,
    update_by_block,
)
from cellslam.slam.joint.snapshot.steps_kernel import shift_clocks
from cellslam.slam.joint.snapshot.update_kernel import settle
from cellslam.slam.joint.state.layout import LINK, ArrayErrors, Block, Filter, Measured
from cellslam.slam.model.arrays_kernel import put
from cellslam.slam.model.matrices_kernel import Vec3


class Scores(NamedTuple):
    """How the m measurements of a snapshot fit the VTs of a group: `count` (1,) of these are candidates, `slot` (V,);
    `log_ratio` (V, m), of a pair's likelihood to that of a missed detection and clutter, and `distance2` (V, m), the
    squared Mahalanobis distance; outside the gate, and between links, -inf and inf."""

    count: Ints  # type: ignore[assignment]  # hides tuple.count
    slot: Ints
    log_ratio: Floats
    distance2: Floats


@njit(cache=True, nogil=True)
def workspace_for(f: Filter, measurements: int, rows: int) -> Workspace:
    """Return memory to work in, for one group, a snapshot of so many measurements, and updates of so many rows."""
    return new_workspace(f, measurements, rows)


@njit(cache=True, nogil=True)
def predict(f: Filter, b: Block, interval: Interval, work: Workspace) -> None:
    """Move a group by an interval."""
    advance(f, b, interval, work.step)


@njit(cache=True, nogil=True)
def step_clocks(f: Filter, a: ArrayErrors, b: Block, seen: Measured, slot_of: Ints, work: Workspace) -> bool:
    """Shift the clocks that the measurements, associated with the VTs `slot_of` (m,), show to have stepped; return
    whether there is any."""
    put(work.pairs.slot_of, slot_of)
    return shift_clocks(f, b, a, seen, work.jacobian, work.pairs)


@njit(cache=True, nogil=True)
def score(f: Filter, a: ArrayErrors, seen: Measured, work: Workspace, out: Scores) -> None:
    """Write how the measurements of a snapshot fit the VTs of a group."""
    w, n = work.pairs, 0
    for link in range(len(seen.first) - 1):
        start, stop = seen.first[link], seen.first[link + 1]
        for r in range(score_pairs(f, a, seen, link, work.jacobian, w) if stop > start else 0):
            out.slot[n] = w.chosen[r]
            out.log_ratio[n, :], out.distance2[n, :] = -math.inf, math.inf
            for k in range(start, stop):
                out.log_ratio[n, k], out.distance2[n, k] = w.score[r, k - start], w.distance2[r, k - start]
            n += 1
    out.count[0] = n


@njit(cache=True, nogil=True)
def use(f: Filter, a: ArrayErrors, b: Block, seen: Measured, slot_of: Ints, association: Ints, work: Workspace) -> bool:
    """Use a snapshot whose measurements are associated with the VTs `slot_of` (m,), FRESH and NO_BIRTH among them;
    write their identities into `association` (m,); return whether the block is full."""
    w = work.pairs
    put(w.slot_of, slot_of)
    count_odds(f, b, seen, w)
    take_in(f, b, seen, association, work.jacobian, w)
    give_births(f, a, b, seen, association, work.jacobian, w, work.pending)
    return ends(b, seen.rules)


@njit(cache=True, nogil=True)
def innovate(f: Filter, a: ArrayErrors, b: Block, seen: Measured, work: Workspace) -> None:
    """Linearise a block: leave the whitened innovations and gains of its measurements in work.pending."""
    begin_update(f, a, b, seen, work.pending)
    update_by_block(f, a, b, seen, work.jacobian, work.pending)


@njit(cache=True, nogil=True)
def end_block(
    f: Filter, a: ArrayErrors, b: Block, before: Floats, noise: Floats, seen: Measured, drawn: Ints, work: Workspace
) -> float:
    """End a block whose update began in the mean `before` (n,): take the rows of work.pending off the covariance, and
    do what the joint filter does then; return what that adds to the group's log-weight.

    drawn (6,): indices of the noise that was drawn, -1 for none; a new block begins, in which it is zero so far.
    """
    settle(f, work.pending)
    work.pending.added[:] = 0.0
    for c in range(len(drawn)):
        index = drawn[c]
        if index >= 0:
            f.x[index] = 0.0
            f.particles.deviation[index] = 0.0
            for i in range(f.size[0]):
                f.p[index, i] = 0.0
                f.p[i, index] = 0.0
    return end_update(f, a, b, before, noise, seen, work.pending)


@njit(cache=True, nogil=True)
def spread_over_particles(f: Filter, site_of: Ints, work: Workspace) -> None:
    """Write f.vts.spread: the covariance over the particles of what they expect of each VT, linearised at the mean, as
    distance (m), clock offset included, azimuth and elevation (rad). site_of (L,): site of each link."""
    turned, here, s, count = rotations_of(f), Vec3(f.x[0], f.x[1], f.x[2]), work.jacobian, len(f.particles.weight)
    expected = np.empty((3, count))
    for j in range(f.count[0]):
        offset = f.core.first_offset + site_of[f.vts.slots[j, LINK]]
        geometry(f, j, offset, here, turned, coordinates(f, j), s)
        expected[:] = 0.0
        for m in range(s.size[0]):
            row = f.particles.deviation[s.at[m]]
            for r in range(3):
                if s.by[r, m] != 0.0:
                    for c in range(count):
                        expected[r, c] += s.by[r, m] * row[c]
        entry = 0
        for r in range(3):
            for q in range(r, 3):
                total = 0.0
                for c in range(count):
                    total += f.particles.weight[c] * expected[r, c] * expected[q, c]
                f.vts.spread[j, entry] = total
                entry += 1
