"""How the state of the bound's recursion moves, and how parts of it enter and leave.

P is the covariance (size, size) of the states, in products of their units (m, rad, m/s, rad/s; errors that persist are
in their own deviations), of which the first n rows and columns are in use. Source: Gelb, "Applied optimal estimation",
1974, chapters 3 and 4 (Gauss-Markov states, covariance prediction); a Gaussian is marginalised by leaving rows out.
"""

from __future__ import annotations

import numpy as np

from cellslam.benchmarks.bound.bound_model import Errors, Motion, Sightings, Views
from cellslam.sim.compiling import part
from cellslam.sim.recording import Floats, Ints

POSE = 6


@part
def predict(p: Floats, n: int, core: int, motion: Motion, t: int, moved: Floats) -> None:
    """P <- F (P + diag(walk)) F^T + Q: the core walks first, as biases do, then F changes the pose only. Before that,
    offsets grow by the rates that their clocks have walked to.

    p (size, size): written, in its units; moved (6, size): scratch.
    """
    for s in range(len(motion.rate)):
        offset, rate, dt_s = core - len(motion.rate) + s, motion.rate[s], motion.dt_s[t]
        if rate >= 0:
            for j in range(n):
                p[offset, j] += dt_s * p[rate, j]
            for i in range(n):
                p[i, offset] += dt_s * p[i, rate]
            p[offset, rate] += 0.5 * dt_s * motion.walk[t, rate]
            p[rate, offset] = p[offset, rate]
    for i in range(core):
        p[i, i] += motion.walk[t, i]
    for a in range(POSE):
        row = moved[a]
        row[:n] = 0.0
        for c in range(core):
            factor, other = motion.step[t, a, c], p[c]
            if factor != 0.0:
                for j in range(n):
                    row[j] += factor * other[j]
    for a in range(POSE):
        for j in range(POSE, n):
            p[a, j] = moved[a, j]
            p[j, a] = moved[a, j]
    for a in range(POSE):
        for b in range(a + 1):
            total = motion.noise[t, a, b]
            for c in range(core):
                total += moved[a, c] * motion.step[t, b, c]
            p[a, b] = total
            p[b, a] = total


@part
def decay(p: Floats, n: int, core: int, errors: Errors, t: int, id_of: Ints) -> None:
    """Gauss-Markov states of p (size, size) forget a part and gain as much variance; VTs and constants stay.

    id_of (size,): index of what each state is. Dimensionless: variances of these states are 1 throughout.
    """
    for i in range(core, n):
        k = id_of[i]
        if k < errors.kind.shape[0] and errors.kind[k] > 0:
            factor = errors.decay[t, errors.kind[k]]
            if factor < 1.0:
                for j in range(n):
                    p[i, j] *= factor
                for j in range(n):
                    p[j, i] *= factor
                p[i, i] += 1.0 - factor * factor


@part
def append(p: Floats, n: int, k: np.int64, variance: float, slot_of: Ints, id_of: Ints) -> int:
    """Add to p (size, size) a state with a variance, in its squared unit, and no covariances; return the new size.

    slot_of (K,), id_of (size,): where state k is, and its inverse, by index.
    """
    p[n, : n + 1] = 0.0
    p[: n + 1, n] = 0.0
    p[n, n] = variance
    slot_of[k], id_of[n] = n, k
    return n + 1


@part
def enter(p: Floats, n: int, views: Views, sightings: Sightings, t: int, slot_of: Ints, id_of: Ints) -> int:
    """Add to p (size, size) the persisting errors that snapshot t meets for the first time; return the new size."""
    for i in range(views.rows[t], views.rows[t + 1]):
        for r in range(3):
            for w in range(views.state.shape[2]):
                k = views.state[i, r, w]
                if k >= 0 and slot_of[k] < 0:
                    n = append(p, n, k, 1.0, slot_of, id_of)
    for m in range(sightings.rows[t], sightings.rows[t + 1]):
        for r in range(3):
            k = sightings.state[m, r]
            if k >= 0 and slot_of[k] < 0:
                n = append(p, n, k, 1.0, slot_of, id_of)
    return n


@part
def leave(
    p: Floats, n: int, views: Views, sightings: Sightings, errors: Errors, t: int, slot_of: Ints, id_of: Ints
) -> int:
    """Remove from p (size, size) the states that no snapshot after t meets; return the new size."""
    for i in range(views.rows[t], views.rows[t + 1]):
        for r in range(3):
            for w in range(views.state.shape[2]):
                k = views.state[i, r, w]
                if k >= 0 and errors.last[k] == t and slot_of[k] >= 0:
                    n = remove(p, n, k, slot_of, id_of)
    for m in range(sightings.rows[t], sightings.rows[t + 1]):
        for r in range(3):
            k = sightings.state[m, r]
            if k >= 0 and errors.last[k] == t and slot_of[k] >= 0:
                n = remove(p, n, k, slot_of, id_of)
        if sightings.last[m]:
            for c in range(3):
                n = remove(p, n, errors.last.shape[0] + 3 * sightings.key[m] + c, slot_of, id_of)
    return n


@part
def remove(p: Floats, n: int, k: int, slot_of: Ints, id_of: Ints) -> int:
    """Take state k out of p (size, size), put the last one in its place, and return the new size.

    slot_of (K,), id_of (size,): as for `append`, indices.
    """
    slot, end = slot_of[k], n - 1
    if slot != end:
        for j in range(end):
            p[slot, j] = p[end, j]
            p[j, slot] = p[end, j]
        p[slot, slot] = p[end, end]
        slot_of[id_of[end]] = slot
        id_of[slot] = id_of[end]
    slot_of[k] = -1
    return end
