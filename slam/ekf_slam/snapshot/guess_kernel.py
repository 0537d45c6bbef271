"""Compiled: VTs whose direction or distance was not measured: several guesses, of which time leaves one.

A lone distance begins VTs around the circle, a lone direction begins VTs at distances that double, all of them with one
identity and a share of the probability each: a Gaussian sum for one VT. While guesses are left, measurements correct
them and their shares, but not the pose or the clock offset, which are considered only: whatever a wrong guess would
teach does no harm. Guesses that agree become one, and the last one is a VT like any other.

Sources: Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE Trans. Automatic
Control 17(4), 1972; Sola et al., "Undelayed initialization in bearing only SLAM", IROS 2005 (distances that grow
geometrically); Schmidt, "Application of state-space methods to navigation problems", 1966 (considered states).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.frames.frames_kernel import TURN, wrap
from cellslam.sim.recording import Floats
from cellslam.slam.ekf_slam.snapshot.birth_kernel import add
from cellslam.slam.ekf_slam.snapshot.sight_kernel import Sight
from cellslam.slam.ekf_slam.snapshot.update_kernel import (
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
)
from cellslam.slam.ekf_slam.state.layout import (
    HITS,
    IDENT,
    LAST,
    LINK,
    SHARE,
    VT,
    ArrayErrors,
    Block,
    Filter,
    Measured,
    Rules,
)
from cellslam.slam.model.copy_kernel import put
from cellslam.slam.model.matrices_kernel import Vec3, cholesky, solved

AROUND, AHEAD = 20, 7  # guesses of an azimuth, of a distance
NEAREST_M, FARTHER = 15.0, 2.0  # first distance, ratio of one to the next
WIDTH = 0.5  # deviation of a guess, in distances of neighbours
LEAST = 1e-5  # share below which a guess is given up
AGREE = 0.5  # guesses this close, in their deviations, are one


@lean
def possible(z: Floats, b: float) -> bool:
    """Return whether a VT can begin with a measurement z (3,): its distance, its azimuth or both are known.

    A distance must be 1 m beyond the clock offset b (m).
    """
    return z[0] - b > 1.0 or (math.isnan(z[0]) and not math.isnan(z[1]))


class Births(NamedTuple):
    """Measurements as VTs begin with them: `z` (m, 3) in m and rad, NaN where none may begin; variances `q` (m,
    3); and how many `guesses` there are, if all of them begin, of VTs of which a distance or an azimuth is not
    known."""

    z: Floats
    q: Floats
    guesses: int


@njit(cache=True)
def births(z: Floats, q: Floats, begins: NDArray[np.bool_], flat: float) -> Births:
    """Return measurements as VTs begin with them: those that may (m,), on the horizon where there is no elevation.

    z (m, 3): in m and rad, NaN where not measured; q (m, 3): variances; flat: that of an elevation not measured, rad^2.
    """
    z, q, guesses = z.copy(), q.copy(), 0
    for k in range(len(z)):
        if math.isnan(z[k, 2]):
            z[k, 2], q[k, 2] = 0.0, flat
        if not begins[k]:
            z[k] = math.nan
        elif math.isnan(z[k, 0]) != math.isnan(z[k, 1]):
            guesses += AROUND if math.isnan(z[k, 1]) else AHEAD
    return Births(z, q, guesses)


@part
def begin(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, link: int, ident: int, k: int, s: Sight, w: Pending
) -> None:
    """Give birth to a VT, or to its guesses, with measurement k of a snapshot."""
    z, q = seen.begin[k], seen.fresh[k]
    ranged = not math.isnan(z[0])
    whole = ranged and not math.isnan(z[1])
    guesses = 1 if whole else (AROUND if ranged else AHEAD)
    guess, wide = z.copy(), q.copy()
    if guesses > 1 and not _room_for(f, guesses):
        return
    for n in range(guesses):
        if not ranged:
            guess[0] = NEAREST_M * FARTHER**n
            wide[0] = (WIDTH * math.log(FARTHER) * guess[0]) ** 2
        elif not whole:
            guess[1] = TURN * n / AROUND
            wide[1] = (WIDTH * TURN / AROUND) ** 2
        if add(f, a, b, seen, link, ident, k, guess, wide, ranged, s, w):
            f.anchor[f.count[0] - 1, SHARE] = 1.0 / guesses


@lean
def _room_for(f: Filter, guesses: int) -> bool:
    """Return whether so many VTs can be added without that others make room."""
    return bool(f.count[0] + guesses <= len(f.slots) and f.size[0] + 3 * guesses <= len(f.x))


@lean
def is_guess(f: Filter, i: int, link: int, ident: int) -> bool:
    """Return whether VT i is a guess of this VT."""
    return bool(f.slots[i, IDENT] == ident and f.slots[i, LINK] == link)


@lean
def correct_guesses(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, rules: Rules, s: Sight, w: Pending
) -> float:
    """Update the guesses of the VT that j is one of by a measurement; return its log-density.

    Guesses given up have the share 0.
    """
    if len(f.weight) == 0:  # the rows of a filter with particles are needed until these are updated, too
        settle(f, w)
    link, ident, last, hits, share = (
        f.slots[j, LINK],
        f.slots[j, IDENT],
        f.slots[j, LAST],
        f.slots[j, HITS],
        f.anchor[:, SHARE],
    )
    best = -math.inf
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            f.slots[i, LAST], f.slots[i, HITS] = last, hits
            if share[i] > 0.0:
                e, hph = compare(f, a, i, offset, measurement, s, w)
                new = innovate(e, measurement.q, hph)
                distance2, log_det = log_likelihood(new)
                share[i] = math.log(share[i]) + max(-0.5 * (distance2 + log_det + new.measured * LOG_2PI), -1e6)
                best = max(best, share[i])
            else:
                share[i] = -math.inf
    total = 0.0
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] = math.exp(share[i] - best)
            total += share[i]
    left, only = _unite(f, link, ident, total)
    if left == 1:
        share[only] = 1.0
        correct(f, a, only, offset, measurement, rules, s, w)
    else:
        for i in range(f.count[0]):
            if is_guess(f, i, link, ident) and share[i] > 0.0:
                e, hph = compare(f, a, i, offset, measurement, s, w)
                consider(f, i, innovate(e, measurement.q, hph), e, w)
    return best + math.log(total)


@lean
def _unite(f: Filter, link: int, ident: int, total: float) -> tuple[int, int]:
    """Make the shares of a VT's guesses sum to one, give up the improbable ones and doubles; return how many are left,
    and the last of them."""
    share = f.anchor[:, SHARE]
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] = share[i] / total if share[i] > LEAST * total else 0.0
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
    for c in range(3):
        a, b = f.vt_state[i, VT + c], f.vt_state[j, VT + c]
        gap = wrap(f.x[a] - f.x[b]) if c == 1 else f.x[a] - f.x[b]
        if gap * gap > AGREE * AGREE * (f.p[a, a] + f.p[b, b]):
            return False
    return True


@part
def consider(f: Filter, j: int, new: Innovation, e: Vec3, w: Pending) -> None:
    """Update VT j alone by an innovation, T being in w.t, and e with NaN where not measured; all else is considered:
    covariances with it change, its own do not."""
    p, t, at, n = f.p, w.t, f.vt_state[j], f.size[0]
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
