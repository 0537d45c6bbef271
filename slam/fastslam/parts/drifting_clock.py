"""Clocks that drift: an offset and its constant rate for each site, both marginalised: a part of the filter.

theta has the rates between the offsets and the odometer errors, and the offsets of the present. A VT was touched under
the offset of its time, b(t0) = b(t) - rate (t - t0), so that given the present theta

    s | theta ~ N(mu + G (theta - theta0) + G_rate (rate - rate0), Sigma),   G_rate -= (t - t0) G_offset,

which a record takes up whenever it is predicted: RATE_GAIN is G_rate, RATE0 and TIME0 are rate0 and t0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.parts.clock import (
    Drifting,
    absorb,
    absorb_all,
    begin_offset,
    clock_moves,
    correct_clock,
    expect,
    load_clock,
    offset_belief,
    rate_changes,
    widen,
)
from cellslam.slam.fastslam.parts.landmarks import moved
from cellslam.slam.fastslam.parts.part_types import COMPILED, is_of
from cellslam.slam.fastslam.state.lanes_kernel import five_at, mat_at, put, sym_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    GAIN,
    LANES,
    MU,
    O_A,
    O_AR,
    O_C,
    O_H,
    O_OFFSET,
    OFFSET0,
    RATE0,
    RATE_GAIN,
    SIGMA,
    THETA,
    TIME0,
    V_Y,
    W_B,
    W_E,
    W_INV,
    W_MASK,
    W_PR,
    W_RATE,
    W_SITE,
)
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


def drifting(sites: int) -> Drifting:
    """Return the part for so many sites, at the start."""
    return Drifting(0.0, sites)


@njit(error_model="numpy")
def weighed(inverse: Sym3, by_rate: Vec3, on: Any) -> Vec3:
    """Return S^-1 A_rate, 0 where `on` is."""
    weighed: Vec3 = vec_scaled(sym_vec(inverse, by_rate), on)
    return weighed


@overload(clock_moves, **COMPILED)
def _clock_moves(part, state, travelled, dt, size):
    if not is_of(part, Drifting):
        return None

    def drifting(part, state, travelled, dt, size):
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

    return drifting


@overload(rate_changes, **COMPILED)
def _rate_changes(part, v, change, travelled):
    if not is_of(part, Drifting):
        return None

    def drifting(part, v, change, travelled):
        for site in range(part.sites):
            largest = 0.0
            for l in range(B):
                largest = max(largest, abs(v[(change + part.sites + site) * B + l]))
            travelled[site] += largest * part.elapsed_s

    return drifting


@overload(load_clock, **COMPILED)
def _load_clock(part, w, state, site, size):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, state, site, size):
        rate = part.sites + site
        cov = THETA + size + rate * size
        w[W_SITE * B] = w.dtype.type(site)
        for l in range(B):
            w[W_RATE * B + l] = state[(THETA + rate) * B + l]
            w[W_PR * B + l] = state[(cov + rate) * B + l]
            w[(W_PR + 1) * B + l] = state[(cov + site) * B + l]
            w[(W_PR + 2) * B + l] = state[(cov + size - 2) * B + l]
            w[(W_PR + 3) * B + l] = state[(cov + size - 1) * B + l]

    return drifting


@overload(expect, **COMPILED)
def _expect(part, landmarks, w, rec, out):
    if not is_of(part, Drifting):
        return None

    def drifting(part, landmarks, w, rec, out):
        F = w.dtype.type
        now = F(part.elapsed_s)
        for l in range(B):
            since, was = now - rec[TIME0 * B + l], rec[RATE0 * B + l]
            by_offset = Vec3(rec[GAIN * B + l], rec[(GAIN + 3) * B + l], rec[(GAIN + 6) * B + l])
            gain = vec_minus(vec_at(rec, RATE_GAIN, l), vec_scaled(by_offset, since))
            put(rec, RATE_GAIN, l, gain)
            rec[OFFSET0 * B + l] += since * was
            change = vec_scaled(gain, w[W_RATE * B + l] - was)
            put(rec, MU, l, moved(landmarks, F, five_at(rec, MU, l), change))
            rec[RATE0 * B + l] = w[W_RATE * B + l]
            rec[TIME0 * B + l] = now
            out[O_OFFSET * B + l] = w[W_B * B + l]

    return drifting


@overload(widen, **COMPILED)
def _widen(part, w, rec, out):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, rec, out):
        for l in range(B):
            # A_rate = H G_rate; A P A^T gains q A_rate^T + A_rate q^T, q = A P_rate + A_rate P_rate,rate / 2
            by_rate = mat_vec(mat_at(out, O_H, l), vec_at(rec, RATE_GAIN, l))
            put(out, O_AR, l, by_rate)
            by_others = mat_vec(mat_at(out, O_A, l), vec_at(w, W_PR + 1, l))
            q = vec_plus(by_others, vec_scaled(by_rate, 0.5 * w[W_PR * B + l]))
            put(out, O_C, l, sym_plus(sym_at(out, O_C, l), outer_sum(q, by_rate)))

    return drifting


@overload(absorb, **COMPILED)
def _absorb(part, w, v, rec, out):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, v, rec, out):
        absorb_all(w, out)
        size, site = 2 * part.sites + 2, int(w[W_SITE * B])
        rate, square = part.sites + site, V_Y + size
        own, by_self, by_offset = V_Y + rate, square + rate * size + rate, square + rate * size + site
        by_bias, by_scale = square + (size - 2) * size + rate, square + (size - 1) * size + rate
        for l in range(B):
            u = weighed(sym_at(w, W_INV, l), vec_at(out, O_AR, l), w[W_MASK * B + l])
            i = transposed_vec(mat_at(out, O_A, l), u)
            v[own * B + l] += dot(u, vec_at(w, W_E, l))
            v[by_self * B + l] += dot(u, vec_at(out, O_AR, l))
            v[by_offset * B + l] += i.x
            v[by_bias * B + l] += i.y
            v[by_scale * B + l] += i.z

    return drifting


@overload(correct_clock, **COMPILED)
def _correct_clock(part, w, rec, out):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, rec, out):
        # G_rate -= K A_rate, K = Sigma H^T S^-1
        for l in range(B):
            u = weighed(sym_at(w, W_INV, l), vec_at(out, O_AR, l), w[W_MASK * B + l])
            gained = sym_vec(sym_at(rec, SIGMA, l), transposed_vec(mat_at(out, O_H, l), u))
            put(rec, RATE_GAIN, l, vec_minus(vec_at(rec, RATE_GAIN, l), gained))

    return drifting


@overload(begin_offset, **COMPILED)
def _begin_offset(part, w, rec):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, rec):
        F = w.dtype.type
        for l in range(B):
            put(rec, RATE_GAIN, l, (F(0.0), F(0.0), F(0.0)))
            rec[RATE0 * B + l] = w[W_RATE * B + l]
            rec[TIME0 * B + l] = F(part.elapsed_s)

    return drifting


@overload(offset_belief, **COMPILED)
def _offset_belief(part, rec, lane, state, size, site):
    if not is_of(part, Drifting):
        return None

    def drifting(part, rec, lane, state, size, site):
        rate = part.sites + site
        since = part.elapsed_s - np.float64(rec[TIME0 * B + lane])
        cov = THETA + size
        mean = state[(THETA + site) * B + lane] - since * state[(THETA + rate) * B + lane]
        variance = state[(cov + site * size + site) * B + lane]
        variance -= 2.0 * since * state[(cov + site * size + rate) * B + lane]
        variance += since * since * state[(cov + rate * size + rate) * B + lane]
        return mean, variance, 1.0

    return drifting
