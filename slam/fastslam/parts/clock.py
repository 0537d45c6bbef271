"""Whose the clock offset is: parts of the filter.

Source: Schoen, Gustafsson and Nordlund, "Marginalized particle filters for mixed linear/nonlinear state-space models",
IEEE Trans. Signal Processing 53(7), 2005: the offsets are the linear part. That VTs depend on each other through their
offset alone is an own derivation (see `nuisance_kernel`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats
from cellslam.slam.fastslam.parts.part_types import COMPILED, is_of
from cellslam.slam.fastslam.state.lanes_kernel import mat_at, put_where, sym_at, vec_at
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
    W_INFO,
    W_INV,
    W_MASK,
    W_OFFSET_PRIOR,
    W_P,
    W_Y,
    Rows,
)
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
    Vec3,
    mat_sym,
    mat_vec,
    sym_plus,
    sym_product,
    transposed,
    vec_plus,
)

B = LANES


class OfSite(NamedTuple):
    """One offset a site, marginalised with the odometer errors: its VTs depend on each other through it alone."""


class OfVt(NamedTuple):
    """An offset for each VT, a fourth state beside its position, as where transmitters are not known to share one."""


class Drifting(NamedTuple):
    """One offset and one rate a site: what it does is in `drifting_clock`.

    `elapsed_s`: since the start; `sites`: how many.
    """

    elapsed_s: float
    sites: int


def clock_moves(part: Any, state: Rows, travelled: Floats, dt: float, size: int) -> None:
    """Let offsets that drift go on by an interval dt (s), and say how far (m) in travelled (size,)."""
    raise NotImplementedError


def rate_changes(part: Any, v: Rows, change: int, travelled: Floats) -> None:
    """Say how far rates that have changed move what is expected of tracks long unseen, in m, in travelled (size,).

    From row `change` of v on.
    """
    raise NotImplementedError


def load_clock(part: Any, w: Rows, state: Rows, site: int, size: int) -> None:
    """Copy what else concerns a site's clock."""
    raise NotImplementedError


def expect(part: Any, landmarks: Any, w: Rows, rec: Rows, out: Rows) -> None:
    """Write at O_OFFSET the offset with which a track's distances are expected, and at W_P what of the nuisances'
    covariance is the track's own; bring the record up to the present."""
    raise NotImplementedError


def widen(part: Any, w: Rows, rec: Rows, out: Rows) -> None:
    """Add to C what nuisances do that only this part knows of, once a track is predicted."""
    raise NotImplementedError


def correct_clock(part: Any, w: Rows, rec: Rows, out: Rows) -> None:
    """Update what the record holds for this part alone, where W_MASK is 1, before the rest of it is."""
    raise NotImplementedError


def absorb(part: Any, w: Rows, v: Rows, rec: Rows, out: Rows) -> None:
    """Add A^T S^-1 e and A^T S^-1 A of the association at hand, where W_MASK is 1, to the link's sums."""
    raise NotImplementedError


def begin_offset(part: Any, w: Rows, rec: Rows) -> None:
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


def offset_belief(part: Any, rec: Rows, lane: int, state: Rows, size: int, site: int) -> tuple[float, float, float]:
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


@njit(error_model="numpy")
def information(a: Mat3, inverse: Sym3, e: Vec3) -> tuple[Vec3, Sym3]:
    """Return y = A^T S^-1 e and I = A^T S^-1 A."""
    weighed = mat_sym(transposed(a), inverse)
    return mat_vec(weighed, e), sym_product(weighed, a)


@njit(error_model="numpy")
def absorb_all(w: Rows, out: Rows) -> None:
    """Add y and I of the pair at hand, where W_MASK is 1, to the link's sums."""
    half = w.dtype.type(0.5)
    for l in range(B):
        on = w[W_MASK * B + l] > half
        y, info = information(mat_at(out, O_A, l), sym_at(w, W_INV, l), vec_at(w, W_E, l))
        put_where(w, W_Y, l, on, vec_plus(vec_at(w, W_Y, l), y))
        put_where(w, W_INFO, l, on, sym_plus(sym_at(w, W_INFO, l), info))


@overload(absorb, **COMPILED)
def _absorb(part, w, v, rec, out):
    if is_of(part, OfSite):
        return lambda part, w, v, rec, out: absorb_all(w, out)
    if is_of(part, OfVt):

        def of_vt(part, w, v, rec, out):
            # The offset is settled at once: P' = P / (1 + P I); what is left for the others is the Schur complement.
            F = w.dtype.type
            none = F(0.0)
            for l in range(B):
                on = w[W_MASK * B + l] > F(0.5)
                y, i = information(mat_at(out, O_A, l), sym_at(w, W_INV, l), vec_at(w, W_E, l))
                variance = rec[OWN_VARIANCE * B + l]
                left = variance / (F(1.0) + variance * i.xx)
                if on:
                    rec[OWN_OFFSET * B + l] += left * y.x
                    rec[OWN_VARIANCE * B + l] = left
                    v[V_WEIGHT * B + l] += 0.5 * left * y.x * y.x - 0.5 * math.log(1.0 + variance * i.xx)
                by_bias, by_scale = i.xy * left, i.xz * left
                rest = Vec3(none, y.y - by_bias * y.x, y.z - by_scale * y.x)
                schur = Sym3(
                    none, none, none, i.yy - by_bias * i.xy, i.yz - by_bias * i.xz, i.zz - by_scale * i.xz
                )  # fmt: skip
                put_where(w, W_Y, l, on, vec_plus(vec_at(w, W_Y, l), rest))
                put_where(w, W_INFO, l, on, sym_plus(sym_at(w, W_INFO, l), schur))

        return of_vt
    return None
