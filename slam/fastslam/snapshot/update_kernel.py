"""Compiled: what one association does to a track and to the particle's weight."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.parts.criterion import LOG_2PI_3
from cellslam.slam.fastslam.state.lanes_kernel import five_at, mat_at, put, put_where, sym_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    GAIN,
    HITS,
    LANES,
    MU,
    O_A,
    O_H,
    O_MU,
    O_SCORE,
    SIGMA,
    THETA0,
    V_WEIGHT,
    W_D2,
    W_E,
    W_INV,
    W_LOG,
    W_MASK,
    W_THETA,
    Rows,
)
from cellslam.slam.fastslam.state.spherical_vt_kernel import corrected
from cellslam.slam.model.matrices_kernel import (
    mat_mat,
    mat_minus,
    mat_sym,
    mat_vec,
    scaled,
    sym_minus,
    sym_product,
    transposed,
)

B = LANES


@njit(cache=True, error_model="numpy")
def correct(w: Rows, rec: Rows, out: Rows) -> None:
    """Update a record where W_MASK is 1: K = Sigma H^T S^-1, mu += K e, G -= K A, Sigma -= K H Sigma."""
    F = w.dtype.type
    for l in range(B):
        on = w[W_MASK * B + l]
        sigma, h, a = sym_at(rec, SIGMA, l), mat_at(out, O_H, l), mat_at(out, O_A, l)
        t = mat_sym(h, sigma)
        k = scaled(mat_sym(transposed(t), sym_at(w, W_INV, l)), on)
        mu = corrected(F, five_at(out, O_MU, l), mat_vec(k, vec_at(w, W_E, l)))
        put_where(rec, MU, l, on > F(0.5), mu)
        put(rec, GAIN, l, mat_minus(mat_at(rec, GAIN, l), mat_mat(k, a)))
        put(rec, SIGMA, l, sym_minus(sigma, sym_product(k, t)))
        rec[HITS * B + l] += on
        put_where(rec, THETA0, l, on > F(0.5), vec_at(w, W_THETA, l))


@njit(cache=True, error_model="numpy")
def credit(w: Rows, v: Rows, out: Rows, lack: Any, share: float) -> None:
    """Add what the association at hand is worth, where W_MASK is 1: the fit e^T S^-1 e, and `share` of all the rest.

    `lack`: see `measurement_kernel.pack`. The links of a site see the same VT come and go, so that each counts for its
    share only.
    """
    F = w.dtype.type
    half, part, rest = F(0.5), F(share), F(lack - LOG_2PI_3)
    for l in range(B):
        value = part * (out[O_SCORE * B + l] + rest - half * w[W_LOG * B + l]) - half * w[W_D2 * B + l]
        v[V_WEIGHT * B + l] += value if w[W_MASK * B + l] > half else F(0.0)


@njit(cache=True, error_model="numpy")
def mask(w: Rows, row_of: Rows, q: int) -> bool:
    """Set W_MASK to 1 in the lanes whose measurement goes to track q; return whether there are any."""
    F = w.dtype.type
    wanted, any_ = np.int32(q), np.int32(0)
    for l in range(B):
        w[W_MASK * B + l] = F(1.0) if row_of[l] == wanted else F(0.0)
        any_ |= np.int32(row_of[l] == wanted)
    return bool(any_ != 0)
