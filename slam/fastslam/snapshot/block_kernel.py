"""Compiled: one snapshot for blocks of particles: move, age, associate, update, give birth, weigh."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from cellslam.slam.fastslam.parts.association import associate, may_be_born
from cellslam.slam.fastslam.parts.clock import absorb, clock_moves, correct_clock, load_clock, rate_changes
from cellslam.slam.fastslam.parts.part_types import cached_and_not
from cellslam.slam.fastslam.running.borrow import borrowed, borrowed_measured, borrowed_scratch, borrowed_tracks
from cellslam.slam.fastslam.running.turns_kernel import all_done, done, take
from cellslam.slam.fastslam.snapshot.birth_kernel import complete, give_birth
from cellslam.slam.fastslam.snapshot.candidates_kernel import candidates, middle
from cellslam.slam.fastslam.snapshot.merge_kernel import EVERY, merge
from cellslam.slam.fastslam.snapshot.motion_kernel import advance, load_site, prepare
from cellslam.slam.fastslam.snapshot.nuisance_kernel import collect, condition, forget
from cellslam.slam.fastslam.snapshot.pair_kernel import innovate, invert, logarithm
from cellslam.slam.fastslam.snapshot.update_kernel import correct, credit, mask
from cellslam.slam.fastslam.state.layout import (
    BROAD,
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
    Link,
)
from cellslam.slam.fastslam.state.tracks_kernel import CONFIRMED, DEAD, ONCE, UNCONFIRMED, age_all, common, evict

B = LANES


def _advance_blocks(
    turns, blocks, parts, rules, now, dt, velocity, state, tracks, travelled, measured, log_weight, association, s
):
    """Move by velocity (G, 6, LANES) for dt, then use one snapshot, in all blocks that nobody else takes.

    state (G, F LANES), tracks, travelled (G, S + 1), log_weight (G, LANES) and association (G, M, LANES) are written;
    `s` is scratch; turns: see `turns_kernel`. No block reads another: the result does not depend on who takes which.
    """
    turns = borrowed(turns)
    velocity, state, travelled = borrowed(velocity), borrowed(state), borrowed(travelled)
    log_weight, association = borrowed(log_weight), borrowed(association)
    own, shared, given = borrowed_scratch(s), borrowed_tracks(tracks), borrowed_measured(measured)
    g = take(turns)
    while g < blocks:
        _block(
            g, parts, rules, now, dt, velocity[g], state[g], shared, travelled[g], given, log_weight[g], association[g],
            own,
        )  # fmt: skip
        done(turns)
        g = take(turns)
    all_done(turns, blocks)


advance_blocks: Any = cached_and_not(_advance_blocks)


@njit(error_model="numpy")
def _block(g, parts, rules, now, dt, velocity, state, tracks, travelled, measured, log_weight, association, s):
    """Use one snapshot in one block."""
    size = travelled.shape[0] + 1
    turned = travelled[size - 2]
    if dt > 0.0:
        advance(state, travelled, velocity, dt, size)
        clock_moves(parts.clock, state, travelled, dt, size)
    prepare(s.w, state)
    psi, psi_spread = middle(s.w, W_POSE + 3)
    forget(s.w, s.v, size)
    updates, loaded = 0, -1
    for number in range(len(measured.site_of)):
        first, last, site = measured.first[number], measured.first[number + 1], measured.site_of[number]
        share = measured.shares[number]
        link = Link(
            tracks.status[g, number], tracks.alike[g, number], tracks.records[g, number], tracks.ident[g, number],
            tracks.order[g, number], tracks.bounds[g, number],
        )  # fmt: skip
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
        found = candidates(
            parts, s, now, link, count, travelled[site], turned, psi, psi_spread, measured.z, first, last, rules
        )
        turn = (now * len(measured.site_of) + number) * len(tracks.counts) + g
        associate(parts.association, s, found, first, last - first, link, turn, share)
        more = _update(parts, s, now, link, found, measured, first, last, rules, share, association)
        if more > 0:
            collect(s.w, s.v, site, size)
        updates += more
        tracks.counts[g, number] = _give_births(
            parts, s, now, link, count, travelled[site], measured, first, last, rules, share, g
        )
    if updates > 0:
        _apply(parts, s.v, state, travelled, size)
    for l in range(B):
        log_weight[l] += rules.exponent * s.v[V_WEIGHT * B + l]


@njit(error_model="numpy")
def _update(parts, s, now, link, found, measured, first, last, rules, share, association):
    """Update every associated track; return the number of associations, lanes counted once.

    `association` takes up those with confirmed VTs.
    """
    w, bits, v, near, rows, claims, row_of = s.w, s.bits, s.v, s.near, s.rows, s.claims, s.row_of
    records, status, alike, ident, z = link.records, link.status, link.alike, link.ident, measured.many
    hits, updates = rules.hits, 0
    for q in range(found):
        slot = near[q]
        record, out, row = records[slot], rows[q], status[slot]
        for k in range(first, last):
            if not claims[q, k - first] or not mask(w, row_of[k - first], q):
                continue
            innovate(w, out, z[k])
            invert(w, out, z[k], 0.0)
            logarithm(w, bits)
            credit(w, v, out, z[k, 11], share)
            absorb(parts.clock, w, v, record, out)
            correct_clock(parts.clock, w, record, out)
            correct(parts, w, record, out)
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


@njit(error_model="numpy")
def _give_births(parts, s, now, link, count, travelled, measured, first, last, rules, share, block):
    """Start a track for each measurement that no particle's VT explains; return the number of tracks."""
    w, v, row_of, z = s.w, s.v, s.row_of, measured.fresh
    records, status, bounds, order = link.records, link.status, link.bounds, link.order
    credit_of_birth, new = share * rules.log_birth, 4 * now + (CONFIRMED if rules.hits <= 1.0 else ONCE)
    for k in range(first, last):
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
        complete(w, z[k], block * B, measured.born + k)
        give_birth(parts, w, records[slot], z[k])
        link.ident[slot] = measured.born + k
        _begin_bound(bounds, slot, z[k], least, travelled)
        row = status[slot]
        for l in range(B):
            on = w[W_MASK * B + l] > 0.5
            row[l] = new if on else DEAD
            v[V_WEIGHT * B + l] += credit_of_birth if on else 0.0
        link.alike[slot] = common(row)
    return count


@njit(cache=True, error_model="numpy")
def _begin_bound(bounds, slot, z, least, travelled):
    """Write what a track can show at its birth, `least` being the least distance from a particle."""
    spread = 0.0 if z[8] > 0.0 else math.inf
    bounds[LOW, slot], bounds[HIGH, slot], bounds[MOVED, slot] = z[0] - spread, z[0] + spread, travelled
    bounds[WIDTH, slot], bounds[NEAR, slot] = math.inf, max(least, 0.0) * z[3]
    bounds[LONG, slot], bounds[BROAD, slot] = z[5], z[6] + z[7]


@njit(error_model="numpy")
def _apply(parts, v, state, travelled, size):
    """Condition theta on the snapshot and move theta and pose by its change."""
    change = (v.shape[0] // B - size) * B
    cov = change - size * size * B
    for i in range(size * size * B):
        v[cov + i] = state[(THETA + size) * B + i]
    condition(v, cov, change, size)
    for i in range(size * size * B):
        state[(THETA + size) * B + i] = v[cov + i]
    for i in range(size * B):
        state[THETA * B + i] += v[change + i]
    bias, scale = change + (size - 2) * B, change + (size - 1) * B
    shift, turn = 0.0, 0.0
    for l in range(B):
        dx = state[POSE_G * B + l] * v[bias + l] + state[(POSE_G + 1) * B + l] * v[scale + l]
        dy = state[(POSE_G + 2) * B + l] * v[bias + l] + state[(POSE_G + 3) * B + l] * v[scale + l]
        by_bias, by_scale = state[(POSE_G + 4) * B + l] * v[bias + l], state[(POSE_G + 5) * B + l] * v[scale + l]
        state[POSE * B + l] += dx
        state[(POSE + 1) * B + l] += dy
        state[(POSE + 3) * B + l] += by_bias + by_scale
        shift, turn = max(shift, abs(dx) + abs(dy)), max(turn, abs(by_bias) + abs(by_scale))
    for site in range(size - 2):
        largest = 0.0
        for l in range(B):
            largest = max(largest, abs(v[change + site * B + l]))
        travelled[site] += shift + largest
    travelled[size - 2] += turn
    rate_changes(parts.clock, v, change, travelled)
