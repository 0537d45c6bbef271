"""Compiled: one VT as one particle sees it, and one birth."""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.fastslam.algebra import congruence
from cellslam.slam.fastslam.layout import (
    ANCHOR,
    BIAS0,
    GAIN,
    MEAN,
    OFFSET0,
    P_A,
    P_C,
    P_H,
    P_J,
    P_MEAN,
    P_POSITION,
    P_S,
    P_Z,
    SCALE0,
    SIGMA,
)


@njit(cache=True)
def predict_into(out, vt, pose, rot, drot, pose_g, b, bias, scale, cov):
    """Write the prediction of record `vt` into the scratch row `out` (see layout).

    `pose` (6,); `rot` (9,): body to world; `drot` (9,): its derivative by yaw; `pose_g` (6,): d(x, y, psi)/d(bias,
    scale); `b, bias, scale`: nuisance mean; `cov` (6,): its covariance for this site, symmetric.
    """
    db, dg, ds = b - vt[OFFSET0], bias - vt[BIAS0], scale - vt[SCALE0]
    rho = vt[MEAN] + vt[GAIN] * db + vt[GAIN + 1] * dg + vt[GAIN + 2] * ds
    az = vt[MEAN + 1] + vt[GAIN + 3] * db + vt[GAIN + 4] * dg + vt[GAIN + 5] * ds
    el = vt[MEAN + 2] + vt[GAIN + 6] * db + vt[GAIN + 7] * dg + vt[GAIN + 8] * ds
    out[P_MEAN], out[P_MEAN + 1], out[P_MEAN + 2] = rho, az, el
    ca, sa, ce, se = math.cos(az), math.sin(az), math.cos(el), math.sin(el)
    nx, ny = ce * ca, ce * sa
    # d(position)/d(rho, az, el), row by row
    out[P_J], out[P_J + 1], out[P_J + 2] = nx, -rho * ny, -rho * se * ca
    out[P_J + 3], out[P_J + 4], out[P_J + 5] = ny, rho * nx, -rho * se * sa
    out[P_J + 6], out[P_J + 7], out[P_J + 8] = se, 0.0, rho * ce
    px, py, pz = vt[ANCHOR] + rho * nx, vt[ANCHOR + 1] + rho * ny, vt[ANCHOR + 2] + rho * se
    out[P_POSITION], out[P_POSITION + 1], out[P_POSITION + 2] = px, py, pz
    wx, wy, wz = px - pose[0], py - pose[1], pz - pose[2]
    x = rot[0] * wx + rot[3] * wy + rot[6] * wz
    y = rot[1] * wx + rot[4] * wy + rot[7] * wz
    z = rot[2] * wx + rot[5] * wy + rot[8] * wz
    flat2 = max(x * x + y * y, 1e-12)
    full2 = flat2 + z * z
    flat, full = math.sqrt(flat2), math.sqrt(full2)
    out[P_Z], out[P_Z + 1], out[P_Z + 2] = full + b, math.atan2(y, x), math.atan2(z, flat)
    # M = d(distance, azimuth, elevation)/d(body vector)
    m0, m1, m2 = x / full, y / full, z / full
    m3, m4 = -y / flat2, x / flat2
    k = 1.0 / (flat * full2)
    m6, m7, m8 = -x * z * k, -y * z * k, flat / full2
    # W = M R^T = d(.)/d(world vector)
    w0 = m0 * rot[0] + m1 * rot[1] + m2 * rot[2]
    w1 = m0 * rot[3] + m1 * rot[4] + m2 * rot[5]
    w2 = m0 * rot[6] + m1 * rot[7] + m2 * rot[8]
    w3 = m3 * rot[0] + m4 * rot[1]
    w4 = m3 * rot[3] + m4 * rot[4]
    w5 = m3 * rot[6] + m4 * rot[7]
    w6 = m6 * rot[0] + m7 * rot[1] + m8 * rot[2]
    w7 = m6 * rot[3] + m7 * rot[4] + m8 * rot[5]
    w8 = m6 * rot[6] + m7 * rot[7] + m8 * rot[8]
    # H = W J
    out[P_H] = w0 * nx + w1 * ny + w2 * se
    out[P_H + 1] = w0 * out[P_J + 1] + w1 * out[P_J + 4]
    out[P_H + 2] = w0 * out[P_J + 2] + w1 * out[P_J + 5] + w2 * out[P_J + 8]
    out[P_H + 3] = w3 * nx + w4 * ny + w5 * se
    out[P_H + 4] = w3 * out[P_J + 1] + w4 * out[P_J + 4]
    out[P_H + 5] = w3 * out[P_J + 2] + w4 * out[P_J + 5] + w5 * out[P_J + 8]
    out[P_H + 6] = w6 * nx + w7 * ny + w8 * se
    out[P_H + 7] = w6 * out[P_J + 1] + w7 * out[P_J + 4]
    out[P_H + 8] = w6 * out[P_J + 2] + w7 * out[P_J + 5] + w8 * out[P_J + 8]
    # yaw column: M (dR/dpsi)^T w
    yx = drot[0] * wx + drot[3] * wy + drot[6] * wz
    yy = drot[1] * wx + drot[4] * wy + drot[7] * wz
    yz = drot[2] * wx + drot[5] * wy + drot[8] * wz
    t0, t1, t2 = m0 * yx + m1 * yy + m2 * yz, m3 * yx + m4 * yy, m6 * yx + m7 * yy + m8 * yz
    # A = H G + H_pose G_pose + e_d e_b^T
    for r in range(3):
        h0, h1, h2 = out[P_H + 3 * r], out[P_H + 3 * r + 1], out[P_H + 3 * r + 2]
        for c in range(3):
            out[P_A + 3 * r + c] = h0 * vt[GAIN + c] + h1 * vt[GAIN + 3 + c] + h2 * vt[GAIN + 6 + c]
    out[P_A] += 1.0
    out[P_A + 1] += t0 * pose_g[4] - w0 * pose_g[0] - w1 * pose_g[2]
    out[P_A + 2] += t0 * pose_g[5] - w0 * pose_g[1] - w1 * pose_g[3]
    out[P_A + 4] += t1 * pose_g[4] - w3 * pose_g[0] - w4 * pose_g[2]
    out[P_A + 5] += t1 * pose_g[5] - w3 * pose_g[1] - w4 * pose_g[3]
    out[P_A + 7] += t2 * pose_g[4] - w6 * pose_g[0] - w7 * pose_g[2]
    out[P_A + 8] += t2 * pose_g[5] - w6 * pose_g[1] - w7 * pose_g[3]
    s = congruence(out, P_H, vt[SIGMA], vt[SIGMA + 1], vt[SIGMA + 2], vt[SIGMA + 3], vt[SIGMA + 4], vt[SIGMA + 5])
    out[P_S], out[P_S + 1], out[P_S + 2], out[P_S + 3], out[P_S + 4], out[P_S + 5] = s
    q = congruence(out, P_A, cov[0], cov[1], cov[2], cov[3], cov[4], cov[5])
    out[P_C], out[P_C + 1], out[P_C + 2], out[P_C + 3], out[P_C + 4], out[P_C + 5] = q


@njit(cache=True)
def born_into(vt, rho, az, el, q, pose, rot, pose_g):
    """Write anchor, mean, Sigma and G of a VT born from a measurement (rho without offset; az, el in the body frame).

    `q` (3,): measurement variances. Given theta the birth is exact: range variance q_d, G = (-1, 0, 0) for the offset;
    what the pose owes to bias and scale is passed on to the VT (method: A and G in matrix form).
    """
    ca, sa, ce, se = math.cos(az), math.sin(az), math.cos(el), math.sin(el)
    bx, by = ce * ca, ce * sa
    nx = rot[0] * bx + rot[1] * by + rot[2] * se
    ny = rot[3] * bx + rot[4] * by + rot[5] * se
    nz = rot[6] * bx + rot[7] * by + rot[8] * se
    flat = max(math.sqrt(nx * nx + ny * ny), 1e-9)
    vt[ANCHOR], vt[ANCHOR + 1], vt[ANCHOR + 2] = pose[0], pose[1], pose[2]
    vt[MEAN], vt[MEAN + 1], vt[MEAN + 2] = rho, math.atan2(ny, nx), math.atan2(nz, flat)
    # world angles by body angles: rows of d(az, el)_world/d(unit vector) times R times d(unit vector)/d(az, el)_body
    ax, ay = -by, bx
    gx, gy, gz = -se * ca, -se * sa, ce
    uax, uay, uaz = rot[0] * ax + rot[1] * ay, rot[3] * ax + rot[4] * ay, rot[6] * ax + rot[7] * ay
    uex = rot[0] * gx + rot[1] * gy + rot[2] * gz
    uey = rot[3] * gx + rot[4] * gy + rot[5] * gz
    uez = rot[6] * gx + rot[7] * gy + rot[8] * gz
    f2 = flat * flat
    jaa, jae = (nx * uay - ny * uax) / f2, (nx * uey - ny * uex) / f2
    jea = flat * uaz - nz * (nx * uax + ny * uay) / flat
    jee = flat * uez - nz * (nx * uex + ny * uey) / flat
    vt[SIGMA], vt[SIGMA + 1], vt[SIGMA + 2] = q[0], 0.0, 0.0
    vt[SIGMA + 3] = jaa * jaa * q[1] + jae * jae * q[2]
    vt[SIGMA + 4] = jaa * jea * q[1] + jae * jee * q[2]
    vt[SIGMA + 5] = jea * jea * q[1] + jee * jee * q[2]
    for i in range(9):
        vt[GAIN + i] = 0.0
    vt[GAIN] = -1.0
    for c in range(2):
        gx, gy = pose_g[c], pose_g[2 + c]
        vt[GAIN + 1 + c] = nx * gx + ny * gy
        vt[GAIN + 4 + c] = (nx * gy - ny * gx) / (f2 * rho) + pose_g[4 + c]
        vt[GAIN + 7 + c] = -nz * (nx * gx + ny * gy) / (flat * rho)


@njit(cache=True)
def position_into(position, jacobian, vt, db, dg, ds):
    """Write the Cartesian position (3,) of a record at theta0 + (db, dg, ds), and its derivative (3, 3) by (range,
    az, el)."""
    rho = vt[MEAN] + vt[GAIN] * db + vt[GAIN + 1] * dg + vt[GAIN + 2] * ds
    az = vt[MEAN + 1] + vt[GAIN + 3] * db + vt[GAIN + 4] * dg + vt[GAIN + 5] * ds
    el = vt[MEAN + 2] + vt[GAIN + 6] * db + vt[GAIN + 7] * dg + vt[GAIN + 8] * ds
    ca, sa, ce, se = math.cos(az), math.sin(az), math.cos(el), math.sin(el)
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = ce * ca, -rho * ce * sa, -rho * se * ca
    jacobian[1, 0], jacobian[1, 1], jacobian[1, 2] = ce * sa, rho * ce * ca, -rho * se * sa
    jacobian[2, 0], jacobian[2, 1], jacobian[2, 2] = se, 0.0, rho * ce
    for r in range(3):
        position[r] = vt[ANCHOR + r] + rho * jacobian[r, 0]
