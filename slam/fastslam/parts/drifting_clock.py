"""Clocks that drift: an offset and its constant rate for each site, both marginalised: a part of the filter.

theta has the rates between the offsets and the odometer errors, and the offsets of the present. A VT was touched under
the offset of its time, b(t0) = b(t) - rate (t - t0), so that given the present theta

    s | theta ~ N(mu + G (theta - theta0) + G_rate (rate - rate0), Sigma),   G_rate -= (t - t0) G_offset,

which a record takes up whenever it is predicted: RATE_GAIN is G_rate, RATE0 and TIME0 are rate0 and t0.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numba.extending import overload

from cellslam.slam.fastslam.parts.clock import (
    Drifting,
    absorb,
    begin_offset,
    clock_moves,
    correct_clock,
    expect,
    information,
    load_clock,
    offset_belief,
    rate_changes,
    widen,
)
from cellslam.slam.fastslam.parts.landmarks import moved
from cellslam.slam.fastslam.parts.part_types import COMPILED, is_of
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
    W_LINK,
    W_MASK,
    W_PR,
    W_RATE,
    W_SITE,
)

B = LANES


def drifting(sites: int) -> Drifting:
    """Return the part for so many sites, at the start."""
    return Drifting(0.0, sites)


@njit(inline="always")
def weighed(w, out, l):
    """Return A_rate (3) and S^-1 A_rate (3) of the pair at hand in lane l, the latter 0 where W_MASK is."""
    on = w[W_MASK * B + l]
    a0, a1, a2 = out[O_AR * B + l], out[(O_AR + 1) * B + l], out[(O_AR + 2) * B + l]
    i0, i1, i2 = w[W_INV * B + l], w[(W_INV + 1) * B + l], w[(W_INV + 2) * B + l]
    i3, i4, i5 = w[(W_INV + 3) * B + l], w[(W_INV + 4) * B + l], w[(W_INV + 5) * B + l]
    u0, u1, u2 = i0 * a0 + i1 * a1 + i2 * a2, i1 * a0 + i3 * a1 + i4 * a2, i2 * a0 + i4 * a1 + i5 * a2
    return a0, a1, a2, on * u0, on * u1, on * u2


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
                largest = max(largest, abs(v[change + (part.sites + site) * B + l]))
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
            r0 = rec[RATE_GAIN * B + l] - since * rec[GAIN * B + l]
            r1 = rec[(RATE_GAIN + 1) * B + l] - since * rec[(GAIN + 3) * B + l]
            r2 = rec[(RATE_GAIN + 2) * B + l] - since * rec[(GAIN + 6) * B + l]
            rec[RATE_GAIN * B + l] = r0
            rec[(RATE_GAIN + 1) * B + l] = r1
            rec[(RATE_GAIN + 2) * B + l] = r2
            rec[OFFSET0 * B + l] += since * was
            change = w[W_RATE * B + l] - was
            mu = (
                rec[MU * B + l], rec[(MU + 1) * B + l], rec[(MU + 2) * B + l], rec[(MU + 3) * B + l],
                rec[(MU + 4) * B + l],
            )  # fmt: skip
            m0, m1, m2, m3, m4 = moved(landmarks, F, mu, change * r0, change * r1, change * r2)
            rec[MU * B + l] = m0
            rec[(MU + 1) * B + l] = m1
            rec[(MU + 2) * B + l] = m2
            rec[(MU + 3) * B + l] = m3
            rec[(MU + 4) * B + l] = m4
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
            r0, r1 = rec[RATE_GAIN * B + l], rec[(RATE_GAIN + 1) * B + l]
            r2 = rec[(RATE_GAIN + 2) * B + l]
            a0 = out[O_H * B + l] * r0 + out[(O_H + 1) * B + l] * r1 + out[(O_H + 2) * B + l] * r2
            a1 = out[(O_H + 3) * B + l] * r0 + out[(O_H + 4) * B + l] * r1 + out[(O_H + 5) * B + l] * r2
            a2 = out[(O_H + 6) * B + l] * r0 + out[(O_H + 7) * B + l] * r1 + out[(O_H + 8) * B + l] * r2
            out[O_AR * B + l] = a0
            out[(O_AR + 1) * B + l] = a1
            out[(O_AR + 2) * B + l] = a2
            half, by_b = 0.5 * w[W_PR * B + l], w[(W_PR + 1) * B + l]
            by_g, by_s = w[(W_PR + 2) * B + l], w[(W_PR + 3) * B + l]
            # A P A^T gains q a^T + a q^T, q = A P_rate + a P_rate,rate / 2
            q0 = out[O_A * B + l] * by_b + out[(O_A + 1) * B + l] * by_g + out[(O_A + 2) * B + l] * by_s + a0 * half
            q1 = out[(O_A + 3) * B + l] * by_b + out[(O_A + 4) * B + l] * by_g + out[(O_A + 5) * B + l] * by_s
            q1 += a1 * half
            q2 = out[(O_A + 6) * B + l] * by_b + out[(O_A + 7) * B + l] * by_g + out[(O_A + 8) * B + l] * by_s
            q2 += a2 * half
            out[O_C * B + l] += 2.0 * q0 * a0
            out[(O_C + 1) * B + l] += q0 * a1 + q1 * a0
            out[(O_C + 2) * B + l] += q0 * a2 + q2 * a0
            out[(O_C + 3) * B + l] += 2.0 * q1 * a1
            out[(O_C + 4) * B + l] += q1 * a2 + q2 * a1
            out[(O_C + 5) * B + l] += 2.0 * q2 * a2

    return drifting


@overload(absorb, **COMPILED)
def _absorb(part, w, v, rec, out):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, v, rec, out):
        size, site = 2 * part.sites + 2, int(w[W_SITE * B])
        rate = part.sites + site
        own, square = (V_Y + rate) * B, V_Y + size
        by_offset, by_self = (square + rate * size + site) * B, (square + rate * size + rate) * B
        by_bias, by_scale = (square + (size - 2) * size + rate) * B, (square + (size - 1) * size + rate) * B
        for l in range(B):
            on = w[W_MASK * B + l]
            y0, y1, y2, i00, i01, i02, i11, i12, i22 = information(w, out, l)
            w[W_LINK * B + l] += on * y0
            w[(W_LINK + 1) * B + l] += on * y1
            w[(W_LINK + 2) * B + l] += on * y2
            w[(W_LINK + 3) * B + l] += on * i00
            w[(W_LINK + 4) * B + l] += on * i01
            w[(W_LINK + 5) * B + l] += on * i02
            w[(W_LINK + 6) * B + l] += on * i11
            w[(W_LINK + 7) * B + l] += on * i12
            w[(W_LINK + 8) * B + l] += on * i22
        for l in range(B):
            a0, a1, a2, u0, u1, u2 = weighed(w, out, l)
            v[own + l] += u0 * w[W_E * B + l] + u1 * w[(W_E + 1) * B + l] + u2 * w[(W_E + 2) * B + l]
            v[by_self + l] += u0 * a0 + u1 * a1 + u2 * a2
            v[by_offset + l] += u0 * out[O_A * B + l] + u1 * out[(O_A + 3) * B + l] + u2 * out[(O_A + 6) * B + l]
            v[by_bias + l] += u0 * out[(O_A + 1) * B + l] + u1 * out[(O_A + 4) * B + l] + u2 * out[(O_A + 7) * B + l]
            v[by_scale + l] += u0 * out[(O_A + 2) * B + l] + u1 * out[(O_A + 5) * B + l] + u2 * out[(O_A + 8) * B + l]

    return drifting


@overload(correct_clock, **COMPILED)
def _correct_clock(part, w, rec, out):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, rec, out):
        # G_rate -= K A_rate, K = Sigma H^T S^-1
        for l in range(B):
            _, _, _, u0, u1, u2 = weighed(w, out, l)
            x0 = out[O_H * B + l] * u0 + out[(O_H + 3) * B + l] * u1 + out[(O_H + 6) * B + l] * u2
            x1 = out[(O_H + 1) * B + l] * u0 + out[(O_H + 4) * B + l] * u1 + out[(O_H + 7) * B + l] * u2
            x2 = out[(O_H + 2) * B + l] * u0 + out[(O_H + 5) * B + l] * u1 + out[(O_H + 8) * B + l] * u2
            s0, s1, s2 = rec[SIGMA * B + l], rec[(SIGMA + 1) * B + l], rec[(SIGMA + 2) * B + l]
            s3, s4, s5 = rec[(SIGMA + 3) * B + l], rec[(SIGMA + 4) * B + l], rec[(SIGMA + 5) * B + l]
            rec[RATE_GAIN * B + l] -= s0 * x0 + s1 * x1 + s2 * x2
            rec[(RATE_GAIN + 1) * B + l] -= s1 * x0 + s3 * x1 + s4 * x2
            rec[(RATE_GAIN + 2) * B + l] -= s2 * x0 + s4 * x1 + s5 * x2

    return drifting


@overload(begin_offset, **COMPILED)
def _begin_offset(part, w, rec):
    if not is_of(part, Drifting):
        return None

    def drifting(part, w, rec):
        F = w.dtype.type
        for l in range(B):
            rec[RATE_GAIN * B + l] = F(0.0)
            rec[(RATE_GAIN + 1) * B + l] = F(0.0)
            rec[(RATE_GAIN + 2) * B + l] = F(0.0)
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
