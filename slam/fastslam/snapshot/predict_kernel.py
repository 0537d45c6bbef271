"""Compiled: one track as each particle of a block sees it.

Every loop runs over the LANES particles of a block at constant offsets of the scratch array (see layout).
"""

from __future__ import annotations

import math
from typing import Any

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.parts.clock import refresh, widen
from cellslam.slam.fastslam.parts.part_types import Parts
from cellslam.slam.fastslam.state.lanes_kernel import columns_at, five_at, mat_at, put, sym_at, vec_at
from cellslam.slam.fastslam.state.layout import (
    ANCHOR,
    GAIN,
    LANES,
    MU,
    O_A,
    O_C,
    O_H,
    O_MU,
    O_S,
    O_X,
    SIGMA,
    THETA0,
    W_G,
    W_P,
    W_POSE,
    W_ROT,
    W_THETA,
    Rows,
)
from cellslam.slam.fastslam.state.spherical_vt_kernel import moved, place, slopes
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Vec3,
    congruence,
    mat_mat,
    mat_vec,
    transposed,
    transposed_vec,
    vec_minus,
)

B = LANES


@njit(error_model="numpy")
def predict(parts: Parts, w: Rows, rec: Rows, out: Rows) -> None:
    """Predict a record: h, H, A, H Sigma H^T (O_S), C = A P A^T (docs/explanation/fastslam.md, step 2), by lanes."""
    F = w.dtype.type
    refresh(parts.clock, w, rec)
    for l in range(B):
        gain = mat_at(rec, GAIN, l)
        # mu + G (theta - theta0)
        change = mat_vec(gain, vec_minus(vec_at(w, W_THETA, l), vec_at(rec, THETA0, l)))
        mu = moved(F, five_at(rec, MU, l), change)
        put(out, O_MU, l, mu)
        # the VT from the body, q = R^T (v - r)
        rotation = mat_at(w, W_ROT, l)
        away = vec_minus(place(vec_at(rec, ANCHOR, l), mu), vec_at(w, W_POSE, l))
        x, y, z = transposed_vec(rotation, away)
        flat2 = max(x * x + y * y, F(1e-6))
        full2 = flat2 + z * z
        flat, full = math.sqrt(flat2), math.sqrt(full2)
        put(out, O_X, l, (x, y, z, flat, full))
        # M = dh/dq, V = dh/dv = M R^T, H = V dv/ds
        by_body = _slopes_in_body(F, x, y, z, flat2, flat, full)
        by_place = mat_mat(by_body, transposed(rotation))
        h = mat_mat(by_place, slopes(F, mu))
        put(out, O_H, l, h)
        # A = H G + H_pose G_pose + e_d e_b^T; yaw turns about the world's z: (dR/dpsi)^T a = R^T (a_y, -a_x, 0)
        by_yaw = mat_vec(by_body, transposed_vec(rotation, Vec3(away.y, -away.x, F(0.0))))
        hg = mat_mat(h, gain)
        pose_by_bias, pose_by_scale = columns_at(w, W_G, l)
        bias = _with_pose(Vec3(hg.xy, hg.yy, hg.zy), by_place, by_yaw, pose_by_bias)
        scale = _with_pose(Vec3(hg.xz, hg.yz, hg.zz), by_place, by_yaw, pose_by_scale)
        put(out, O_A, l, Mat3(hg.xx + F(1.0), bias.x, scale.x, hg.yx, bias.y, scale.y, hg.zx, bias.z, scale.z))
    for l in range(B):
        put(out, O_S, l, congruence(mat_at(out, O_H, l), sym_at(rec, SIGMA, l)))
    for l in range(B):
        put(out, O_C, l, congruence(mat_at(out, O_A, l), sym_at(w, W_P, l)))
    widen(parts.clock, w, rec, out)


@njit(error_model="numpy")
def _slopes_in_body(F: Any, x: Any, y: Any, z: Any, flat2: Any, flat: Any, full: Any) -> Mat3:
    """Return d(distance, azimuth, elevation)/d(x, y, z) in the body frame."""
    i1, i2 = F(1.0) / full, F(1.0) / flat2
    k = i1 * i1 / flat
    return Mat3(x * i1, y * i1, z * i1, -y * i2, x * i2, F(0.0), -x * z * k, -y * z * k, flat * i1 * i1)


@njit(error_model="numpy")
def _with_pose(hg: Vec3, by_place: Mat3, by_yaw: Vec3, pose: Vec3) -> Vec3:
    """Return a column of H G + H_pose G_pose, of the latter d(x, y, psi); H_pose = (-V, by yaw)."""
    return Vec3(
        hg.x + by_yaw.x * pose.z - by_place.xx * pose.x - by_place.xy * pose.y,
        hg.y + by_yaw.y * pose.z - by_place.yx * pose.x - by_place.yy * pose.y,
        hg.z + by_yaw.z * pose.z - by_place.zx * pose.x - by_place.zy * pose.y,
    )
