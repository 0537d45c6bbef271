"""Compiled: innovation of one measurement, its likelihood, and the Kalman update of the whole state.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 5.2,
with S = R R^T and gains whitened by R.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import njit
from cellslam.sim.frames_kernel import wrap
from cellslam.sim.recording import Floats
from cellslam.slam.ekf_slam.state_layout import OFFSET, POSE, TOUCHED, Filter, Scratch, states
from cellslam.slam.ekf_slam.vt_kernel import covariance_of, gains, predict, rotations_of, state_of
from cellslam.slam.model.matrices_kernel import Sym3, Vec3, cholesky, dot, solved
from cellslam.slam.model.measurement_kernel import Spherical

LOG_2PI = math.log(2.0 * math.pi)


class Innovation(NamedTuple):
    """Innovation `e` = z - h(x), its covariance `s` = H P H^T + Q, and how many components were measured: a missing one
    is 0 in e, and in s as if it were independent, of variance 1."""

    e: Vec3
    s: Sym3
    measured: int


@njit(cache=True)
def innovate(z: Floats, q: Floats, expected: Spherical, offset_m: float, hph: Sym3) -> Innovation:
    """Return the innovation of a measurement against what is expected of it but for the clock offset; hph: H P H^T.

    z (3,): distance (m), azimuth and elevation (rad), NaN where there is none; q (3,): their variances.
    """
    far, across, up = not math.isnan(z[0]), not math.isnan(z[1]), not math.isnan(z[2])
    e = Vec3(
        z[0] - expected.distance - offset_m if far else 0.0,
        wrap(z[1] - expected.azimuth) if across else 0.0,
        z[2] - expected.elevation if up else 0.0,
    )
    s = Sym3(
        hph.xx + q[0] if far else 1.0, hph.xy if far and across else 0.0, hph.xz if far and up else 0.0,
        hph.yy + q[1] if across else 1.0, hph.yz if across and up else 0.0, hph.zz + q[2] if up else 1.0,
    )  # fmt: skip
    return Innovation(e, s, int(far) + int(across) + int(up))


@njit(cache=True)
def log_likelihood(i: Innovation) -> tuple[float, float]:
    """Return e^T S^-1 e and log det S; infinite where S has no root."""
    root = cholesky(i.s)
    if root.xx == 0.0:
        return math.inf, 0.0
    w = solved(root, i.e)
    return dot(w, w), 2.0 * math.log(root.xx * root.yy * root.zz)


@njit(cache=True)
def expect(f: Filter, j: int, offset: int, h: Floats, t: Floats) -> tuple[Spherical, Sym3]:
    """Return what is expected of VT j in m and rad, and H P H^T; write H into h (3, 10), T = H P into t (3, states)."""
    expected = predict(f, j, rotations_of(f), h)
    gains(f, j, offset, h, t)
    return expected, covariance_of(f, j, offset, h, t)


@njit(cache=True)
def explained(f: Filter, j: int, offset: int, w: Scratch, k: int) -> None:
    """Take out of T = H P, in w.t, what the first k rows G of w.pending have explained: T <- T - (H G^T) G."""
    h, t, size = w.h, w.t, states(f)
    for first in range(0, k, 3):
        g0, g1, g2 = w.pending[first], w.pending[first + 1], w.pending[first + 2]
        a0, b0, c0 = g0[offset], g1[offset], g2[offset]
        a1, a2, b1, b2, c1, c2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for c in range(TOUCHED if f.mapped else POSE):
            if c == OFFSET:
                continue
            at, h0, h1, h2 = state_of(f, j, offset, c), h[0, c], h[1, c], h[2, c]
            a0, a1, a2 = a0 + h0 * g0[at], a1 + h1 * g0[at], a2 + h2 * g0[at]
            b0, b1, b2 = b0 + h0 * g1[at], b1 + h1 * g1[at], b2 + h2 * g1[at]
            c0, c1, c2 = c0 + h0 * g2[at], c1 + h1 * g2[at], c2 + h2 * g2[at]
        t0, t1, t2 = t[0], t[1], t[2]
        for i in range(size):
            y0, y1, y2 = g0[i], g1[i], g2[i]
            t0[i] -= a0 * y0 + b0 * y1 + c0 * y2
            t1[i] -= a1 * y0 + b1 * y1 + c1 * y2
            t2[i] -= a2 * y0 + b2 * y1 + c2 * y2


@njit(cache=True)
def update(f: Filter, j: int, offset: int, z: Floats, q: Floats, w: Scratch, k: int) -> tuple[float, int]:
    """Kalman update of the whole state by one measurement of VT j; return log N(e; 0, S), and k.

    z, q (3,): measurement in m and rad, and variances. P stays as it is: what the update takes off it is left in three
    more rows of w.pending, of which k are in use, P - G^T G being meant.
    """
    x, t = f.x, w.t
    expected = predict(f, j, rotations_of(f), w.h)
    gains(f, j, offset, w.h, t)
    explained(f, j, offset, w, k)
    i = innovate(z, q, expected, x[offset], covariance_of(f, j, offset, w.h, t))
    root = cholesky(i.s)
    if root.xx == 0.0:
        return 0.0, k
    blank(t, z)
    whitened = solved(root, i.e)
    g0, g1, g2 = w.pending[k], w.pending[k + 1], w.pending[k + 2]
    for n in range(states(f)):
        u = solved(root, Vec3(t[0, n], t[1, n], t[2, n]))
        g0[n], g1[n], g2[n] = u.x, u.y, u.z
        x[n] += dot(u, whitened)
    log_root = math.log(root.xx * root.yy * root.zz)
    return -0.5 * dot(whitened, whitened) - log_root - 0.5 * i.measured * LOG_2PI, k + 3


@njit(cache=True)
def blank(t: Floats, z: Floats) -> None:
    """Clear the rows of T = H P, t (3, N), of what was not measured: NaN in z (3,)."""
    for r in range(3):
        if math.isnan(z[r]):
            t[r] = 0.0
