"""Compiled: association and existence by belief propagation.

Source: Leitinger, Meyer, Hlawatsch, Witrisal, Tufvesson and Win, "A belief propagation algorithm for multipath-based
SLAM", IEEE Trans. Wireless Communications 18, 2019, sections IV to VI; the message passing of the association is that
of Williams and Lau, "Approximate evaluation of marginal association probabilities with belief propagation", IEEE Trans.
Aerospace and Electronic Systems 50, 2014. Messages have the names of these papers: beta from a legacy feature's
measurements to its association variable, xi from a new feature to that of its measurement, zeta from features to
measurements, nu back; each over its value for "missed", or "clutter".
"""

from __future__ import annotations

import math

from cellslam.sim.compiling import lean
from cellslam.sim.recording import Floats
from cellslam.slam.joint.snapshot.association_kernel import FRESH, TAKEN, Messages, Pairs, score_pairs
from cellslam.slam.joint.snapshot.guess_kernel import is_guess, possible
from cellslam.slam.joint.snapshot.sight_kernel import Sight
from cellslam.slam.joint.state.layout import EXISTS, HITS, IDENT, LINK, ArrayErrors, Filter, Measured

ROUNDS, CLOSE = 200, 1e-7
SURE = 1.0 - 1e-9  # most that existence can be


@lean
def pass_messages(w: Messages, rows: int, columns: int) -> float:
    """Run the iterative data association; return the logarithm of the Bethe approximation of its normaliser.

    Taken: w.beta (R, m), messages of legacy features to their association variables, over that of a missed detection;
    w.xi (m,), message of the new feature of a measurement, over that of clutter (0: it can have none). Written: w.zeta
    and w.nu (R, m), messages from features to measurements and back; w.marginal (R, m): P(feature r made measurement
    c). Without loops (a feature or measurement in doubt at most at one end) everything is exact.
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
    log_z = 0.0
    for r in range(rows):
        total = _claims_of(beta[r], nu[r], columns)
        log_z += math.log(total)
        for c in range(columns):
            w.marginal[r, c] = beta[r, c] * nu[r, c] / total
    for c in range(columns):
        for r in range(rows):
            log_z -= math.log1p(zeta[r, c] * nu[r, c])
        log_z += math.log(_claims_on(xi[c], zeta[:, c], rows))
    return log_z


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
def believe(f: Filter, a: ArrayErrors, seen: Measured, link: int, s: Sight, w: Pairs) -> None:
    """Write into w.slot_of (m,) the VT that more likely than not made each measurement of a link, FRESH or TAKEN, and
    into w.exists (m,) how likely a new VT is that it began; VTs' existence is predicted and updated.

    Existence is a Markov chain of visible and hidden; only what was confirmed comes back (paper: survival probability).
    With r the probability that a VT exists and p_D that of its detection, a missed one exists with
    r (1 - p_D) / (1 - r p_D).
    """
    rules, offset, start = seen.rules.existence, f.core.first_offset + seen.site_of[link], seen.first[link]
    columns = seen.first[link + 1] - start
    for j in range(f.count[0]):
        if f.slots[j, LINK] == link:
            back = rules.back if f.slots[j, HITS] >= seen.rules.lifetime.confirm else 0.0
            exists = f.anchor[j, EXISTS]
            f.anchor[j, EXISTS] = exists * rules.stay + (1.0 - exists) * back
    rows, m = score_pairs(f, a, seen, link, s, w), w.messages
    for c in range(columns):
        m.xi[c] = rules.birth if possible(seen.births.z[start + c], f.x[offset]) else 0.0
        for r in range(rows):
            m.beta[r, c] = math.exp(min(w.score[r, c], 300.0))
    pass_messages(m, rows, columns)
    for c in range(columns):
        w.exists[start + c] = m.xi[c] / _claims_on(m.xi[c], m.zeta[:, c], rows)
        w.slot_of[start + c] = FRESH if w.exists[start + c] >= rules.drop else TAKEN
    for r in range(rows):
        detected, j = 0.0, w.chosen[r]
        for c in range(columns):
            detected += m.marginal[r, c]
            if m.marginal[r, c] > 0.5:
                w.slot_of[start + c] = j
        exists = f.anchor[j, EXISTS]
        silent = exists * (1.0 - rules.detection) / (1.0 - exists * rules.detection)
        exists = min(detected + (1.0 - detected) * silent, SURE)
        for i in range(f.count[0]):
            if is_guess(f, i, link, f.slots[j, IDENT]):
                f.anchor[i, EXISTS] = exists
