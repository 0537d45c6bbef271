"""Compiled: VTs that are tentative: measurements correct them, but not the vehicle.

A VT that is not known yet is a Gaussian sum: several hypotheses with one identity, each with a weight, of which time
leaves one: around a circle where its azimuth was not measured, ahead where its distance was not; and, where paths may
be scattered, a mirror image and a scatterer. While several hypotheses are left, measurements correct them and their
weights, but not the pose or the clock offset, which are considered only: a wrong hypothesis does no harm.

Where paths may be scattered nobody has promised either that each of them is of one of both kinds. There the track score
of a VT confirms it, and deletes it: the log-odds that it is what it is taken for,

    score <- score + min(log N(e; 0, S) - log clutter, log N(e; 0, S) - log N(e; 0, INFLATION^2 S))

It is something else if its measurements are as likely as clutter, or likelier of a thing whose errors are INFLATION
times as large: one that moves, or several. The score begins at FIRST_SCORE. A VT is tentative until its score reaches
0; then it is confirmed, and its score is MOST_SCORE. It is deleted where the score falls below DELETED, or below 0 once
it was confirmed. So what fits no longer is dropped after some measurements, and what never did has taught nothing.

Sources: Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE Trans. Automatic
Control 17(4), 1972; Schmidt, "Application of state-space methods to navigation problems", 1966 (considered states);
Sittler, "An optimal data association problem in surveillance theory", IEEE Trans. Military Electronics 8, 1964, and
Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999, section 6.2 (track score); Bar-Shalom,
Willett and Tian, Tracking and Data Fusion, 2011 (tentative, confirmed and deleted tracks).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import lean, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.slam.joint.snapshot.observation_kernel import Jacobian
from cellslam.slam.joint.snapshot.update_kernel import (
    LOG_2PI,
    BlockMeasurement,
    Innovation,
    Pending,
    blank,
    compare,
    correct,
    innovate,
    log_likelihood,
    settle,
    spread_of,
)
from cellslam.slam.joint.state.layout import (
    HITS,
    IDENT,
    LAST,
    LINK,
    MOST_SCORE,
    SCATTERER,
    SCORE,
    VT,
    WEIGHT,
    ArrayErrors,
    Filter,
    Rules,
)
from cellslam.slam.model.arrays_kernel import log_sum, put
from cellslam.slam.model.matrices_kernel import Vec3, cholesky, solved, sym_plus

LEAST_WEIGHT = 1e-5  # of a hypothesis: one with less is given up
LEAST_WEIGHT_OF_KIND = 1e-3  # the same, where each is of a kind: a wrong choice shows, and is dropped
CLOSE = 0.5  # hypotheses this close, in their deviations, are one
FIRST_SCORE = -4.5  # log-odds that a measurement which nothing explains is of a VT that will fit
DELETED = -9.0  # score of a tentative VT that is given up
INFLATION = 3.0  # times as large as they should be
MOST_LOSS = 1.5  # of score by one measurement: the vehicle may have slipped, not the VT


@lean
def is_hypothesis(f: Filter, i: int, link: int, ident: int) -> bool:
    """Return whether VT i is a hypothesis of this VT."""
    return bool(f.vts.slots[i, IDENT] == ident and f.vts.slots[i, LINK] == link)


@lean
def update_hypotheses(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, against: float, rules: Rules,
    s: Jacobian, w: Pending,
) -> float:  # fmt: skip
    """Update the hypotheses of the VT that j is one of by a measurement; return its log-density.

    against: what is to be added to that for the log-ratio to clutter. Hypotheses given up have the weight 0.
    """
    slots, weight = f.vts.slots, f.vts.anchor[:, WEIGHT]
    link, ident = slots[j, LINK], slots[j, IDENT]
    if len(f.particles.weight) == 0 and (weight[j] < 1.0 or f.vts.anchor[j, SCORE] <= 0.0):
        settle(f, w)  # the rows of a filter with particles are needed until these are updated, too
    fit, inflated = _weigh(f, a, j, offset, measurement, s, w)
    left = _prune(f, link, ident, LEAST_WEIGHT_OF_KIND if rules.scatterers else LEAST_WEIGHT)
    confirmed = _score_track(f, link, ident, min(fit + against, fit - inflated)) if rules.scatterers else left == 1
    for i in range(f.count[0]):
        if is_hypothesis(f, i, link, ident) and weight[i] > 0.0:
            slots[i, LAST], slots[i, HITS] = slots[j, LAST], slots[j, HITS]
            if confirmed:
                correct(f, a, i, offset, measurement, weight[i], rules, s, w)
            else:
                e, hph = compare(f, a, i, offset, measurement, s, w)
                consider(f, i, innovate(e, measurement.q, hph), e, w)
    return fit


@lean
def _weigh(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, s: Jacobian, w: Pending
) -> tuple[float, float]:
    """Multiply the weights of a VT's hypotheses, of which j is one, by the likelihoods of a measurement; they sum to
    one. Return the logarithms of its density, and of that with inflated errors."""
    weight, link, ident = f.vts.anchor[:, WEIGHT], f.vts.slots[j, LINK], f.vts.slots[j, IDENT]
    fit, inflated, several = -math.inf, -math.inf, weight[j] < 1.0
    for i in range(f.count[0]):
        if is_hypothesis(f, i, link, ident) and weight[i] > 0.0:
            e, hph = compare(f, a, i, offset, measurement, s, w)
            new = innovate(e, measurement.q, hph if several else sym_plus(hph, spread_of(f, i, e)))
            distance2, log_det = log_likelihood(new)
            log_weight, log_root = math.log(weight[i]), 0.5 * (log_det + new.measured * LOG_2PI)
            weight[i] = log_weight + max(-0.5 * distance2 - log_root, -1e6)
            fit = log_sum(fit, weight[i])
            wide = -0.5 * distance2 / INFLATION**2 - log_root - new.measured * math.log(INFLATION)
            inflated = log_sum(inflated, log_weight + wide)
        elif is_hypothesis(f, i, link, ident):
            weight[i] = -math.inf
    for i in range(f.count[0]):
        if is_hypothesis(f, i, link, ident):
            weight[i] = math.exp(weight[i] - fit)
    return fit, inflated


@lean
def _prune(f: Filter, link: int, ident: int, least: float) -> int:
    """Give up hypotheses of a VT with less than the `least` weight, merge those that are close; return how many are
    left."""
    weight, left, total = f.vts.anchor[:, WEIGHT], 0, 0.0
    for i in range(f.count[0]):
        if is_hypothesis(f, i, link, ident) and weight[i] <= least:
            weight[i] = 0.0
    for a in range(f.count[0]):
        if not is_hypothesis(f, a, link, ident) or weight[a] == 0.0:
            continue
        for b in range(f.count[0]):
            if b == a or not is_hypothesis(f, b, link, ident) or weight[b] == 0.0:
                continue
            if weight[b] <= weight[a] and _close(f, a, b):
                weight[a] += weight[b]
                weight[b] = 0.0
    for i in range(f.count[0]):
        if is_hypothesis(f, i, link, ident) and weight[i] > 0.0:
            left += 1
            total += weight[i]
    for i in range(f.count[0]):
        if is_hypothesis(f, i, link, ident):
            weight[i] /= total
    return left


@lean
def _close(f: Filter, i: int, j: int) -> bool:
    """Return whether two hypotheses of one VT are the same by now."""
    if f.vts.slots[i, SCATTERER] != f.vts.slots[j, SCATTERER]:
        return False
    for c in range(3):
        a, b = f.vts.state[i, VT + c], f.vts.state[j, VT + c]
        gap = wrap(f.x[a] - f.x[b]) if c == 1 else f.x[a] - f.x[b]
        if gap * gap > CLOSE * CLOSE * (f.p[a, a] + f.p[b, b]):
            return False
    return True


@lean
def _score_track(f: Filter, link: int, ident: int, gain: float) -> bool:
    """Add to the track score of a VT; return whether it is confirmed. The hypotheses of one that is deleted have the
    weight 0."""
    score, confirmed = f.vts.anchor[:, SCORE], False
    for i in range(f.count[0]):
        if is_hypothesis(f, i, link, ident):
            before, after = score[i] > 0.0, score[i] + max(gain, -MOST_LOSS)
            score[i] = MOST_SCORE if after >= 0.0 and not before else min(after, MOST_SCORE)
            if after <= (0.0 if before else DELETED):
                f.vts.anchor[i, WEIGHT] = 0.0
            confirmed = confirmed or score[i] > 0.0
    return confirmed


@part
def consider(f: Filter, j: int, new: Innovation, e: Vec3, w: Pending) -> None:
    """Update VT j alone by an innovation, T being in w.t, and e with NaN where not measured; all else is considered:
    covariances with it change, its own do not."""
    p, t, at, n = f.p, w.t, f.vts.state[j], f.size[0]
    root = cholesky(new.s)
    if root.xx == 0.0:
        return
    blank(w, e)
    whitened = solved(root, new.e)
    for i in range(n):
        u = solved(root, Vec3(t[0, i], t[1, i], t[2, i]))
        t[0, i], t[1, i], t[2, i] = u.x, u.y, u.z
    own = np.empty((3, n))
    for c in range(3):
        i = at[VT + c]
        w.added[i] += t[0, i] * whitened.x + t[1, i] * whitened.y + t[2, i] * whitened.z
        for k in range(n):
            own[c, k] = p[i, k] - (t[0, i] * t[0, k] + t[1, i] * t[1, k] + t[2, i] * t[2, k])
    for c in range(3):
        i = at[VT + c]
        put(p[i], own[c])
        put(p[:, i], own[c])
