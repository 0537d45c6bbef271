"""Clock offsets, one a site, constant or drifting: parts of the filter.

They are marginalised with the odometer errors. Where clocks drift theta has a constant rate for each site, between the
offsets and the odometer errors, and the offsets of the present. A VT was touched under the offset of its time, b(t0) =
b(t) - rate (t - t0), so that given the present theta

    s | theta ~ N(mu + G (theta - theta0) + G_rate (rate - rate0), Sigma),   G_rate -= (t - t0) G_offset,

which a record takes up whenever it is predicted: RATE_GAIN is G_rate, RATE0 and TIME0 are rate0 and t0. While a clock
is constant the functions below have nothing to do.

Source: Schoen, Gustafsson and Nordlund, "Marginalized particle filters for mixed linear/nonlinear state-space models",
IEEE Trans. Signal Processing 53(7), 2005: offsets and rates are the linear part. That VTs depend on each other through
them alone is an own derivation (see `nuisance_kernel`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats
from cellslam.slam.fastslam.parts.part_types import replaceable, variant
from cellslam.slam.fastslam.state.lanes_kernel import five_at, mat_at, put, sym_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    GAIN,
    LANES,
    MU,
    O_A,
    O_AR,
    O_C,
    O_H,
    RATE0,
    RATE_GAIN,
    SIGMA,
    THETA,
    THETA0,
    TIME0,
    V_Y,
    W_E,
    W_INV,
    W_MASK,
    W_PR,
    W_RATE,
    W_SITE,
    Rows,
)
from cellslam.slam.fastslam.state.spherical_vt_kernel import moved
from cellslam.slam.model.matrices_kernel import (
    Sym3,
    Vec3,
    dot,
    mat_vec,
    outer_sum,
    sym_plus,
    sym_vec,
    transposed_vec,
    vec_minus,
    vec_plus,
    vec_scaled,
)

B = LANES


class Constant(NamedTuple):
    """One offset a site: its VTs depend on each other through it, and through the odometer errors."""


class Drifting(NamedTuple):
    """One offset and one rate a site. `elapsed_s`: since the start; `sites`: how many."""

    elapsed_s: float
    sites: int


@replaceable
def clock_moves(part: Any, state: Rows, travelled: Floats, dt: float, size: int) -> None:
    """Let offsets go on by an interval dt (s), and say how far (m) in travelled (size,)."""


@variant(clock_moves, Drifting)
def _clock_moves(part: Drifting, state: Rows, travelled: Floats, dt: float, size: int) -> None:
    """Move means, and rows and columns of the covariance."""
    for site in range(part.sites):
        offset, rate = site, part.sites + site
        fastest = 0.0
        for l in range(B):
            state[(THETA + offset) * B + l] += dt * state[(THETA + rate) * B + l]
            fastest = max(fastest, abs(state[(THETA + rate) * B + l]))
        travelled[site] += fastest * dt
        for j in range(size):
            to, of = (THETA + size + offset * size + j) * B, (THETA + size + rate * size + j) * B
            for l in range(B):
                state[to + l] += dt * state[of + l]
        for i in range(size):
            to, of = (THETA + size + i * size + offset) * B, (THETA + size + i * size + rate) * B
            for l in range(B):
                state[to + l] += dt * state[of + l]


@replaceable
def rate_changes(part: Any, v: Rows, change: int, travelled: Floats) -> None:
    """Say how far rates that have changed move what is expected of tracks long unseen, in m, in travelled (size,).

    From row `change` of v on.
    """


@variant(rate_changes, Drifting)
def _rate_changes(part: Drifting, v: Rows, change: int, travelled: Floats) -> None:
    """Take tracks unseen since the start."""
    for site in range(part.sites):
        largest = 0.0
        for l in range(B):
            largest = max(largest, abs(v[(change + part.sites + site) * B + l]))
        travelled[site] += largest * part.elapsed_s


@replaceable
def load_clock(part: Any, w: Rows, state: Rows, site: int, size: int) -> None:
    """Copy what concerns a site's clock beside its offset."""


@variant(load_clock, Drifting)
def _load_clock(part: Drifting, w: Rows, state: Rows, site: int, size: int) -> None:
    """Copy the rate's mean and covariances."""
    rate = part.sites + site
    cov = THETA + size + rate * size
    w[W_SITE * B] = w.dtype.type(site)
    for l in range(B):
        w[W_RATE * B + l] = state[(THETA + rate) * B + l]
        w[W_PR * B + l] = state[(cov + rate) * B + l]
        w[(W_PR + 1) * B + l] = state[(cov + site) * B + l]
        w[(W_PR + 2) * B + l] = state[(cov + size - 2) * B + l]
        w[(W_PR + 3) * B + l] = state[(cov + size - 1) * B + l]


@replaceable
def begin_clock(part: Any, w: Rows, rec: Rows) -> None:
    """Write what of the clock a new track's record begins with, beside the offset."""


@variant(begin_clock, Drifting)
def _begin_clock(part: Drifting, w: Rows, rec: Rows) -> None:
    """Write G_rate = 0, the present rate and time."""
    F = w.dtype.type
    for l in range(B):
        put(rec, RATE_GAIN, l, (F(0.0), F(0.0), F(0.0)))
        rec[RATE0 * B + l] = w[W_RATE * B + l]
        rec[TIME0 * B + l] = F(part.elapsed_s)


@replaceable
def refresh(part: Any, w: Rows, rec: Rows) -> None:
    """Bring a track's record up to the present, before it is predicted."""


@variant(refresh, Drifting)
def _refresh(part: Drifting, w: Rows, rec: Rows) -> None:
    """Let G_rate and the offset of the last touch go on, and take up the present rate."""
    F = w.dtype.type
    now = F(part.elapsed_s)
    for l in range(B):
        since, was = now - rec[TIME0 * B + l], rec[RATE0 * B + l]
        by_offset = Vec3(rec[GAIN * B + l], rec[(GAIN + 3) * B + l], rec[(GAIN + 6) * B + l])
        gain = vec_minus(vec_at(rec, RATE_GAIN, l), vec_scaled(by_offset, since))
        put(rec, RATE_GAIN, l, gain)
        rec[THETA0 * B + l] += since * was
        change = vec_scaled(gain, w[W_RATE * B + l] - was)
        put(rec, MU, l, moved(F, five_at(rec, MU, l), change))
        rec[RATE0 * B + l] = w[W_RATE * B + l]
        rec[TIME0 * B + l] = now


@replaceable
def widen(part: Any, w: Rows, rec: Rows, out: Rows) -> None:
    """Add to C what nuisances do that only this part knows of, once a track is predicted."""


@variant(widen, Drifting)
def _widen(part: Drifting, w: Rows, rec: Rows, out: Rows) -> None:
    """Add q A_rate^T + A_rate q^T, A_rate = H G_rate, q = A P_rate + A_rate P_rate,rate / 2."""
    for l in range(B):
        by_rate = mat_vec(mat_at(out, O_H, l), vec_at(rec, RATE_GAIN, l))
        put(out, O_AR, l, by_rate)
        by_others = mat_vec(mat_at(out, O_A, l), vec_at(w, W_PR + 1, l))
        q = vec_plus(by_others, vec_scaled(by_rate, 0.5 * w[W_PR * B + l]))
        put(out, O_C, l, sym_plus(sym_at(out, O_C, l), outer_sum(q, by_rate)))


@replaceable
def learn(part: Any, w: Rows, v: Rows, rec: Rows, out: Rows) -> None:
    """Use the association at hand, where W_MASK is 1, for what only this part knows of: the snapshot's y and I, and the
    record, the rest of which is updated after."""


@variant(learn, Drifting)
def _learn(part: Drifting, w: Rows, v: Rows, rec: Rows, out: Rows) -> None:
    """Add the rate's rows of y and I; G_rate -= K A_rate, K = Sigma H^T S^-1."""
    size, site = 2 * part.sites + 2, int(w[W_SITE * B])
    rate, square = part.sites + site, V_Y + size
    own, by_self, by_offset = V_Y + rate, square + rate * size + rate, square + rate * size + site
    by_bias, by_scale = square + (size - 2) * size + rate, square + (size - 1) * size + rate
    for l in range(B):
        u = _weighed(sym_at(w, W_INV, l), vec_at(out, O_AR, l), w[W_MASK * B + l])
        i = transposed_vec(mat_at(out, O_A, l), u)
        v[own * B + l] += dot(u, vec_at(w, W_E, l))
        v[by_self * B + l] += dot(u, vec_at(out, O_AR, l))
        v[by_offset * B + l] += i.x
        v[by_bias * B + l] += i.y
        v[by_scale * B + l] += i.z
    for l in range(B):
        u = _weighed(sym_at(w, W_INV, l), vec_at(out, O_AR, l), w[W_MASK * B + l])
        gained = sym_vec(sym_at(rec, SIGMA, l), transposed_vec(mat_at(out, O_H, l), u))
        put(rec, RATE_GAIN, l, vec_minus(vec_at(rec, RATE_GAIN, l), gained))


@njit(error_model="numpy")
def _weighed(inverse: Sym3, by_rate: Vec3, on: Any) -> Vec3:
    """Return S^-1 A_rate, 0 where `on` is."""
    weighed: Vec3 = vec_scaled(sym_vec(inverse, by_rate), on)
    return weighed


@replaceable
def offset_belief(part: Any, rec: Rows, lane: int, state: Rows, size: int, site: int) -> tuple[float, float]:
    """Return mean (m) and variance (m^2) of the offset that a track was last touched under, in one lane of a block's
    state."""
    return state[(THETA + site) * B + lane], state[(THETA + size + site * size + site) * B + lane]


@variant(offset_belief, Drifting)
def _offset_belief(part: Drifting, rec: Rows, lane: int, state: Rows, size: int, site: int) -> tuple[float, float]:
    """Take the time of the last touch."""
    rate = part.sites + site
    since = part.elapsed_s - np.float64(rec[TIME0 * B + lane])
    cov = THETA + size
    mean = state[(THETA + site) * B + lane] - since * state[(THETA + rate) * B + lane]
    variance = state[(cov + site * size + site) * B + lane]
    variance -= 2.0 * since * state[(cov + site * size + rate) * B + lane]
    variance += since * since * state[(cov + rate * size + rate) * B + lane]
    return mean, variance
