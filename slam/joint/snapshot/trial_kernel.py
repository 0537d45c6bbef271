"""Compiled: VTs on trial. They learn where they are, but have no say in where the vehicle is.

A VT that is not known yet is a Gaussian sum: several guesses of one identity, with a share of the probability each, of
which time leaves one: around a circle where its azimuth was not measured, ahead where its distance was not; and, where
paths may be scattered, a mirror image and a scatterer. While guesses are left, measurements correct them and their
shares, but not the pose or the clock offset, which are considered only: whatever a wrong guess would teach does no
harm.

Where paths may be scattered nobody has promised either that each of them is of one of both kinds. There a VT has its
say while its track score is positive, the log-odds that it is what it is taken for:

    score <- score + min(log N(e; 0, S) - log clutter, log N(e; 0, S) - log N(e; 0, WORSE^2 S))

It is something else if its measurements are as likely as clutter, or likelier of a thing whose errors are WORSE times
as large: one that moves, or several. It begins at UNTRIED, has its say from 0 on, when the score becomes MOST_SCORE,
and ends where the score is below 0 again. What fits no longer is so dropped after some measurements, and what never did
has taught nothing.

Sources: Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE Trans. Automatic
Control 17(4), 1972; Schmidt, "Application of state-space methods to navigation problems", 1966 (considered states);
Sittler, "An optimal data association problem in surveillance theory", IEEE Trans. Military Electronics 8, 1964, and
Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999, section 6.2 (track score).
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import lean, part
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.slam.joint.snapshot.sight_kernel import Sight
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
    LIGHT,
    LINK,
    MOST_SCORE,
    SCORE,
    SHARE,
    VT,
    ArrayErrors,
    Filter,
    Rules,
)
from cellslam.slam.model.arrays_kernel import put
from cellslam.slam.model.matrices_kernel import Vec3, cholesky, solved, sym_plus

LEAST = 1e-5  # share below which a guess is given up
LEAST_KIND = 1e-3  # the same, where each guess is of a kind: a wrong choice shows, and is dropped
AGREE = 0.5  # guesses this close, in their deviations, are one
UNTRIED = -4.5  # log-odds that a measurement which nothing explains is of a VT that will fit
LOST = -9.0  # of one on trial: it is given up
WORSE = 3.0  # times as large as they should be
MOST_LOSS = 1.5  # by one measurement: the vehicle may have slipped, not the VT


@lean
def is_guess(f: Filter, i: int, link: int, ident: int) -> bool:
    """Return whether VT i is a guess of this VT."""
    return bool(f.vts.slots[i, IDENT] == ident and f.vts.slots[i, LINK] == link)


@lean
def try_out(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, against: float, rules: Rules,
    s: Sight, w: Pending,
) -> float:  # fmt: skip
    """Update the guesses of the VT that j is one of by a measurement; return its log-density.

    against: what is to be added to that for the log-ratio to clutter. Guesses given up have the share 0.
    """
    slots, share, score = f.vts.slots, f.vts.anchor[:, SHARE], f.vts.anchor[:, SCORE]
    link, ident, last, hits = slots[j, LINK], slots[j, IDENT], slots[j, LAST], slots[j, HITS]
    if len(f.particles.weight) == 0 and (share[j] < 1.0 or score[j] <= 0.0):
        settle(f, w)  # the rows of a filter with particles are needed until these are updated, too
    best, worse = -math.inf, -math.inf
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            slots[i, LAST], slots[i, HITS] = last, hits
            if share[i] > 0.0:
                e, hph = compare(f, a, i, offset, measurement, s, w)
                new = innovate(e, measurement.q, hph if share[j] < 1.0 else sym_plus(hph, spread_of(f, i, e)))
                distance2, log_det = log_likelihood(new)
                log_share, log_root = math.log(share[i]), 0.5 * (log_det + new.measured * LOG_2PI)
                share[i] = log_share + max(-0.5 * distance2 - log_root, -1e6)
                best = max(best, share[i])
                wide = log_share - 0.5 * distance2 / WORSE**2 - log_root - new.measured * math.log(WORSE)
                worse = max(worse, wide) + math.log1p(math.exp(-abs(worse - wide)))
            else:
                share[i] = -math.inf
    total = 0.0
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] = math.exp(share[i] - best)
            total += share[i]
    fit = best + math.log(total)
    left, only = _unite(f, link, ident, total, LEAST_KIND if rules.scatterers else LEAST)
    if left == 1:
        share[only] = 1.0
    has_say = _judge(f, link, ident, min(fit + against, fit - worse)) if rules.scatterers else left == 1
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident) and share[i] > 0.0:
            if has_say:
                correct(f, a, i, offset, measurement, share[i], rules, s, w)
            else:
                e, hph = compare(f, a, i, offset, measurement, s, w)
                consider(f, i, innovate(e, measurement.q, hph), e, w)
    return fit


@lean
def _judge(f: Filter, link: int, ident: int, gain: float) -> bool:
    """Add to the track score of a VT; return whether it has a say. One that is lost has no share any more."""
    score, says = f.vts.anchor[:, SCORE], False
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            tried, after = score[i] > 0.0, score[i] + max(gain, -MOST_LOSS)
            score[i] = MOST_SCORE if after >= 0.0 and not tried else min(after, MOST_SCORE)
            if after <= (0.0 if tried else LOST):
                f.vts.anchor[i, SHARE] = 0.0
            says = says or score[i] > 0.0
    return says


@lean
def _unite(f: Filter, link: int, ident: int, total: float, least: float) -> tuple[int, int]:
    """Make the shares of a VT's guesses sum to one, give up those below the `least` one and doubles; return how many
    are left, and the last of them."""
    share = f.vts.anchor[:, SHARE]
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] = share[i] / total if share[i] > least * total else 0.0
    for a in range(f.count[0]):
        if not is_guess(f, a, link, ident) or share[a] == 0.0:
            continue
        for b in range(f.count[0]):
            if b == a or not is_guess(f, b, link, ident) or share[b] == 0.0:
                continue
            if share[b] > share[a] or not _agree(f, a, b):
                continue
            share[a] += share[b]
            share[b] = 0.0
    left, last, total = 0, -1, 0.0
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident) and share[i] > 0.0:
            left, last = left + 1, i
            total += share[i]
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] /= total
    return left, last


@lean
def _agree(f: Filter, i: int, j: int) -> bool:
    """Return whether two guesses of one VT are the same by now."""
    if f.vts.slots[i, LIGHT] != f.vts.slots[j, LIGHT]:
        return False
    for c in range(3):
        a, b = f.vts.state[i, VT + c], f.vts.state[j, VT + c]
        gap = wrap(f.x[a] - f.x[b]) if c == 1 else f.x[a] - f.x[b]
        if gap * gap > AGREE * AGREE * (f.p[a, a] + f.p[b, b]):
            return False
    return True


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
