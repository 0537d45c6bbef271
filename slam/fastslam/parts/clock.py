"""Whose the clock offset is: parts of the filter."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from cellslam.slam.fastslam.parts.part_types import COMPILED, is_of
from cellslam.slam.fastslam.state.layout import (
    LANES,
    O_A,
    O_OFFSET,
    OWN_OFFSET,
    OWN_VARIANCE,
    THETA,
    V_WEIGHT,
    W_B,
    W_E,
    W_INV,
    W_LINK,
    W_MASK,
    W_OFFSET_PRIOR,
    W_P,
)

B = LANES
A = O_A * B


class OfSite(NamedTuple):
    """One offset a site, marginalised with the odometer errors: its VTs depend on each other through it alone."""


class OfVt(NamedTuple):
    """An offset for each VT, a fourth state beside its position, as where transmitters are not known to share one."""


class Drifting(NamedTuple):
    """One offset and one rate a site: what it does is in `drift`. `elapsed_s`: since the start; `sites`: how many."""

    elapsed_s: float
    sites: int


def clock_moves(part, state, travelled, dt, size):
    """Let offsets that drift go on by an interval, and say how far."""
    raise NotImplementedError


def rate_changes(part, v, change, travelled):
    """Say how far rates that have changed (from row `change` of v on) move what is expected of tracks long unseen."""
    raise NotImplementedError


def load_clock(part, w, state, site, size):
    """Copy what else concerns a site's clock."""
    raise NotImplementedError


def expect(part, landmarks, w, rec, out):
    """Write at O_OFFSET the offset with which a track's distances are expected, and at W_P what of the nuisances'
    covariance is the track's own; bring the record up to the present."""
    raise NotImplementedError


def widen(part, w, rec, out):
    """Add to C what nuisances do that only this part knows of, once a track is predicted."""
    raise NotImplementedError


def correct_clock(part, w, rec, out):
    """Update what the record holds for this part alone, where W_MASK is 1, before the rest of it is."""
    raise NotImplementedError


def absorb(part, w, v, rec, out):
    """Add A^T S^-1 e and A^T S^-1 A of the association at hand, where W_MASK is 1, to the link's sums."""
    raise NotImplementedError


def begin_offset(part, w, rec):
    """Write what of the offset is a new track's own."""
    raise NotImplementedError


@overload(expect, **COMPILED)
def _expect(part, landmarks, w, rec, out):
    if is_of(part, OfSite):

        def shared(part, landmarks, w, rec, out):
            for l in range(B):
                out[O_OFFSET * B + l] = w[W_B * B + l]

        return shared
    if is_of(part, OfVt):

        def own(part, landmarks, w, rec, out):
            F = w.dtype.type
            for l in range(B):
                out[O_OFFSET * B + l] = rec[OWN_OFFSET * B + l]
                w[W_P * B + l] = rec[OWN_VARIANCE * B + l]
                w[(W_P + 1) * B + l] = F(0.0)
                w[(W_P + 2) * B + l] = F(0.0)

        return own
    return None


@overload(begin_offset, **COMPILED)
def _begin_offset(part, w, rec):
    if is_of(part, OfSite):
        return lambda part, w, rec: None
    if is_of(part, OfVt):

        def own(part, w, rec):
            for l in range(B):
                rec[OWN_OFFSET * B + l] = w[W_B * B + l]
                rec[OWN_VARIANCE * B + l] = w[W_OFFSET_PRIOR * B + l]

        return own
    return None


@overload(clock_moves, **COMPILED)
def _clock_moves(part, state, travelled, dt, size):
    return None if is_of(part, Drifting) else lambda part, state, travelled, dt, size: None


@overload(rate_changes, **COMPILED)
def _rate_changes(part, v, change, travelled):
    return None if is_of(part, Drifting) else lambda part, v, change, travelled: None


@overload(load_clock, **COMPILED)
def _load_clock(part, w, state, site, size):
    return None if is_of(part, Drifting) else lambda part, w, state, site, size: None


@overload(widen, **COMPILED)
def _widen(part, w, rec, out):
    return None if is_of(part, Drifting) else lambda part, w, rec, out: None


@overload(correct_clock, **COMPILED)
def _correct_clock(part, w, rec, out):
    return None if is_of(part, Drifting) else lambda part, w, rec, out: None


def offset_belief(part, rec, lane, state, size, site):
    """Return mean and variance of the offset that a track was last touched under, in one lane of a block's state, and
    1 where it is its site's, else 0."""
    raise NotImplementedError


@overload(offset_belief)
def _offset_belief(part, rec, lane, state, size, site):
    if is_of(part, OfSite):

        def shared(part, rec, lane, state, size, site):
            own = (THETA + size + site * size + site) * B + lane
            return state[(THETA + site) * B + lane], state[own], 1.0

        return shared
    if is_of(part, OfVt):

        def own(part, rec, lane, state, size, site):
            return np.float64(rec[OWN_OFFSET * B + lane]), np.float64(rec[OWN_VARIANCE * B + lane]), 0.0

        return own
    return None


@njit(inline="always")
def information(w, out, l):
    """Return y = A^T S^-1 e (3) and I = A^T S^-1 A (00 01 02 11 12 22) of the pair at hand in lane l."""
    i0, i1, i2 = w[W_INV * B + l], w[(W_INV + 1) * B + l], w[(W_INV + 2) * B + l]
    i3, i4, i5 = w[(W_INV + 3) * B + l], w[(W_INV + 4) * B + l], w[(W_INV + 5) * B + l]
    a0, a1, a2 = out[A + l], out[A + B + l], out[A + 2 * B + l]
    a3, a4, a5 = out[A + 3 * B + l], out[A + 4 * B + l], out[A + 5 * B + l]
    a6, a7, a8 = out[A + 6 * B + l], out[A + 7 * B + l], out[A + 8 * B + l]
    e0, e1, e2 = w[W_E * B + l], w[(W_E + 1) * B + l], w[(W_E + 2) * B + l]
    b0, b1, b2 = i0 * a0 + i1 * a3 + i2 * a6, i1 * a0 + i3 * a3 + i4 * a6, i2 * a0 + i4 * a3 + i5 * a6
    g0, g1, g2 = i0 * a1 + i1 * a4 + i2 * a7, i1 * a1 + i3 * a4 + i4 * a7, i2 * a1 + i4 * a4 + i5 * a7
    s0, s1, s2 = i0 * a2 + i1 * a5 + i2 * a8, i1 * a2 + i3 * a5 + i4 * a8, i2 * a2 + i4 * a5 + i5 * a8
    return (
        b0 * e0 + b1 * e1 + b2 * e2, g0 * e0 + g1 * e1 + g2 * e2, s0 * e0 + s1 * e1 + s2 * e2,
        b0 * a0 + b1 * a3 + b2 * a6, b0 * a1 + b1 * a4 + b2 * a7, b0 * a2 + b1 * a5 + b2 * a8,
        g0 * a1 + g1 * a4 + g2 * a7, g0 * a2 + g1 * a5 + g2 * a8, s0 * a2 + s1 * a5 + s2 * a8,
    )  # fmt: skip


@overload(absorb, **COMPILED)
def _absorb(part, w, v, rec, out):
    if is_of(part, OfSite):

        def of_site(part, w, v, rec, out):
            F = w.dtype.type
            none = F(0.0)
            for l in range(B):
                on = w[W_MASK * B + l] > F(0.5)
                y0, y1, y2, i00, i01, i02, i11, i12, i22 = information(w, out, l)
                w[W_LINK * B + l] += y0 if on else none
                w[(W_LINK + 1) * B + l] += y1 if on else none
                w[(W_LINK + 2) * B + l] += y2 if on else none
                w[(W_LINK + 3) * B + l] += i00 if on else none
                w[(W_LINK + 4) * B + l] += i01 if on else none
                w[(W_LINK + 5) * B + l] += i02 if on else none
                w[(W_LINK + 6) * B + l] += i11 if on else none
                w[(W_LINK + 7) * B + l] += i12 if on else none
                w[(W_LINK + 8) * B + l] += i22 if on else none

        return of_site
    if is_of(part, OfVt):

        def of_vt(part, w, v, rec, out):
            # The offset is settled at once: P' = P / (1 + P I); what is left for the others is the Schur complement.
            F = w.dtype.type
            none = F(0.0)
            for l in range(B):
                on = w[W_MASK * B + l] > F(0.5)
                y0, y1, y2, i00, i01, i02, i11, i12, i22 = information(w, out, l)
                variance = rec[OWN_VARIANCE * B + l]
                left = variance / (F(1.0) + variance * i00)
                if on:
                    rec[OWN_OFFSET * B + l] += left * y0
                    rec[OWN_VARIANCE * B + l] = left
                    v[V_WEIGHT * B + l] += 0.5 * left * y0 * y0 - 0.5 * math.log(1.0 + variance * i00)
                w[(W_LINK + 1) * B + l] += y1 - i01 * left * y0 if on else none
                w[(W_LINK + 2) * B + l] += y2 - i02 * left * y0 if on else none
                w[(W_LINK + 6) * B + l] += i11 - i01 * left * i01 if on else none
                w[(W_LINK + 7) * B + l] += i12 - i01 * left * i02 if on else none
                w[(W_LINK + 8) * B + l] += i22 - i02 * left * i02 if on else none

        return of_vt
    return None
