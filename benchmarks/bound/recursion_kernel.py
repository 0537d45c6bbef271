"""The compiled covariance recursion of the bound: one pass over a drive.

The state is [core, others] with core = [pose (6), odometry biases and scales, clock rates, clock offsets]. The others,
VTs' coordinates and errors that persist, enter when they are first met and leave when they will not be met again (exact
marginalisation: the last one takes the place). A snapshot's measurements are taken one component after the other, but
their whitened gains are subtracted together: a rank-K update.

One column of the core, `mean`, is no state: it has the covariance's place of what the filter's mean is off. With a gain
K s^1/2 in a state's column and minus the innovation over s^1/2 in this one, P - G^T G moves the mean by K times the
innovation, as it moves the covariance; prediction and marginalisation treat it as any other.

Source: the recursion of Tichavsky et al. 1998 (see `cramer_rao`), measured components taken one after the other as in
Anderson and Moore, "Optimal filtering", 1979, chapter 6.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.benchmarks.bound.bound_model import Errors, Found, Motion, Sightings, Views, Work
from cellslam.benchmarks.bound.states_kernel import POSE, append, decay, enter, leave, predict
from cellslam.sim.compiling import njit, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.arrays_kernel import downdate


@njit(cache=True)
def covariance_recursion(
    work: Work, motion: Motion, views: Views, sightings: Sightings, errors: Errors, begin: int, end: int, n: int,
    drift: Ints, drifted: Floats, found: Found,
) -> int:  # fmt: skip
    """Run snapshots `begin` up to `end`, fill their rows of `found`.

    drift (S,): error that stands for the rate of a site's clock (-1: none), with drifted (T, S) its load on the offset.
    Takes the number of states in `work.p` (core at first) and returns it: for the call that goes on.
    """
    p, slot_of, id_of, mean = work.p, work.slot_of, work.id_of, motion.mean
    core, count, sites = motion.start.shape[0], errors.last.shape[0], found.offset.shape[1]
    for t in range(begin, end):
        if t == 0:
            for i in range(core):
                p[i, i] = motion.start[i]
        else:
            predict(p, n, core, motion, t, work.moved)
            decay(p, n, core, errors, t, id_of)
        for i in range(core):
            if i != mean:
                p[i, mean] += motion.jump[t, i]
                p[mean, i] = p[i, mean]
        n = enter(p, n, views, sightings, t, slot_of, id_of)
        for m in range(sightings.rows[t], sightings.rows[t + 1]):
            if sightings.first[m]:
                n = _birth(p, n, views, sightings, m, count, mean, slot_of, id_of, work.shared)
        _update(p, n, views, sightings, t, count, mean, slot_of, work.gains, work.shared, work.dots)
        for a in range(POSE):
            found.error[t, a] = p[a, mean]
            for b in range(POSE):
                found.pose[t, a, b] = p[a, b]
        for s in range(sites):
            own = core - sites + s
            found.offset[t, s] = p[own, own]
            if drift[s] >= 0:
                rate = slot_of[drift[s]]
                by = drifted[t, s]
                found.offset[t, s] += by * (2.0 * p[own, rate] + by * p[rate, rate]) if rate >= 0 else by * by
        n = leave(p, n, views, sightings, errors, t, slot_of, id_of)
    return n


@part
def _add(row: Floats, factor: float, other: Floats, n: int) -> None:
    for j in range(n):
        row[j] += factor * other[j]


@part
def _shared_gain(p: Floats, n: int, views: Views, i: int, r: int, slot_of: Ints, out: Floats) -> None:
    """out = covariance of all states with component r of view i, but for its VT and the errors of one link."""
    out[:n] = 0.0
    for c in range(POSE):
        if views.by_pose[i, r, c] != 0.0:
            _add(out, views.by_pose[i, r, c], p[c], n)
    if r == 0:
        _add(out, 1.0, p[views.offset[i]], n)
    for w in range(views.state.shape[2]):
        if views.state[i, r, w] >= 0:
            _add(out, views.load[i, r, w], p[slot_of[views.state[i, r, w]]], n)


@part
def _shared_dot(row: Floats, views: Views, i: int, r: int, slot_of: Ints) -> float:
    """The product of a row over the states with component r of view i, but for its VT and the errors of one link."""
    total = row[views.offset[i]] if r == 0 else 0.0
    for c in range(POSE):
        total += views.by_pose[i, r, c] * row[c]
    for w in range(views.state.shape[2]):
        if views.state[i, r, w] >= 0:
            total += views.load[i, r, w] * row[slot_of[views.state[i, r, w]]]
    return total


@part
def _update(
    p: Floats, n: int, views: Views, sightings: Sightings, t: int, count: int, mean: int, slot_of: Ints, g: Floats,
    shared: Floats, dots: Floats,
) -> None:  # fmt: skip
    """Take in the snapshot's measurements of VTs that are in the state."""
    low, high, k, weight = views.rows[t], views.rows[t + 1], 0, np.empty(g.shape[0])
    for i in range(low, high):
        for r in range(3):
            _shared_gain(p, n, views, i, r, slot_of, shared[3 * (i - low) + r])
    for m in range(sightings.rows[t], sightings.rows[t + 1]):
        if sightings.first[m]:
            continue
        i, vt = sightings.view_of[m], count + 3 * sightings.key[m]
        v0, v1, v2 = slot_of[vt], slot_of[vt + 1], slot_of[vt + 2]
        for r in range(3):
            variance = sightings.variance[m, r]
            if variance == np.inf:
                continue
            h0, h1, h2 = views.by_vt[i, r, 0], views.by_vt[i, r, 1], views.by_vt[i, r, 2]
            own, load, q, row = 0, 0.0, 3 * (i - low) + r, g[k]
            if sightings.state[m, r] >= 0:
                own, load = slot_of[sightings.state[m, r]], sightings.load[r]
            q_row, p0, p1, p2, p3 = shared[q], p[v0], p[v1], p[v2], p[own]
            for j in range(n):
                row[j] = q_row[j] + h0 * p0[j] + h1 * p1[j] + h2 * p2[j] + load * p3[j]
            row[mean] -= sightings.residual[m, r]
            for j in range(k):
                weight[j] = dots[j, q] + h0 * g[j, v0] + h1 * g[j, v1] + h2 * g[j, v2] + load * g[j, own]
            _whiten(row, g, weight, k, n)
            spread = _shared_dot(row, views, i, r, slot_of)
            spread += h0 * row[v0] + h1 * row[v1] + h2 * row[v2] + load * row[own]
            # Rounding apart, the innovation varies by no less than the measurement.
            root = 1.0 / math.sqrt(max(spread + variance, variance))
            for j in range(n):
                row[j] *= root
            for other in range(low, high):
                for c in range(3):
                    dots[k, 3 * (other - low) + c] = _shared_dot(row, views, other, c, slot_of)
            k += 1
    downdate(p, n, g, k)


@part
def _whiten(row: Floats, g: Floats, weight: Floats, k: int, n: int) -> None:
    """Take out of a gain what the snapshot's k gains before it have explained; four at once, for speed."""
    j = 0
    while j + 4 <= k:
        a0, a1, a2, a3 = weight[j], weight[j + 1], weight[j + 2], weight[j + 3]
        g0, g1, g2, g3 = g[j], g[j + 1], g[j + 2], g[j + 3]
        for x in range(n):
            row[x] -= a0 * g0[x] + a1 * g1[x] + a2 * g2[x] + a3 * g3[x]
        j += 4
    while j < k:
        _add(row, -weight[j], g[j], n)
        j += 1


@part
def _birth(
    p: Floats, n: int, views: Views, sightings: Sightings, m: int, count: int, mean: int, slot_of: Ints, id_of: Ints,
    g: Floats,
) -> int:  # fmt: skip
    """Append a VT that is known from this measurement alone: the limit of a broad prior.

    v = D (z - H_r r - b - errors) with D the inverse of H_v; the other states learn nothing.
    """
    i, inverse, full = sightings.view_of[m], np.empty((3, 3)), np.empty((3, 3))
    _invert(views.by_vt[i], inverse)
    for r in range(3):
        _shared_gain(p, n, views, i, r, slot_of, g[r])
        if sightings.state[m, r] >= 0:
            _add(g[r], sightings.load[r], p[slot_of[sightings.state[m, r]]], n)
        g[r, mean] -= sightings.residual[m, r]
    for r in range(3):
        for q in range(3):
            full[r, q] = _shared_dot(g[r], views, i, q, slot_of)
            if sightings.state[m, q] >= 0:
                full[r, q] += sightings.load[q] * g[r, slot_of[sightings.state[m, q]]]
        full[r, r] += sightings.variance[m, r]
    for c in range(3):
        n = append(p, n, count + 3 * sightings.key[m] + c, 0.0, slot_of, id_of)
    first = n - 3
    for r in range(3):
        for j in range(first):
            p[first + r, j] = -(inverse[r, 0] * g[0, j] + inverse[r, 1] * g[1, j] + inverse[r, 2] * g[2, j])
            p[j, first + r] = p[first + r, j]
        for q in range(r + 1):
            total = 0.0
            for x in range(3):
                for y in range(3):
                    total += inverse[r, x] * full[x, y] * inverse[q, y]
            p[first + r, first + q] = total
            p[first + q, first + r] = total
    return n


@part
def _invert(a: Floats, out: Floats) -> None:
    """out = a^-1 for 3 x 3, by cofactors."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            out[i, r] = a[s, j] * a[t, k] - a[s, k] * a[t, j]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    for i in range(3):
        for r in range(3):
            out[i, r] /= determinant
