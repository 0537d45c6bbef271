"""Compiled: one snapshot by belief propagation: association probabilities by message passing, soft updates, existence.

Source: Leitinger, Meyer, Hlawatsch, Witrisal, Tufvesson and Win, "A belief propagation algorithm for multipath-based
SLAM",
IEEE Trans. Wireless Communications 18, 2019, sections IV to VI; the message passing of the association is that of
Williams and Lau, "Approximate evaluation of marginal association probabilities with belief propagation", IEEE Trans.
Aerospace and Electronic Systems 50, 2014. Messages have the names of these papers: beta from a legacy feature's
measurements to its association variable, xi from a new feature to that of its measurement, zeta from features to
measurements, nu back; each over its value for "missed", or "clutter".
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.ekf_slam.association_kernel import log_density
from cellslam.slam.ekf_slam.map_kernel import add, remove
from cellslam.slam.ekf_slam.state_layout import (
    EXISTS,
    HITS,
    IDENT,
    LAST,
    LINK,
    BeliefScratch,
    Filter,
    Measured,
    Rules,
    one_of,
    states,
)
from cellslam.slam.ekf_slam.update_kernel import Innovation, expect, innovate, log_likelihood
from cellslam.slam.ekf_slam.vt_kernel import covariance, predict, rotations_of
from cellslam.slam.model.matrices_kernel import (
    Sym3,
    Vec3,
    adjugate,
    determinant,
    outer,
    sym_minus,
    sym_plus,
    sym_scaled,
    sym_vec,
    vec_plus,
    vec_scaled,
)

ROUNDS, CLOSE = 200, 1e-7
SURE = 1.0 - 1e-9  # most that existence can be
NEGLIGIBLE = 1e-4  # probability below which an association moves nothing


@njit(cache=True)
def pass_messages(w: BeliefScratch, rows: int, columns: int) -> float:
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


@njit(cache=True)
def _claims_of(beta: Floats, nu: Floats, columns: int) -> float:
    """Return 1 + sum of beta nu over the measurements: what a feature's association variable sums to."""
    total = 1.0
    for c in range(columns):
        total += beta[c] * nu[c]
    return float(total)


@njit(cache=True)
def _claims_on(xi: float, zeta: Floats, rows: int) -> float:
    """Return 1 + xi + sum of zeta over the legacy features: what a measurement's association variable sums to."""
    total = 1.0 + xi
    for r in range(rows):
        total += zeta[r]
    return float(total)


@njit(cache=True)
def _evaluate(f: Filter, seen: Measured, link: int, w: BeliefScratch) -> tuple[int, float]:
    """Predict the existence of a link's features, write their messages w.beta; return rows and log of missing all.

    Existence is a Markov chain of visible and hidden; only what was confirmed comes back (paper: survival probability).
    With r the probability that a feature exists and p_D that of its detection, a missed detection has 1 - r p_D, and
    beta is r p_D f(z | feature) / (clutter density) over that.
    """
    rules, turned, offset = seen.rules, rotations_of(f), f.core.first_offset + seen.site_of[link]
    rows, missed = 0, 0.0
    for j in range(f.count[0]):
        if f.slots[j, LINK] != link:
            continue
        exists = f.anchor[j, EXISTS]
        exists = exists * rules.stay + (1.0 - exists) * (rules.back if f.slots[j, HITS] >= rules.confirm else 0.0)
        f.anchor[j, EXISTS] = exists
        silent = 1.0 - exists * rules.detection
        missed += math.log(silent)
        scale = math.log(max(exists * rules.detection / silent, 1e-300)) - rules.log_clutter
        expected = predict(f, j, turned, w.h)
        hph = covariance(f, j, offset, w.h, w.narrow)
        w.chosen[rows] = j
        for k in range(seen.first[link], seen.first[link + 1]):
            value = scale - seen.gap[k] + log_density(f, seen, k, offset, expected, hph)
            w.beta[rows, k - seen.first[link]] = math.exp(min(value, 300.0))
        rows += 1
    return rows, missed


@njit(cache=True)
def _may_begin(f: Filter, seen: Measured, link: int, association: Ints, w: BeliefScratch) -> None:
    """Write the messages w.xi of new features: the odds of birth where a measurement points to a place, 0 else."""
    offset = f.core.first_offset + seen.site_of[link]
    for k in range(seen.first[link], seen.first[link + 1]):
        z = seen.begin[k]
        whole = not math.isnan(z[1]) and z[0] - f.x[offset] > 1.0
        w.xi[k - seen.first[link]] = seen.rules.birth if whole else 0.0
        association[k] = -1


@njit(cache=True)
def soft_update(f: Filter, seen: Measured, link: int, j: int, share: Floats, w: BeliefScratch) -> float:
    """Update the whole state by one feature's measurements, each with its probability share (m,); return evidence.

    The mixture over "missed" and each measurement is replaced by the Gaussian of its mean and covariance: with S_c the
    innovation covariance and w_c = S_c^-1 e_c, the mean moves by T^T sum(share w), the covariance becomes P - T^T M T
    with M = sum(share S_c^-1) - sum(share w w^T) + mean(w) mean(w)^T. The evidence is what the log-likelihood of
    persisting errors lacks against that of fresh draws.
    """
    x, p, t, offset, evidence = f.x, f.p, w.t, f.core.first_offset + seen.site_of[link], 0.0
    expected, hph = expect(f, j, offset, w.h, t)
    mean, m = Vec3(0.0, 0.0, 0.0), Sym3(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for k in range(seen.first[link], seen.first[link + 1]):
        part, z = share[k - seen.first[link]], seen.z[k]
        if part < NEGLIGIBLE:
            continue
        distance2, log_det = log_likelihood(innovate(z, seen.single[k], expected, x[offset], hph))
        evidence += 0.5 * part * (distance2 + log_det)
        many = innovate(z, seen.many[k], expected, x[offset], hph)
        distance2, log_det = log_likelihood(many)
        evidence += part * (seen.lack[k] - 0.5 * (distance2 + log_det))
        whitened, information = _whitened(many, z)
        mean = vec_plus(mean, vec_scaled(whitened, part))
        m = sym_plus(m, sym_scaled(sym_minus(information, outer(whitened)), part))
    m = sym_plus(m, outer(mean))
    size = states(f)
    for n in range(size):
        x[n] += t[0, n] * mean.x + t[1, n] * mean.y + t[2, n] * mean.z
    for i in range(size):
        ti = Vec3(t[0, i], t[1, i], t[2, i])
        if ti.x == 0.0 and ti.y == 0.0 and ti.z == 0.0:
            continue
        u = sym_vec(m, ti)
        for n in range(i, size):
            p[i, n] = p[n, i] = p[i, n] - (u.x * t[0, n] + u.y * t[1, n] + u.z * t[2, n])
    return evidence


@njit(cache=True)
def _whitened(i: Innovation, z: Floats) -> tuple[Vec3, Sym3]:
    """Return w = S^-1 e, and S^-1 of the measured components, zero elsewhere."""
    a = adjugate(i.s)
    det = determinant(i.s, a)
    w = sym_vec(a, i.e)
    information = Sym3(
        0.0 if math.isnan(z[0]) else a.xx / det, a.xy / det, a.xz / det,
        0.0 if math.isnan(z[1]) else a.yy / det, a.yz / det,
        0.0 if math.isnan(z[2]) else a.zz / det,
    )  # fmt: skip
    return Vec3(w.x / det, w.y / det, w.z / det), information


@njit(cache=True)
def _believe_feature(f: Filter, seen: Measured, link: int, row: int, association: Ints, w: BeliefScratch) -> float:
    """Update the existence and the state of the feature that has this row; return the evidence.

    It exists if it was seen, or missed in spite of it: r (1 - p_D) / (1 - r p_D).
    """
    j, start, marginal, rules = w.chosen[row], seen.first[link], w.marginal[row], seen.rules
    detected, best, evidence = 0.0, 0, 0.0
    for c in range(seen.first[link + 1] - start):
        detected += marginal[c]
        if marginal[c] > marginal[best]:
            best = c
    exists = f.anchor[j, EXISTS]
    silent = exists * (1.0 - rules.detection) / (1.0 - exists * rules.detection)
    f.anchor[j, EXISTS] = min(detected + (1.0 - detected) * silent, SURE)
    if detected > NEGLIGIBLE:
        evidence = soft_update(f, seen, link, j, marginal, w)
    if detected > 0.5:
        f.slots[j, LAST] = seen.now
        f.slots[j, HITS] += 1
        if marginal[best] > 0.5:
            association[start + best] = f.slots[j, IDENT]
    return evidence


@njit(cache=True)
def _begin(f: Filter, seen: Measured, link: int, rows: int, w: BeliefScratch) -> None:
    """Add the new features that are likely enough: xi over what all claim on the measurement."""
    rules, offset = seen.rules, f.core.first_offset + seen.site_of[link]
    for k in range(seen.first[link], seen.first[link + 1]):
        c = k - seen.first[link]
        exists = w.xi[c] / _claims_on(w.xi[c], w.zeta[:, c], rows)
        if exists >= rules.drop and add(
            f, seen.now, rules.confirm, link, offset, seen.born + k, seen.begin[k], seen.begin_q[k], True
        ):
            f.anchor[f.count[0] - 1, EXISTS] = exists


@njit(cache=True)
def _give_up(f: Filter, rules: Rules) -> None:
    """Drop the unconfirmed features that hardly exist."""
    j = np.int64(0)  # a literal would have `remove` compiled twice
    while j < f.count[0]:
        if f.anchor[j, EXISTS] < rules.drop and f.slots[j, HITS] < rules.confirm:
            remove(f, int(j))
        else:
            j += 1


@njit(cache=True)
def believe_snapshot(filters: Filter, seen: Measured, log_weight: Floats, association: Ints, w: BeliefScratch) -> None:
    """Use one snapshot in the K filters of a bank, link by link.

    log_weight (K,) is added to, association (K, m) written: identities of VTs.
    """
    for k in range(len(filters.x)):
        f, total = one_of(filters, k), 0.0
        for link in range(len(seen.first) - 1):
            if f.links[link] == 0:
                continue
            rows, missed = _evaluate(f, seen, link, w)
            _may_begin(f, seen, link, association[k], w)
            total += missed
            total += pass_messages(w, rows, seen.first[link + 1] - seen.first[link])
            for row in range(rows):
                total += _believe_feature(f, seen, link, row, association[k], w)
            _begin(f, seen, link, rows, w)
        _give_up(f, seen.rules)
        log_weight[k] += total
