"""Compiled: one snapshot for every filter of a mixture, and the update at the end of each block of snapshots.

Measurements are associated and counted at every snapshot; what those at a VT differ by from what is expected is
averaged over a block, some tenths of a second at most, and the state is updated by the means. A mean is of the middle
place.

Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.association_kernel import FRESH, NO_BIRTH, Messages, Pairs, associate, believe
from cellslam.slam.joint.snapshot.birth_kernel import begin, choose_illuminator, clear, possible, tidy
from cellslam.slam.joint.snapshot.gauge_kernel import carry_over
from cellslam.slam.joint.snapshot.motion_kernel import Interval, Step, forget, move
from cellslam.slam.joint.snapshot.observation_kernel import Jacobian, coordinates, geometry, new_jacobian, rotations_of
from cellslam.slam.joint.snapshot.sizes_kernel import SWAY, count_motion, count_states
from cellslam.slam.joint.snapshot.steps_kernel import expect_steps, shift_clocks, take_slip, take_steps
from cellslam.slam.joint.snapshot.tentative_kernel import update_hypotheses
from cellslam.slam.joint.snapshot.update_kernel import (
    LOG_2PI,
    BlockMeasurement,
    Pending,
    Steps,
    add_up,
    compare,
    correct,
    expect_beside,
    expect_merging,
    innovate,
    log_likelihood,
)
from cellslam.slam.joint.state.layout import (
    BELIEF,
    EXISTS,
    FREE,
    HITS,
    IDENT,
    KNOWN_ASSOCIATION,
    LAST,
    LINK,
    LOG_RATIO,
    POSE,
    UNSEEN,
    WEIGHT,
    ArrayErrors,
    Block,
    Filter,
    Measured,
    Rules,
    block_of,
    one_of,
)
from cellslam.slam.model.arrays_kernel import put
from cellslam.slam.model.matrices_kernel import Vec3
from cellslam.slam.model.measurement_kernel import rotations

# The most that the measurements of a VT in a block can say against a filter: one in a hundred is of another VT.
UNLIKELY = -4.6
PENDING = 51  # rows of what measurements take off the covariance that may wait


class Workspace(NamedTuple):
    """Memory to work in, for one filter at a time."""

    step: Step
    jacobian: Jacobian
    pairs: Pairs
    pending: Pending


@lean
def advance(f: Filter, b: Block, interval: Interval, w: Step) -> None:
    """Move a filter by an interval of dt > 0.

    Distance and turn are the measured ones: the blocks of all filters of a mixture end together, or their weights could
    not be compared.
    """
    move(f, interval, w)
    u, dt = interval.measured, interval.dt
    b.track.total[0] += math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]) * dt
    b.track.total[1] += u[3] * dt
    b.track.total[2] += dt


@lean
def pair(f: Filter, a: ArrayErrors, seen: Measured, s: Jacobian, w: Pairs) -> None:
    """Write into w.slot_of (m,) the VT of each measurement: FRESH for what may begin one, NO_BIRTH for what may not."""
    for link in range(len(seen.first) - 1):
        start, stop = seen.first[link], seen.first[link + 1]
        if f.links[link] == 0:
            w.slot_of[start:stop] = NO_BIRTH
        elif seen.rules.association.mode == KNOWN_ASSOCIATION:
            for k in range(start, stop):
                w.slot_of[k] = FRESH
                for j in range(f.count[0]):
                    if f.vts.slots[j, IDENT] == seen.given[k] and f.vts.slots[j, LINK] == link:
                        w.slot_of[k] = j
        elif seen.rules.association.mode == BELIEF:
            believe(f, a, seen, link, s, w)
        elif stop > start:
            associate(f, a, seen, link, s, w)
            for k in range(start, stop):
                row = w.row_of[k - start]
                w.slot_of[k] = w.chosen[row] if row >= 0 else (NO_BIRTH if w.gated[k - start] == 1 else FRESH)


@lean
def count_odds(f: Filter, b: Block, seen: Measured, w: Pairs) -> None:
    """Add to each VT's log-odds that it was detected or missed in this snapshot.

    The first measurement of a VT of a remembered map, or at one that returns, counts as whole: that something is where
    the map has it is new evidence.
    """
    rules, horizon = seen.rules.association, seen.tables.shape[2] - 1
    for j in range(f.count[0]):
        if f.links[f.vts.slots[j, LINK]] == 1:
            kind, age = 0 if f.vts.slots[j, HITS] < 2 else 1, min(seen.now - f.vts.slots[j, LAST], horizon)
            b.sums.odds[j] += f.vts.anchor[j, WEIGHT] * seen.tables[kind, 1, age]
    for k in range(len(seen.z)):
        j = w.slot_of[k]
        if j >= 0:
            kind, age = 0 if f.vts.slots[j, HITS] < 2 else 1, min(seen.now - f.vts.slots[j, LAST], horizon)
            odds = seen.tables[kind, 0, age] - seen.tables[kind, 1, age] - rules.log_clutter - seen.gap[k]
            returns = f.vts.slots[j, UNSEEN] == 1 or seen.now - f.vts.slots[j, LAST] > rules.away
            if returns and b.sums.detections[j] == 0:
                any_vt = known_density(seen.z[k], seen.noise.many[k])
                f.vts.anchor[j, LOG_RATIO] += odds - any_vt
                odds = any_vt
            b.sums.odds[j] += odds


@lean
def known_density(z: Floats, q: Floats) -> float:
    """Return minus the mean log-density of a measurement (3,), NaN where not measured, at a VT that is known
    exactly."""
    total = 0.0
    for c in range(3):
        total += 0.0 if math.isnan(z[c]) else 0.5 * (1.0 + LOG_2PI + math.log(q[c]))
    return total


@part
def take_in(f: Filter, b: Block, seen: Measured, association: Ints, s: Jacobian, w: Pairs) -> None:
    """Take what the measurements of VTs differ by from what is expected, errors that persist left out, into the
    block."""
    turned, here, n = rotations_of(f), Vec3(f.x[0], f.x[1], f.x[2]), b.track.snapshots[0]
    put(b.track.pose[n], f.x[:POSE])
    for c in range(POSE):
        put(b.track.deviation[n, c], f.particles.deviation[c])
    b.track.at[n, 0], b.track.at[n, 1] = b.track.total[0], b.track.total[2]
    for link in range(len(seen.first) - 1):
        offset = f.core.first_offset + seen.site_of[link]
        for k in range(seen.first[link], seen.first[link + 1]):
            j = w.slot_of[k]
            association[k] = -1 if j < 0 else f.vts.slots[j, IDENT]
            if j < 0:
                continue
            h = geometry(f, j, offset, here, turned, coordinates(f, j), s)
            _count(b, j, 0, seen.z[k, 0] - h.distance - f.x[offset], seen.noise.many[k, 0])
            _count(b, j, 1, wrap(seen.z[k, 1] - h.azimuth), seen.noise.many[k, 1])
            _count(b, j, 2, seen.z[k, 2] - h.elevation, seen.noise.many[k, 2])
            b.sums.diffuse[j] += seen.noise.diffuse[k] ** 2
            b.sums.seen[j, b.sums.detections[j]] = n
            b.sums.detections[j] += 1
            f.vts.slots[j, LAST] = seen.now
            f.vts.slots[j, HITS] += 1
    b.track.snapshots[0] = n + 1


@lean
def _count(b: Block, j: int, c: int, e: float, q: float) -> None:
    if not math.isnan(e):
        b.sums.e[j, c] += e
        b.sums.q[j, c] += q
        b.sums.measured[j, c] += 1.0


@lean
def give_births(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, association: Ints, s: Jacobian, w: Pairs, p: Pending
) -> None:
    """Begin VTs with measurements that nothing explains. They do not change the weight of a filter: else it could
    win by measurements that it does not explain."""
    rules = seen.rules
    for link in range(len(seen.first) - 1):
        offset, start, stop = f.core.first_offset + seen.site_of[link], seen.first[link], seen.first[link + 1]
        # Where paths may be scattered the shortest one begins first: the illuminator of the others.
        first = start
        if rules.scatterers:
            choose_illuminator(f, b, seen, link, w.slot_of, s, p)
            first = shortest(seen.births.z, w.slot_of, start, stop)
        for turn in range(stop - start):
            k = first if turn == 0 else start + turn - (1 if start + turn <= first else 0)
            if w.slot_of[k] != FRESH or not possible(seen.births.z[k], f.x[offset]):
                continue
            ident = seen.born + k
            if rules.association.mode == KNOWN_ASSOCIATION and seen.given[k] >= 0:
                ident = seen.given[k]
                association[k] = ident
            elif rules.association.mode != FREE and rules.association.mode != BELIEF:
                continue
            before = f.count[0]
            begin(f, a, b, seen, link, ident, k, s, p)
            if rules.association.mode == BELIEF:
                f.vts.anchor[before : f.count[0], EXISTS] = w.exists[k]


@lean
def shortest(z: Floats, slot_of: Ints, start: int, stop: int) -> int:
    """Return the measurement with the least distance of those from `start` to `stop` that begin a VT, or the first."""
    best = start
    for k in range(start, stop):
        if slot_of[k] == FRESH and (slot_of[best] != FRESH or math.isnan(z[best, 0]) or z[k, 0] < z[best, 0]):
            best = k
    return best


@lean
def shares(b: Block, a: ArrayErrors, j: int) -> tuple[float, float]:
    """Return what of the deviation of diffuse errors and of turns is left in the mean of a VT's measurements in the
    block."""
    n, by_distance, by_time = b.sums.detections[j], 0.0, 0.0
    for i in range(n):
        for k in range(n):
            one, other = b.track.at[b.sums.seen[j, i]], b.track.at[b.sums.seen[j, k]]
            distance, time = one[0] - other[0], one[1] - other[1]
            by_distance += math.exp(-0.5 * (distance / a.diffuse_m) ** 2) if a.diffuse_m > 0.0 else 0.0
            by_time += math.exp(-0.5 * (time / a.sway_s) ** 2) if a.sway_s > 0.0 else 0.0
    return math.sqrt(by_distance / (n * n) * b.sums.diffuse[j] / n), math.sqrt(by_time / (n * n))


@lean
def count_nis(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, gate: float, s: Jacobian, p: Pending
) -> None:
    """Take in how far the first measurement of VT j of a remembered map is from where the map has it."""
    e, hph = compare(f, a, j, offset, measurement, s, p)
    new = innovate(e, measurement.q, hph)
    f.learnt.nis[0] += min(log_likelihood(new)[0], gate)
    f.learnt.nis[1] += new.measured
    f.vts.slots[j, UNSEEN] = 0


@part
def begin_update(f: Filter, a: ArrayErrors, b: Block, seen: Measured, p: Pending) -> None:
    """Begin the update by a block: what persists is redrawn in part, paths may have merged, clocks stepped, wheels
    slipped."""
    forget(f, a, b.track.total[0], b.track.total[2])
    if seen.rules.merge_rate > 0.0:
        expect_merging(f, seen.rules.merge_rate, b.track.total[2])
    expect_steps(f, seen.rules, p.steps)


@part
def update_by_block(f: Filter, a: ArrayErrors, b: Block, seen: Measured, s: Jacobian, p: Pending) -> None:
    """Take in what the block has of each VT, and its log-ratio; the rows of p wait to be added up."""
    rules = seen.rules
    z, q, white = np.empty(3), np.empty(3), np.empty(3)
    slots, anchor, sums = f.vts.slots, f.vts.anchor, b.sums
    for j in range(f.count[0]):
        if sums.detections[j] == 0 or anchor[j, WEIGHT] == 0.0:
            anchor[j, LOG_RATIO] += rules.evidence * sums.odds[j]
            clear(b, j)
            continue
        offset = f.core.first_offset + seen.site_of[slots[j, LINK]]
        at = sums.seen[j, sums.detections[j] // 2]
        middle = b.track.pose[at]
        there, turned = Vec3(middle[0], middle[1], middle[2]), rotations(middle[3], middle[4], middle[5])
        h = geometry(f, j, offset, there, turned, coordinates(f, j), s)
        z[0], z[1], z[2] = h.distance + f.x[offset], h.azimuth, h.elevation
        for c in range(3):
            n = sums.measured[j, c]
            z[c] += sums.e[j, c] / n if n > 0.0 else math.nan
            white[c] = sums.q[j, c] / (n * n) if n > 0.0 else 1.0
            q[c] = white[c] + (seen.noise.merged[c] / n if n > 0.0 else 0.0)
        if rules.merge_rate > 0.0:
            expect_beside(f, b, j, offset, h, there, turned, rules.lifetime.confirm, s)
        diffuse, turn = shares(b, a, j)
        measurement = BlockMeasurement(
            z=z, q=q, white=white, pose=middle, position=there, turned=turned, diffuse=diffuse, turn=turn, now=seen.now,
            deviation=b.track.deviation[at],
        )  # fmt: skip
        if slots[j, UNSEEN] == 1:
            count_nis(f, a, j, offset, measurement, rules.association.gate, s, p)
        known = 0.0
        for c in range(3):
            if sums.measured[j, c] > 0.0:
                known += 0.5 * (1.0 + LOG_2PI + math.log(q[c] + (diffuse * a.diffuse[c]) ** 2))
        # A pair's density counts as fit in so far as it is one VT's or another's; what any VT would have is evidence.
        evidence = rules.evidence * (sums.odds[j] - sums.detections[j] * known)
        if anchor[j, WEIGHT] < 1.0 or rules.scatterers:
            fit = update_hypotheses(f, a, j, offset, measurement, known + evidence, rules, s, p)
        else:
            fit = correct(f, a, j, offset, measurement, 1.0, rules, s, p)
        anchor[j, LOG_RATIO] += max(fit + known, UNLIKELY) + evidence
        clear(b, j)


@part
def end_update(f: Filter, a: ArrayErrors, b: Block, before: Floats, noise: Floats, seen: Measured, p: Pending) -> float:
    """End the update that began in the state `before` (n,): slip and steps are taken in, what persists is counted, VTs
    are dropped; return the log-likelihood of all but VTs.

    noise (6,): densities of the odometry's.
    """
    total = take_slip(f, seen.rules, p.steps, b.track.total) + take_steps(f, seen.rules, p.steps)
    carry_over(f, before, p.rows)
    count_states(f, f.core.sway, SWAY, a.sway * a.sway)
    count_motion(f, noise, b.track.total[2])
    b.track.snapshots[0] = 0
    b.track.total[:] = 0.0
    tidy(f, a, b, seen.now, seen.rules)
    return total


@lean
def ends(b: Block, rules: Rules) -> bool:
    """Return whether a block is full: after so many snapshots, so long a distance or turn."""
    most, track = rules.blocks, b.track
    return bool(
        track.snapshots[0] >= most.snapshots or track.total[0] > most.distance or abs(track.total[1]) > most.turn
    )


@njit(cache=True, nogil=True)
def advance_mixture(
    mixture: Filter, a: ArrayErrors, blocks: Block, interval: Interval, seen: Measured, association: Ints,
    rest: Floats, first: int, step: int,
) -> None:  # fmt: skip
    """Go on with every `step`-th of the K filters of a mixture, from the first on: move it, pair a snapshot's
    measurements with its VTs, and use the snapshot as it is paired.

    association (K, m), written: identities of the VTs, -1 for none. To `rest` (K,) is added what is in the log-weights
    beside the log-ratios of VTs.
    """
    work = new_workspace(one_of(mixture, 0), len(seen.z), PENDING)
    s, w, p = work.jacobian, work.pairs, work.pending
    for k in range(first, len(rest), step):
        f, b = one_of(mixture, k), block_of(blocks, k)
        if interval.dt > 0.0:
            advance(f, b, interval, work.step)
        pair(f, a, seen, s, w)
        if shift_clocks(f, b, a, seen, s, w):
            pair(f, a, seen, s, w)
        count_odds(f, b, seen, w)
        take_in(f, b, seen, association[k], s, w)
        give_births(f, a, b, seen, association[k], s, w, p)
        if ends(b, seen.rules):
            begin_update(f, a, b, seen, p)
            update_by_block(f, a, b, seen, s, p)
            before = f.x[: f.size[0]].copy()
            add_up(f, p)
            rest[k] += end_update(f, a, b, before, interval.noise, seen, p)


@part
def new_workspace(f: Filter, m: int, pending: int) -> Workspace:
    """Return memory to work in, for one filter, a snapshot of m measurements, and so many rows that are pending."""
    states, vts, particles = len(f.x), len(f.vts.slots), len(f.particles.weight)
    assignment, rows = 4 * (vts + m + 2), len(f.core.step_m) + 2
    steps = Steps(
        used=np.zeros(1, np.int64), left=np.zeros((rows, states)), score=np.zeros(rows), information=np.zeros(rows)
    )
    return Workspace(
        step=Step(by=np.empty((POSE, f.core.size + POSE)), rows=np.empty((POSE, states))),
        jacobian=new_jacobian(),
        pairs=Pairs(
            score=np.empty((vts, m)), distance2=np.empty((vts, m)), chosen=np.empty(vts, np.int64),
            row_of=np.empty(m, np.int64), gated=np.empty(m, np.int64), slot_of=np.empty(m, np.int64),
            work_f=np.empty(assignment), work_i=np.empty(assignment, np.int64),
            messages=Messages(
                beta=np.empty((vts, m)), zeta=np.empty((vts, m)), nu=np.empty((vts, m)),
                marginal=np.empty((vts, m)), xi=np.empty(m),
            ),
            exists=np.empty(m),
        ),
        pending=Pending(
            rows=np.empty((pending, states)), used=np.zeros(1, np.int64), added=np.zeros(states),
            t=np.empty((3, states)), steps=steps, whitened=np.empty((pending, particles)),
            whitened_mean=np.empty(pending),
        ),
    )  # fmt: skip
