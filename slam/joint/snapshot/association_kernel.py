"""Compiled: which measurement of a link came from which VT: scores, best assignment.

Source: Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999, chapter 6.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import lean
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.sight_kernel import (
    Sight,
    believed,
    coordinates,
    field,
    geometry,
    roof_first,
    rotations_of,
)
from cellslam.slam.joint.snapshot.update_kernel import LOG_2PI, Innovation, covariance, innovate, log_likelihood
from cellslam.slam.joint.state.layout import (
    BELIEF,
    BEYOND,
    EXISTS,
    HITS,
    IDENT,
    LAST,
    LINK,
    SHARE,
    ArrayErrors,
    Filter,
    Measured,
)
from cellslam.slam.model.assignment_kernel import assign
from cellslam.slam.model.matrices_kernel import Sym3, Vec3
from cellslam.slam.model.measurement_kernel import Rotations

NEARBY_M = 50.0  # walls next to each other make VTs that are so far apart, if they are two
FRESH, TAKEN = -1, -2  # measurements that may begin a VT, and those that nothing is to be made of


class Messages(NamedTuple):
    """Room for belief propagation (see `belief_kernel`): `beta`, `zeta`, `nu`, `marginal` (C, m), `xi` (m,)."""

    beta: Floats
    zeta: Floats
    nu: Floats
    marginal: Floats
    xi: Floats


class Pairs(NamedTuple):
    """Room for the pairs of a link: `score` (C, m), squared Mahalanobis distances `distance2` (C, m), infinite outside
    the gate, VTs `chosen` (C,) of its rows; of m measurements `row_of`, `gated`,
    `slot_of`; the assignment's `work_f` and `work_i`. By belief propagation: `messages`, and how likely a
    measurement began a VT, `exists` (m,)."""

    score: Floats
    distance2: Floats
    chosen: Ints
    row_of: Ints
    gated: Ints
    slot_of: Ints
    work_f: Floats
    work_i: Ints
    messages: Messages
    exists: Floats


class Expected(NamedTuple):
    """What is expected of a measurement: distance with the clock offset (m), azimuth, elevation (rad), errors that
    persist included, and its covariance but for the measurement's own."""

    z: Vec3
    hph: Sym3


@lean
def expect(f: Filter, a: ArrayErrors, j: int, offset: int, turned: Rotations, s: Sight) -> Expected:
    """Return what is expected of a measurement of VT j at this moment.

    Weights of the calibration are in it as states; what is not in the state, the roof, diffuse errors and turns have
    their whole variance: for that they need not be known better.
    """
    here = Vec3(f.x[0], f.x[1], f.x[2])
    seen = geometry(f, j, offset, here, turned, coordinates(f, j), s)
    before = s.size[0]
    errors = field(f, a.calibration_grid, a.calibration, 0, seen, -1, s)
    unmet = Vec3(a.calibration[0] ** 2, a.calibration[1] ** 2, a.calibration[2] ** 2)
    for k in range(before, s.size[0]):
        unmet = Vec3(unmet.x - s.by[0, k] ** 2, unmet.y - s.by[1, k] ** 2, unmet.z - s.by[2, k] ** 2)
    roof = believed(f, a.roof_grid, a.roof, roof_first(a), seen, s)
    hph = covariance(f, s)
    return Expected(
        Vec3(
            seen.distance + f.x[offset] + errors.x + roof.x, seen.azimuth + errors.y + roof.y,
            seen.elevation + errors.z + roof.z,
        ),
        Sym3(
            hph.xx + unmet.x + a.roof[0] ** 2 + f.spread[j, 0], hph.xy + f.spread[j, 1], hph.xz + f.spread[j, 2],
            hph.yy + unmet.y + a.roof[1] ** 2 + f.spread[j, 3], hph.yz + f.spread[j, 4],
            hph.zz + unmet.z + a.roof[2] ** 2 + f.spread[j, 5],
        ),
    )  # fmt: skip


@lean
def difference(z: Floats, expected: Vec3) -> Vec3:
    """Return what a measurement (3,), in m and rad, differs by from what is expected; azimuth not wrapped."""
    return Vec3(z[0] - expected.x, z[1] - expected.y, z[2] - expected.z)


@lean
def log_odds_of_return(i: Innovation, z: Floats, range_m: float) -> float:
    """Return the log-odds that a measurement z (3,) is of the VT which it is held against, not of another one near its
    place.

    By distance and azimuth, range_m away: elevations tell little, all images of a site have one height. The other one
    may be anywhere within NEARBY_M either way; a component that was not measured says nothing.
    """
    xx, xy, yy = i.s.xx, i.s.xy, i.s.yy
    det = xx * yy - xy * xy
    distance2 = (yy * i.e.x * i.e.x - 2.0 * xy * i.e.x * i.e.y + xx * i.e.y * i.e.y) / det
    room = math.log(NEARBY_M) - 0.5 * LOG_2PI if not math.isnan(z[0]) else 0.0
    room += math.log(NEARBY_M / max(range_m, 1.0)) - 0.5 * LOG_2PI if not math.isnan(z[1]) else 0.0
    return float(room - 0.5 * (distance2 + math.log(det)))


@lean
def score_pairs(f: Filter, a: ArrayErrors, seen: Measured, link: int, s: Sight, w: Pairs) -> int:
    """Score the measurements of a link against its VTs; return how many candidates there are.

    Written: w.score (C, m): log-likelihood ratio of a pair to "missed, and clutter", -inf outside the gate; w.chosen
    (C,): VT of each row; w.gated (m,): 1 in somebody's gate.
    """
    rules = seen.rules.association
    turned, offset, gate = rotations_of(f), f.core.first_offset + seen.site_of[link], rules.gate
    start, stop, horizon = seen.first[link], seen.first[link + 1], seen.tables.shape[2] - 1
    rows = 0
    w.gated[: stop - start] = 0
    for j in range(f.count[0]):
        share = f.anchor[j, SHARE]
        if f.slots[j, LINK] != link or f.slots[j, BEYOND] == 1 or share == 0.0:
            continue
        row, kind, age = rows, 0 if f.slots[j, HITS] < 2 else 1, min(seen.now - f.slots[j, LAST], horizon)
        if share < 1.0:  # one of several guesses of a VT, which is one row
            for r in range(rows):
                row = r if f.slots[w.chosen[r], IDENT] == f.slots[j, IDENT] else row
        if row == len(w.chosen):
            continue
        if row == rows:
            w.chosen[rows] = j
            w.score[rows, : stop - start] = -math.inf
            w.distance2[rows, : stop - start] = math.inf
            rows += 1
        expected = expect(f, a, j, offset, turned, s)
        odds = seen.tables[kind, 0, age] - seen.tables[kind, 1, age]
        if rules.mode == BELIEF:
            detected = f.anchor[j, EXISTS] * seen.rules.existence.detection
            odds = math.log(max(detected, 1e-300) / (1.0 - detected))
        prior = odds - rules.log_clutter + math.log(share)
        returns = seen.now - f.slots[j, LAST] > rules.away
        for k in range(start, stop):
            i = innovate(difference(seen.z[k], expected.z), seen.noise.single[k], expected.hph)
            if i.measured == 0 or i.e.x * i.e.x > gate * i.s.xx or i.e.y * i.e.y > gate * i.s.yy:
                continue
            if returns and log_odds_of_return(i, seen.z[k], expected.z.x - f.x[offset]) < rules.return_log_odds:
                continue
            distance2, log_det = log_likelihood(i)
            if distance2 < gate:
                w.gated[k - start] = 1
                w.distance2[row, k - start] = min(distance2, w.distance2[row, k - start])
                value = prior - seen.gap[k] - 0.5 * (distance2 + log_det + i.measured * LOG_2PI)
                before = w.score[row, k - start]
                most = max(value, before)
                w.score[row, k - start] = most + math.log(math.exp(value - most) + math.exp(before - most))
    return rows


@lean
def associate(f: Filter, a: ArrayErrors, seen: Measured, link: int, s: Sight, w: Pairs) -> None:
    """Write into w.row_of (m,) the row of `chosen` for each measurement of a link, -1 none: the best sum of scores."""
    rows = score_pairs(f, a, seen, link, s, w)
    assign(w.score, rows, seen.first[link + 1] - seen.first[link], w.row_of, w.work_f, w.work_i)
