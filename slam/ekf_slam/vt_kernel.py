"""Compiled: one VT in spherical coordinates about its anchor: prediction, Jacobians, innovation covariance, birth."""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.ekf_slam.state_layout import BY_POSE, BY_VT, PREDICTED, ROT


@njit(cache=True)
def predict(g, x, anchor, v):
    """Write h, dh/dpose and dh/d(range, azimuth, elevation) of the VT at state v into geometry g (rotations are there).

    The VT stands at anchor + range * n(azimuth, elevation), angles in the world frame.
    """
    rho, az, el = x[v], x[v + 1], x[v + 2]
    ca, sa, ce, se = math.cos(az), math.sin(az), math.cos(el), math.sin(el)
    nx, ny = ce * ca, ce * sa
    wx, wy, wz = anchor[0] + rho * nx - x[0], anchor[1] + rho * ny - x[1], anchor[2] + rho * se - x[2]
    bx = g[ROT] * wx + g[ROT + 3] * wy + g[ROT + 6] * wz
    by = g[ROT + 1] * wx + g[ROT + 4] * wy + g[ROT + 7] * wz
    bz = g[ROT + 2] * wx + g[ROT + 5] * wy + g[ROT + 8] * wz
    flat2 = max(bx * bx + by * by, 1e-6)
    full2 = flat2 + bz * bz
    flat, full = math.sqrt(flat2), math.sqrt(full2)
    g[PREDICTED], g[PREDICTED + 1], g[PREDICTED + 2] = full, math.atan2(by, bx), math.atan2(bz, flat)
    k = 1.0 / (flat * full2)
    for r in range(3):
        if r == 0:
            mx, my, mz = bx / full, by / full, bz / full
        elif r == 1:
            mx, my, mz = -by / flat2, bx / flat2, 0.0
        else:
            mx, my, mz = -bx * bz * k, -by * bz * k, flat / full2
        vx = mx * g[ROT] + my * g[ROT + 1] + mz * g[ROT + 2]
        vy = mx * g[ROT + 3] + my * g[ROT + 4] + mz * g[ROT + 5]
        vz = mx * g[ROT + 6] + my * g[ROT + 7] + mz * g[ROT + 8]
        h = BY_POSE + 6 * r
        g[h], g[h + 1], g[h + 2] = -vx, -vy, -vz
        for a in range(3):
            d = ROT + 9 + 9 * a
            tx = g[d] * wx + g[d + 3] * wy + g[d + 6] * wz
            ty = g[d + 1] * wx + g[d + 4] * wy + g[d + 7] * wz
            tz = g[d + 2] * wx + g[d + 5] * wy + g[d + 8] * wz
            g[h + 3 + a] = mx * tx + my * ty + mz * tz
        h = BY_VT + 3 * r
        g[h] = vx * nx + vy * ny + vz * se
        g[h + 1] = rho * (-vx * ny + vy * nx)
        g[h + 2] = rho * (-vx * se * ca - vy * se * sa + vz * ce)


@njit(cache=True)
def gains(g, p, size, offset, v, mapped, t):
    """Write T = H P (3, size) into t, H over pose, clock offset and, if `mapped`, the VT's own three states."""
    for j in range(size):
        for r in range(3):
            t[r, j] = 0.0
        t[0, j] = p[offset, j]
    for c in range(6):
        if p[c, c] > 0.0:
            h0, h1, h2 = g[BY_POSE + c], g[BY_POSE + 6 + c], g[BY_POSE + 12 + c]
            for j in range(size):
                t[0, j] += h0 * p[c, j]
                t[1, j] += h1 * p[c, j]
                t[2, j] += h2 * p[c, j]
    if mapped:
        for c in range(3):
            h0, h1, h2 = g[BY_VT + c], g[BY_VT + 3 + c], g[BY_VT + 6 + c]
            for j in range(size):
                t[0, j] += h0 * p[v + c, j]
                t[1, j] += h1 * p[v + c, j]
                t[2, j] += h2 * p[v + c, j]


@njit(cache=True)
def innovation(g, p, offset, v, mapped, small, s):
    """Write S = H P H^T (3, 3) into s; small (3, 10): scratch. `gains`, for the columns that H touches alone."""
    for k in range(10):
        j = k if k < 6 else (offset if k == 6 else v + k - 7)
        small[0, k] = small[1, k] = small[2, k] = 0.0
        if k > 6 and not mapped:
            continue
        small[0, k] = p[offset, j]
        for c in range(6):
            value = p[c, j]
            if value != 0.0:
                small[0, k] += g[BY_POSE + c] * value
                small[1, k] += g[BY_POSE + 6 + c] * value
                small[2, k] += g[BY_POSE + 12 + c] * value
        if mapped:
            for c in range(3):
                value = p[v + c, j]
                small[0, k] += g[BY_VT + c] * value
                small[1, k] += g[BY_VT + 3 + c] * value
                small[2, k] += g[BY_VT + 6 + c] * value
    for a in range(3):
        for b in range(3):
            total = small[a, 6] if b == 0 else 0.0
            for c in range(6):
                total += small[a, c] * g[BY_POSE + 6 * b + c]
            for c in range(3):
                total += small[a, 7 + c] * g[BY_VT + 3 * b + c]
            s[a, b] = total


@njit(cache=True)
def give_birth(g, x, p, size, anchor, offset, z, q, ranged, small):
    """Append a VT at states size..size + 2, its covariance through pose, clock offset and measurement.

    Rotations of the pose must be in g. ranged: the distance was measured; a guess has nothing to do with the offset.
    small (3, 10): scratch.
    """
    by_offset = 1.0 if ranged else 0.0
    rho = z[0] - x[offset]
    cb, sb, cl, sl = math.cos(z[1]), math.sin(z[1]), math.cos(z[2]), math.sin(z[2])
    n0, n1, n2 = cl * cb, cl * sb, sl
    wx = g[ROT] * n0 + g[ROT + 1] * n1 + g[ROT + 2] * n2
    wy = g[ROT + 3] * n0 + g[ROT + 4] * n1 + g[ROT + 5] * n2
    wz = min(max(g[ROT + 6] * n0 + g[ROT + 7] * n1 + g[ROT + 8] * n2, -1.0), 1.0)
    az, ce = math.atan2(wy, wx), max(math.sqrt(wx * wx + wy * wy), 1e-6)
    el = math.atan2(wz, ce)
    ca, sa, se = math.cos(az), math.sin(az), wz
    x[size], x[size + 1], x[size + 2] = rho, az, el
    anchor[0], anchor[1], anchor[2] = x[0], x[1], x[2]
    # Rows of the inverse of dv/d(range, azimuth, elevation), times d(v)/d(pose) (columns 0-5) and d(v)/d(z) (7-9)
    for r in range(3):
        if r == 0:
            ix, iy, iz = ce * ca, ce * sa, se
        elif r == 1:
            ix, iy, iz = -sa / (rho * ce), ca / (rho * ce), 0.0
        else:
            ix, iy, iz = -se * ca / rho, -se * sa / rho, ce / rho
        small[r, 0], small[r, 1], small[r, 2] = ix, iy, iz
        for a in range(3):
            d = ROT + 9 + 9 * a
            tx = g[d] * n0 + g[d + 1] * n1 + g[d + 2] * n2
            ty = g[d + 3] * n0 + g[d + 4] * n1 + g[d + 5] * n2
            tz = g[d + 6] * n0 + g[d + 7] * n1 + g[d + 8] * n2
            small[r, 3 + a] = rho * (ix * tx + iy * ty + iz * tz)
        bx = ix * g[ROT] + iy * g[ROT + 3] + iz * g[ROT + 6]
        by = ix * g[ROT + 1] + iy * g[ROT + 4] + iz * g[ROT + 7]
        bz = ix * g[ROT + 2] + iy * g[ROT + 5] + iz * g[ROT + 8]
        small[r, 7] = bx * n0 + by * n1 + bz * n2
        small[r, 8] = rho * cl * (-bx * sb + by * cb)
        small[r, 9] = rho * (-bx * sl * cb - by * sl * sb + bz * cl)
    for r in range(3):
        for j in range(size):
            total = -by_offset * p[offset, j] if r == 0 else 0.0
            for c in range(6):
                total += small[r, c] * p[c, j]
            p[size + r, j] = total
            p[j, size + r] = total
    for r in range(3):
        for s in range(r, 3):
            total = -by_offset * p[size + r, offset] if s == 0 else 0.0
            for c in range(6):
                total += p[size + r, c] * small[s, c]
            for c in range(3):
                total += small[r, 7 + c] * q[c] * small[s, 7 + c]
            p[size + r, size + s] = total
            p[size + s, size + r] = total
