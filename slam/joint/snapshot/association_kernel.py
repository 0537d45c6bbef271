"""Compiled: which measurement of a link came from which VT: scores, best assignment, belief propagation.

`associate` takes the assignment with the best sum of scores. `believe` takes marginals of all assignments, and how
likely each VT exists. Its messages have the names of the papers: beta from a legacy feature's measurements to its
association variable, xi from a new feature to that of its measurement, zeta from features to measurements, nu back;
each over its value for "missed", or "clutter".

Sources: Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999, chapter 6, for scores; Leitinger,
Meyer, Hlawatsch, Witrisal, Tufvesson and Win, "A belief propagation algorithm for multipath-based SLAM", IEEE Trans.
Wireless Communications 18, 2019, sections IV to VI; the message passing is that of Williams and Lau, "Approximate
evaluation of marginal association probabilities with belief propagation", IEEE Trans. Aerospace and Electronic Systems
50, 2014.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import lean
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.birth_kernel import possible
from cellslam.slam.joint.snapshot.observation_kernel import (
    Jacobian,
    believed,
    coordinates,
    field,
    geometry,
    roof_first,
    rotations_of,
)
from cellslam.slam.joint.snapshot.tentative_kernel import is_hypothesis
from cellslam.slam.joint.snapshot.update_kernel import LOG_2PI, Innovation, covariance, innovate, log_likelihood
from cellslam.slam.joint.state.layout import (
    BELIEF,
    BEYOND,
    EXISTS,
    HITS,
    IDENT,
    LAST,
    LINK,
    WEIGHT,
    ArrayErrors,
    Filter,
    Measured,
)
from cellslam.slam.model.arrays_kernel import log_sum
from cellslam.slam.model.assignment_kernel import assign
from cellslam.slam.model.matrices_kernel import Sym3, Vec3
from cellslam.slam.model.measurement_kernel import Rotations

NEARBY_M = 50.0  # walls next to each other make VTs that are so far apart, if they are two
ROUNDS, CLOSE = 200, 1e-7  # of message passing, at most, and logarithms by which messages may still change
SURE = 1.0 - 1e-9  # most that existence can be
FRESH, NO_BIRTH = -1, -2  # measurements of no VT: those that may begin one, and those that may not


class Messages(NamedTuple):
    """Memory for belief propagation (see `pass_messages`): `beta`, `zeta`, `nu`, `marginal` (C, m), `xi` (m,)."""

    beta: Floats
    zeta: Floats
    nu: Floats
    marginal: Floats
    xi: Floats


class Pairs(NamedTuple):
    """Memory for the pairs of a link: `score` (C, m), squared Mahalanobis distances `distance2` (C, m), infinite
    outside the gate, VTs `chosen` (C,) of its rows; of m measurements `row_of`, `gated`, `slot_of`; the assignment's
    `work_f` and `work_i`. By belief propagation: `messages`, and how likely a measurement began a VT, `exists` (m,)."""

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
def expect(f: Filter, a: ArrayErrors, j: int, offset: int, turned: Rotations, s: Jacobian) -> Expected:
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
    hph, spread = covariance(f, s), f.vts.spread[j]
    return Expected(
        Vec3(
            seen.distance + f.x[offset] + errors.x + roof.x, seen.azimuth + errors.y + roof.y,
            seen.elevation + errors.z + roof.z,
        ),
        Sym3(
            hph.xx + unmet.x + a.roof[0] ** 2 + spread[0], hph.xy + spread[1], hph.xz + spread[2],
            hph.yy + unmet.y + a.roof[1] ** 2 + spread[3], hph.yz + spread[4],
            hph.zz + unmet.z + a.roof[2] ** 2 + spread[5],
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
    other = math.log(NEARBY_M) - 0.5 * LOG_2PI if not math.isnan(z[0]) else 0.0
    other += math.log(NEARBY_M / max(range_m, 1.0)) - 0.5 * LOG_2PI if not math.isnan(z[1]) else 0.0
    return float(other - 0.5 * (distance2 + math.log(det)))


@lean
def score_pairs(f: Filter, a: ArrayErrors, seen: Measured, link: int, s: Jacobian, w: Pairs) -> int:
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
        weight = f.vts.anchor[j, WEIGHT]
        if f.vts.slots[j, LINK] != link or f.vts.slots[j, BEYOND] == 1 or weight == 0.0:
            continue
        row, kind, age = rows, 0 if f.vts.slots[j, HITS] < 2 else 1, min(seen.now - f.vts.slots[j, LAST], horizon)
        if weight < 1.0:  # one of several hypotheses of a VT, which is one row
            for r in range(rows):
                row = r if f.vts.slots[w.chosen[r], IDENT] == f.vts.slots[j, IDENT] else row
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
            detected = f.vts.anchor[j, EXISTS] * seen.rules.existence.detection
            odds = math.log(max(detected, 1e-300) / (1.0 - detected))
        prior = odds - rules.log_clutter + math.log(weight)
        returns = seen.now - f.vts.slots[j, LAST] > rules.away
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
                w.score[row, k - start] = log_sum(value, w.score[row, k - start])
    return rows


@lean
def associate(f: Filter, a: ArrayErrors, seen: Measured, link: int, s: Jacobian, w: Pairs) -> None:
    """Write into w.row_of (m,) the row of `chosen` for each measurement of a link, -1 none: the best sum of scores."""
    rows = score_pairs(f, a, seen, link, s, w)
    assign(w.score, rows, seen.first[link + 1] - seen.first[link], w.row_of, w.work_f, w.work_i)


@lean
def pass_messages(w: Messages, rows: int, columns: int) -> None:
    """Run the iterative data association.

    Taken: w.beta (R, m), messages of legacy features to their association variables, over that of a missed detection;
    w.xi (m,), message of the new feature of a measurement, over that of clutter (0: it can have none). Written: w.zeta
    and w.nu (R, m), messages from features to measurements and back; w.marginal (R, m): P(feature r made measurement
    c). Without loops (where of each pair that is possible at most one end has other partners) everything is exact.
    """
    beta, xi, zeta, nu = w.beta, w.xi, w.zeta, w.nu
    for r in range(rows):
        for c in range(columns):
            nu[r, c] = 1.0 / (1.0 + xi[c])
    for _ in range(ROUNDS):
        change = 0.0
        for r in range(rows):  # zeta = beta / (1 + sum of the other beta nu)
            total = _claims_of(beta[r], nu[r], columns)
            for c in range(columns):
                zeta[r, c] = beta[r, c] / max(total - beta[r, c] * nu[r, c], 1e-300)
        for c in range(columns):  # nu = 1 / (1 + xi + sum of the other zeta)
            total = _claims_on(xi[c], zeta[:, c], rows)
            for r in range(rows):
                value = 1.0 / max(total - zeta[r, c], 1e-300)
                change = max(change, abs(math.log(value / nu[r, c])))
                nu[r, c] = value
        if change < CLOSE:
            break
    for r in range(rows):
        total = _claims_of(beta[r], nu[r], columns)
        for c in range(columns):
            w.marginal[r, c] = beta[r, c] * nu[r, c] / total


@lean
def _claims_of(beta: Floats, nu: Floats, columns: int) -> float:
    """Return 1 + sum of beta nu over the measurements: what a feature's association variable sums to."""
    total = 1.0
    for c in range(columns):
        total += beta[c] * nu[c]
    return float(total)


@lean
def _claims_on(xi: float, zeta: Floats, rows: int) -> float:
    """Return 1 + xi + sum of zeta over the legacy features: what a measurement's association variable sums to."""
    total = 1.0 + xi
    for r in range(rows):
        total += zeta[r]
    return float(total)


@lean
def believe(f: Filter, a: ArrayErrors, seen: Measured, link: int, s: Jacobian, w: Pairs) -> None:
    """Write into w.slot_of (m,) the VT that more likely than not made each measurement of a link, FRESH or NO_BIRTH,
    and into w.exists (m,) how likely a new VT is that it began; VTs' existence is predicted and updated.

    Existence is a Markov chain of visible and hidden; only what was confirmed comes back (paper: survival probability).
    With r the probability that a VT exists and p_D that of its detection, a missed one exists with
    r (1 - p_D) / (1 - r p_D).
    """
    rules, offset, start = seen.rules.existence, f.core.first_offset + seen.site_of[link], seen.first[link]
    columns = seen.first[link + 1] - start
    for j in range(f.count[0]):
        if f.vts.slots[j, LINK] == link:
            back = rules.back if f.vts.slots[j, HITS] >= seen.rules.lifetime.confirm else 0.0
            exists = f.vts.anchor[j, EXISTS]
            f.vts.anchor[j, EXISTS] = exists * rules.stay + (1.0 - exists) * back
    rows, m = score_pairs(f, a, seen, link, s, w), w.messages
    for c in range(columns):
        m.xi[c] = rules.birth if possible(seen.births.z[start + c], f.x[offset]) else 0.0
        for r in range(rows):
            m.beta[r, c] = math.exp(min(w.score[r, c], 300.0))
    pass_messages(m, rows, columns)
    for c in range(columns):
        w.exists[start + c] = m.xi[c] / _claims_on(m.xi[c], m.zeta[:, c], rows)
        w.slot_of[start + c] = FRESH if w.exists[start + c] >= rules.drop else NO_BIRTH
    for r in range(rows):
        detected, j = 0.0, w.chosen[r]
        for c in range(columns):
            detected += m.marginal[r, c]
            if m.marginal[r, c] > 0.5:
                w.slot_of[start + c] = j
        exists = f.vts.anchor[j, EXISTS]
        silent = exists * (1.0 - rules.detection) / (1.0 - exists * rules.detection)
        exists = min(detected + (1.0 - detected) * silent, SURE)
        for i in range(f.count[0]):
            if is_hypothesis(f, i, link, f.vts.slots[j, IDENT]):
                f.vts.anchor[i, EXISTS] = exists
