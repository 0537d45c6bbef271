"""The compiled covariance recursion of the bound: one pass over a drive, in place.

The state is [core, VT, VT, ...] with core = [pose (6), odometry biases, odometry scales, clock offsets].
Only the lower triangle of the covariance is kept and written, so it is symmetric by construction; VTs that
will not be seen again are removed, which is exact marginalisation, and the last one takes their place.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cellslam.sim.recording import Floats, Ints

Flags = NDArray[np.bool_]

POSE = 6


@njit(cache=True)
def covariance_recursion(
    p: Floats,
    start: Floats,
    core: int,
    motion: Floats,
    noise: Floats,
    walk: Floats,
    rows: Ints,
    key: Ints,
    first: Flags,
    last: Flags,
    h: Floats,
    variance: Floats,
    offset: Ints,
    slot_of: Ints,
    key_of: Ints,
    out_pose: Floats,
    out_offset: Floats,
) -> None:
    """Run the recursion over T snapshots and fill `out_pose` (T, 6, 6) and `out_offset` (T, S).

    `p` (N, N): workspace, N = core + 3 x (most VTs alive at once). `start` (core,): prior variances. `motion`
    (T, 6, core), `noise` (T, 6, 6), `walk` (T, core): transition of the pose, covariance of its noise,
    variances that the core gains. `rows` (T + 1,): first measurement of each snapshot. Per measurement (M,
    ...): `key` of the VT on its link, whether it is its `first` and its `last` one, `h` (3, 9) = [dh/dr,
    dh/dv], `variance` (3,) (infinite: not measured), `offset`: core index of the site's offset. `slot_of`
    (keys,) and `key_of` (slots,): workspace.
    """
    n = core
    sites = out_offset.shape[1]
    g = np.zeros((3, p.shape[0]))
    block = np.zeros((core, core))
    moved = np.zeros((core, core))
    for i in range(core):
        for j in range(i + 1):
            p[i, j] = start[i] if i == j else 0.0
    for t in range(rows.shape[0] - 1):
        if t > 0:
            _predict(p, n, core, motion[t], noise[t], walk[t], block, moved)
        for m in range(rows[t], rows[t + 1]):
            if first[m]:
                slot = n
                _birth(p, n, slot, h[m], variance[m], offset[m], g)
                slot_of[key[m]] = slot
                key_of[(slot - core) // 3] = key[m]
                n += 3
            else:
                _update(p, n, slot_of[key[m]], h[m], variance[m], offset[m], g)
            if last[m]:
                n = _remove(p, n, core, slot_of[key[m]], slot_of, key_of)
        for i in range(POSE):
            for j in range(i + 1):
                out_pose[t, i, j] = p[i, j]
                out_pose[t, j, i] = p[i, j]
        for s in range(sites):
            out_offset[t, s] = p[core - sites + s, core - sites + s]


@njit(cache=True)
def _predict(
    p: Floats, n: int, core: int, motion: Floats, noise: Floats, walk: Floats, block: Floats, moved: Floats
) -> None:
    """P <- F (P + diag(walk)) F^T + Q: the core walks first, as biases do, then F changes the pose only."""
    for i in range(core):
        p[i, i] += walk[i]
    for i in range(core):
        for j in range(i + 1):
            block[i, j] = p[i, j]
            block[j, i] = p[i, j]
    for a in range(POSE):
        for j in range(core):
            total = 0.0
            for c in range(core):
                total += motion[a, c] * block[c, j]
            moved[a, j] = total
    for a in range(POSE):
        for j in range(a + 1):
            total = noise[a, j]
            for c in range(core):
                total += moved[a, c] * motion[j, c]
            p[a, j] = total
    for i in range(POSE, core):
        for a in range(POSE):
            p[i, a] = moved[a, i]
    for i in range(core, n):
        for a in range(POSE):
            total = 0.0
            for c in range(core):
                total += motion[a, c] * p[i, c]
            moved[a, 0] = total
        for a in range(POSE):
            p[i, a] = moved[a, 0]


@njit(cache=True)
def _gains(p: Floats, n: int, slot: int, h: Floats, variance: Floats, offset: int, g: Floats) -> None:
    """g[:, j] = covariance of the measured components with state j; without a VT if slot is negative."""
    for j in range(n):
        for r in range(3):
            total = 0.0
            if variance[r] < np.inf:
                for c in range(POSE):
                    total += h[r, c] * (p[j, c] if j >= c else p[c, j])
                if r == 0:
                    total += p[j, offset] if j >= offset else p[offset, j]
                if slot >= 0:
                    for c in range(3):
                        k = slot + c
                        total += h[r, POSE + c] * (p[j, k] if j >= k else p[k, j])
            g[r, j] = total


@njit(cache=True)
def _innovation(g: Floats, slot: int, h: Floats, variance: Floats, offset: int, r: int, q: int) -> float:
    """Element (r, q) of H P H^T, from the gains; zero where a component was not measured."""
    if not (variance[r] < np.inf and variance[q] < np.inf):
        return 0.0
    total = g[r, offset] if q == 0 else 0.0
    for c in range(POSE):
        total += g[r, c] * h[q, c]
    if slot >= 0:
        for c in range(3):
            total += g[r, slot + c] * h[q, POSE + c]
    return total


@njit(cache=True)
def _birth(p: Floats, n: int, slot: int, h: Floats, variance: Floats, offset: int, g: Floats) -> None:
    """Append a VT that is known from this measurement alone: the limit of a broad prior.

    v = D (z - H_r r - b - noise) with D the inverse of H_v; the other states learn nothing.
    """
    inverse = np.empty((3, 3))
    _invert(h[:, POSE:], inverse)
    full = np.empty((3, 3))
    _gains(p, n, -1, h, variance, offset, g)
    for r in range(3):
        for q in range(3):
            full[r, q] = _innovation(g, -1, h, variance, offset, r, q)
        full[r, r] += variance[r]
    for r in range(3):
        for j in range(n):
            p[slot + r, j] = -(inverse[r, 0] * g[0, j] + inverse[r, 1] * g[1, j] + inverse[r, 2] * g[2, j])
        for q in range(r + 1):
            total = 0.0
            for x in range(3):
                for y in range(3):
                    total += inverse[r, x] * full[x, y] * inverse[q, y]
            p[slot + r, slot + q] = total


@njit(cache=True)
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


@njit(cache=True)
def _update(p: Floats, n: int, slot: int, h: Floats, variance: Floats, offset: int, g: Floats) -> None:
    """P <- P - (P H^T L^-T) (P H^T L^-T)^T with S = H P H^T + R = L L^T: symmetric."""
    _gains(p, n, slot, h, variance, offset, g)
    s00 = _innovation(g, slot, h, variance, offset, 0, 0) + (variance[0] if variance[0] < np.inf else 1.0)
    s11 = _innovation(g, slot, h, variance, offset, 1, 1) + (variance[1] if variance[1] < np.inf else 1.0)
    s22 = _innovation(g, slot, h, variance, offset, 2, 2) + (variance[2] if variance[2] < np.inf else 1.0)
    s10 = _innovation(g, slot, h, variance, offset, 1, 0)
    s20 = _innovation(g, slot, h, variance, offset, 2, 0)
    s21 = _innovation(g, slot, h, variance, offset, 2, 1)
    l00 = np.sqrt(s00)
    l10, l20 = s10 / l00, s20 / l00
    l11 = np.sqrt(s11 - l10 * l10)
    l21 = (s21 - l20 * l10) / l11
    l22 = np.sqrt(s22 - l20 * l20 - l21 * l21)
    g0, g1, g2 = g[0], g[1], g[2]
    for j in range(n):
        g0[j] = g0[j] / l00
        g1[j] = (g1[j] - l10 * g0[j]) / l11
        g2[j] = (g2[j] - l20 * g0[j] - l21 * g1[j]) / l22
    for i in range(n):
        row = p[i]
        a0, a1, a2 = g0[i], g1[i], g2[i]
        for j in range(i + 1):
            row[j] -= a0 * g0[j] + a1 * g1[j] + a2 * g2[j]


@njit(cache=True)
def _remove(p: Floats, n: int, core: int, slot: int, slot_of: Ints, key_of: Ints) -> int:
    """Take the VT at `slot` out, put the last one in its place, and return the new size."""
    end = n - 3
    if slot != end:
        for r in range(3):
            for j in range(slot):
                p[slot + r, j] = p[end + r, j]
            for q in range(r + 1):
                p[slot + r, slot + q] = p[end + r, end + q]
        for i in range(slot + 3, end):
            for r in range(3):
                p[i, slot + r] = p[end + r, i]
        moved_key = key_of[(end - core) // 3]
        slot_of[moved_key] = slot
        key_of[(slot - core) // 3] = moved_key
    return end
