"""Compiled: one snapshot for blocks of particles: move, age, associate, update, give birth, weigh."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.fastslam.parts.association import associate, may_be_born
from cellslam.slam.fastslam.parts.clock import clock_moves, learn, load_clock, rate_changes
from cellslam.slam.fastslam.parts.part_types import Parts, cached_and_not
from cellslam.slam.fastslam.running.borrow import borrowed, borrowed_blocks, borrowed_scratch, borrowed_step
from cellslam.slam.fastslam.running.turns_kernel import all_done, done, take
from cellslam.slam.fastslam.snapshot.birth_kernel import complete, give_birth
from cellslam.slam.fastslam.snapshot.candidates_kernel import candidates, middle
from cellslam.slam.fastslam.snapshot.merge_kernel import EVERY, merge
from cellslam.slam.fastslam.snapshot.motion_kernel import advance, load_site, prepare
from cellslam.slam.fastslam.snapshot.nuisance_kernel import absorb, collect, condition, forget
from cellslam.slam.fastslam.snapshot.pair_kernel import innovate, invert, logarithm
from cellslam.slam.fastslam.snapshot.update_kernel import correct, credit, mask
from cellslam.slam.fastslam.state.lanes_kernel import columns_at
from cellslam.slam.fastslam.state.layout import (
    BROAD,
    CENTRE,
    HIGH,
    HITS,
    LANES,
    LONG,
    LOW,
    MOVED,
    NEAR,
    POSE,
    POSE_G,
    THETA,
    V_WEIGHT,
    W_B,
    W_MASK,
    W_POSE,
    WIDTH,
    Blocks,
    Link,
    Rows,
    Rules,
    Scene,
    Scratch,
    Step,
    sums_of,
)
from cellslam.slam.fastslam.state.tracks_kernel import (
    CONFIRMED,
    DEAD,
    ONCE,
    UNCONFIRMED,
    age_all,
    common,
    evict,
    link_of,
)
from cellslam.slam.model.matrices_kernel import vec_plus, vec_scaled

B = LANES


def _advance_blocks(
    turns: Ints, blocks: int, parts: Parts, step: Step, held: Blocks, association: NDArray[np.int32], s: Scratch
) -> None:
    """Move by step.velocity for step.dt, then use one snapshot, in all blocks that nobody else takes.

    What is held and association (G, M, LANES) are written; `s` is scratch; turns: see `turns_kernel`. No block reads
    another: the result does not depend on who takes which.
    """
    turns, association = borrowed(turns), borrowed(association)
    given, shared, own = borrowed_step(step), borrowed_blocks(held), borrowed_scratch(s)
    g = take(turns)
    while g < blocks:
        _block(g, parts, given, shared, association[g], own)
        done(turns)
        g = take(turns)
    all_done(turns, blocks)


advance_blocks: Any = cached_and_not(_advance_blocks)


@part(error_model="numpy")
def _block(g: int, parts: Parts, step: Step, held: Blocks, association: Rows, s: Scratch) -> None:
    """Use one snapshot in one block."""
    now, measured, rules, tracks = step.now, step.measured, step.rules, held.tracks
    state, travelled, log_weight = held.state[g], held.travelled[g], held.log_weight[g]
    links, size = len(measured.site_of), travelled.shape[0] + 1
    turned = travelled[size - 2]
    if step.dt > 0.0:
        advance(state, travelled, step.velocity[g], step.dt, size)
        clock_moves(parts.clock, state, travelled, step.dt, size)
    prepare(s.w, state)
    psi, psi_spread = middle(s.w, W_POSE + 3)
    forget(s.w, s.v, size)
    updates, loaded = 0, -1
    for number in range(links):
        first, last, site = measured.first[number], measured.first[number + 1], measured.site_of[number]
        link, share = link_of(tracks, g, number), measured.shares[number]
        count = age_all(s.v, now, link, tracks.counts[g, number], rules, share)
        tracks.counts[g, number] = count
        doubles = rules.merging and (now + number) % EVERY == 0
        if last == first and not doubles:
            continue
        if site != loaded:
            load_site(s.w, state, site, size)
            load_clock(parts.clock, s.w, state, site, size)
            loaded = site
        if doubles:
            merge(parts, s, link, count)
        if last == first:
            continue
        scene = Scene(first, last, share, travelled[site], turned, psi, psi_spread)
        found = candidates(parts, s, now, link, count, scene, measured.z, rules)
        associate(parts.association, s, found, first, last - first, link)
        more = _update(parts, s, now, link, found, scene, measured.many, rules.hits, association)
        if more > 0:
            collect(s.w, s.v, site, size)
        updates += more
        tracks.counts[g, number] = _give_births(
            parts, s, now, link, count, scene, measured.fresh, g * B, measured.born, rules
        )
    if updates > 0:
        _apply(parts, s.v, state, travelled, size)
    for l in range(B):
        log_weight[l] += rules.exponent * s.v[V_WEIGHT * B + l]


@lean(error_model="numpy")
def _update(
    parts: Parts, s: Scratch, now: int, link: Link, found: int, scene: Scene, z: Rows, hits: float,
    association: NDArray[np.int32],
) -> int:  # fmt: skip
    """Update every associated track; return the number of associations, lanes counted once.

    `association` takes up those with confirmed VTs.
    """
    w, bits, v, near, rows, claims, row_of = s.w, s.bits, s.v, s.near, s.rows, s.claims, s.row_of
    records, status, alike, ident, first, updates = link.records, link.status, link.alike, link.ident, scene.first, 0
    for q in range(found):
        slot = near[q]
        record, out, row = records[slot], rows[q], status[slot]
        for k in range(first, scene.last):
            if not claims[q, k - first] or not mask(w, row_of[k - first], q):
                continue
            innovate(w, out, z[k])
            invert(w, out, z[k], 0.0)
            logarithm(w, bits)
            credit(w, v, out, z[k, 11], scene.share)
            absorb(w, out)
            learn(parts.clock, w, v, record, out)
            correct(w, record, out)
            updates += 1
            mine, name = association[k], ident[slot]
            for l in range(B):
                on = w[W_MASK * B + l] > 0.5
                looks = record[HITS * B + l]
                seen = 4 * now + (CONFIRMED if looks >= hits else UNCONFIRMED if looks > 1.0 else ONCE)
                row[l] = seen if on else row[l]
                mine[l] = name if on and seen & 3 == CONFIRMED else mine[l]
            alike[slot] = common(row)
    return updates


@lean(error_model="numpy")
def _give_births(
    parts: Parts, s: Scratch, now: int, link: Link, count: int, scene: Scene, z: Rows, particle: int, born: int,
    rules: Rules,
) -> int:  # fmt: skip
    """Start a track for each measurement that no particle's VT explains; return the number of tracks.

    particle: number of the first lane's; born: number of the snapshot's first measurement.
    """
    w, v, row_of, first = s.w, s.v, s.row_of, scene.first
    records, status, bounds, order = link.records, link.status, link.bounds, link.order
    credit_of_birth, new = scene.share * rules.log_birth, 4 * now + (CONFIRMED if rules.hits <= 1.0 else ONCE)
    for k in range(first, scene.last):
        if z[k, 8] + z[k, 9] == 0.0 or not may_be_born(parts.association, k):
            continue
        anywhere, least = False, z[k, 0] if z[k, 8] > 0.0 else 0.0
        mine = row_of[k - first]
        for l in range(B):
            on = mine[l] < 0 and (z[k, 8] == 0.0 or z[k, 0] - w[W_B * B + l] > 1.0)
            w[W_MASK * B + l] = 1.0 if on else 0.0
            anywhere = anywhere or on
            least = min(least, z[k, 0] - w[W_B * B + l]) if on else least
        if not anywhere:
            continue
        if count == len(order):
            count = evict(now, link, count)
        slot = order[count]
        count += 1
        complete(w, z[k], particle, born + k)
        give_birth(parts, w, records[slot], z[k])
        link.ident[slot] = born + k
        _begin_bound(bounds, slot, z[k], least, scene.travelled)
        row = status[slot]
        for l in range(B):
            on = w[W_MASK * B + l] > 0.5
            row[l] = new if on else DEAD
            v[V_WEIGHT * B + l] += credit_of_birth if on else 0.0
        link.alike[slot] = common(row)
    return count


@njit(cache=True, error_model="numpy")
def _begin_bound(bounds: Rows, slot: int, z: Rows, least: float, travelled: float) -> None:
    """Write what a track can show at its birth, `least` being the least distance from a particle."""
    spread = 0.0 if z[8] > 0.0 else math.inf
    bounds[LOW, slot], bounds[HIGH, slot], bounds[MOVED, slot] = z[0] - spread, z[0] + spread, travelled
    bounds[CENTRE, slot], bounds[WIDTH, slot], bounds[NEAR, slot] = 0.0, math.inf, max(least, 0.0) * z[3]
    bounds[LONG, slot], bounds[BROAD, slot] = z[5], z[6] + z[7]


@part(error_model="numpy")
def _apply(parts: Parts, v: Rows, state: Rows, travelled: Floats, size: int) -> None:
    """Condition theta on the snapshot and move theta and pose by its change: r += G_pose (theta_new - theta)."""
    at, square = sums_of(size), size * size
    prior = state[(THETA + size) * B : (THETA + size + square) * B]
    v[at.cov * B : (at.cov + square) * B] = prior
    condition(v, size)
    prior[:] = v[at.cov * B : (at.cov + square) * B]
    for i in range(size * B):
        state[THETA * B + i] += v[at.change * B + i]
    bias, scale = at.change + size - 2, at.change + size - 1
    shift, turn = 0.0, 0.0
    for l in range(B):
        pose_by_bias, pose_by_scale = columns_at(state, POSE_G, l)
        by_bias, by_scale = vec_scaled(pose_by_bias, v[bias * B + l]), vec_scaled(pose_by_scale, v[scale * B + l])
        change = vec_plus(by_bias, by_scale)
        state[POSE * B + l] += change.x
        state[(POSE + 1) * B + l] += change.y
        state[(POSE + 3) * B + l] += change.z
        shift, turn = max(shift, abs(change.x) + abs(change.y)), max(turn, abs(by_bias.z) + abs(by_scale.z))
    for site in range(size - 2):
        largest = 0.0
        for l in range(B):
            largest = max(largest, abs(v[(at.change + site) * B + l]))
        travelled[site] += shift + largest
    travelled[size - 2] += turn
    rate_changes(parts.clock, v, at.change, travelled)
