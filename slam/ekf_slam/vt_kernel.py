"""Compiled: one VT in spherical coordinates about its anchor: prediction, Jacobians, innovation covariance, birth.

Sources: paper, eq. 22 to 27, with the elevation corrected; coordinates about an anchor as in Civera, Davison and
Montiel, "Inverse depth parametrization for monocular SLAM", IEEE Trans. Robotics 24(5), 2008, but with the range
itself.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats
from cellslam.slam.ekf_slam.state_layout import OFFSET, POSE, TOUCHED, VT, Filter, states
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
    Vec3,
    columns,
    mat_mat,
    mat_vec,
    put_mat,
    scaled,
    transposed,
    transposed_vec,
    vec_of,
)
from cellslam.slam.model.measurement_kernel import (
    Rotations,
    Spherical,
    rotations,
    spherical,
    spherical_jacobian,
)


@njit(cache=True)
def rotations_of(f: Filter) -> Rotations:
    """Return the rotation of a filter's pose, and its derivatives."""
    return rotations(f.x[3], f.x[4], f.x[5])


@njit(cache=True)
def state_of(f: Filter, j: int, offset: int, column: int) -> int:
    """Return the state that a column of the Jacobian h belongs to: pose, clock offset, VT j."""
    if column < POSE:
        return column
    return offset if column == OFFSET else f.core.size + 3 * j + column - VT


@njit(cache=True)
def predict(f: Filter, j: int, turned: Rotations, h: Floats) -> Spherical:
    """Return h of VT j without the clock offset, and write its Jacobian into h (3, 10).

    Seen from the filter's pose, whose rotation is `turned`; the Jacobian is by pose, clock offset and range, azimuth,
    elevation of the VT. It stands at anchor + range * n(azimuth, elevation), angles in the world frame. In m and rad.
    """
    v, x, anchor = f.core.size + 3 * j, f.x, f.anchor[j]
    rho, ca, sa, ce, se = x[v], math.cos(x[v + 1]), math.sin(x[v + 1]), math.cos(x[v + 2]), math.sin(x[v + 2])
    nx, ny = ce * ca, ce * sa
    way = Vec3(anchor[0] + rho * nx - x[0], anchor[1] + rho * ny - x[1], anchor[2] + rho * se - x[2])
    body = transposed_vec(turned.r, way)
    by_body = spherical_jacobian(body)
    by_psi = mat_vec(by_body, transposed_vec(turned.by_psi, way))
    by_theta = mat_vec(by_body, transposed_vec(turned.by_theta, way))
    by_phi = mat_vec(by_body, transposed_vec(turned.by_phi, way))
    put_mat(h, scaled(mat_mat(by_body, transposed(turned.r)), -1.0))
    put_mat(h[:, 3:], columns(by_psi, by_theta, by_phi))
    for r in range(3):
        a, b, c = -h[r, 0], -h[r, 1], -h[r, 2]
        h[r, OFFSET] = 1.0 if r == 0 else 0.0
        h[r, VT] = a * nx + b * ny + c * se
        h[r, VT + 1] = rho * (-a * ny + b * nx)
        h[r, VT + 2] = rho * (-a * se * ca - b * se * sa + c * ce)
    return spherical(body)


@njit(cache=True)
def gains(f: Filter, j: int, offset: int, h: Floats, t: Floats) -> None:
    """Write T = H P (3, states) into t, H over pose, clock offset and, where it is mapped, VT j.

    h (3, 10) as `predict` writes it, in m and rad; T has the units of measurement times state.
    """
    p, size = f.p, states(f)
    t[:, :size] = 0.0
    t[0, :size] = p[offset, :size]
    for c in range(TOUCHED if f.mapped else POSE):
        if c == OFFSET or (c < POSE and p[c, c] <= 0.0):
            continue
        row, h0, h1, h2 = p[state_of(f, j, offset, c)], h[0, c], h[1, c], h[2, c]
        for i in range(size):
            t[0, i] += h0 * row[i]
            t[1, i] += h1 * row[i]
            t[2, i] += h2 * row[i]


@njit(cache=True)
def covariance_of(f: Filter, j: int, offset: int, h: Floats, t: Floats) -> Sym3:
    """Return T H^T in m^2, m rad and rad^2, T (3, states) as `gains` writes it; the mean of both triangles."""
    xy, yx = _product(f, j, offset, t[0], h[1]), _product(f, j, offset, t[1], h[0])
    xz, zx = _product(f, j, offset, t[0], h[2]), _product(f, j, offset, t[2], h[0])
    yz, zy = _product(f, j, offset, t[1], h[2]), _product(f, j, offset, t[2], h[1])
    return Sym3(
        _product(f, j, offset, t[0], h[0]), 0.5 * (yx + xy), 0.5 * (zx + xz),
        _product(f, j, offset, t[1], h[1]), 0.5 * (zy + yz), _product(f, j, offset, t[2], h[2]),
    )  # fmt: skip


@njit(cache=True)
def _product(f: Filter, j: int, offset: int, t: Floats, h: Floats) -> float:
    """Return the product of a row over the states with a row (10,) of the Jacobian."""
    total = t[offset] * h[OFFSET]
    for c in range(TOUCHED if f.mapped else POSE):
        if c != OFFSET:
            total += t[state_of(f, j, offset, c)] * h[c]
    return float(total)


@njit(cache=True)
def covariance(f: Filter, j: int, offset: int, h: Floats, narrow: Floats) -> Sym3:
    """Return H P H^T in m^2, m rad and rad^2; `narrow` (3, 10): scratch. H P for the columns that H touches alone."""
    p, touched = f.p, TOUCHED if f.mapped else VT
    narrow[:] = 0.0
    for k in range(touched):
        i = state_of(f, j, offset, k)
        narrow[0, k] = p[offset, i]
        for c in range(touched):
            value = p[state_of(f, j, offset, c), i]
            if c != OFFSET and value != 0.0:
                narrow[0, k] += h[0, c] * value
                narrow[1, k] += h[1, c] * value
                narrow[2, k] += h[2, c] * value
    return Sym3(
        _dot(narrow[0], h[0]), _dot(narrow[0], h[1]), _dot(narrow[0], h[2]),
        _dot(narrow[1], h[1]), _dot(narrow[1], h[2]), _dot(narrow[2], h[2]),
    )  # fmt: skip


@njit(cache=True)
def _dot(a: Floats, b: Floats) -> float:
    """Return the product of two rows (10,), the clock offset first."""
    total = a[OFFSET] * b[OFFSET]
    for c in range(TOUCHED):
        if c != OFFSET:
            total += a[c] * b[c]
    return float(total)


@njit(cache=True)
def give_birth(f: Filter, j: int, offset: int, z: Floats, q: Floats, ranged: bool) -> None:
    """Append VT j, the last one, where a measurement points to, its covariance through pose, clock offset and
    measurement.

    z, q (3,): measurement in m and rad, and its variances; ranged: the distance was measured; a guess has nothing to do
    with the offset.
    """
    x, p, v, turned = f.x, f.p, f.core.size + 3 * j, rotations_of(f)
    by_offset = 1.0 if ranged else 0.0
    rho = z[0] - x[offset]
    cb, sb, cl, sl = math.cos(z[1]), math.sin(z[1]), math.cos(z[2]), math.sin(z[2])
    n = Vec3(cl * cb, cl * sb, sl)
    w = mat_vec(turned.r, n)
    az, ce, se = math.atan2(w.y, w.x), max(math.sqrt(w.x * w.x + w.y * w.y), 1e-6), min(max(w.z, -1.0), 1.0)
    ca, sa = math.cos(az), math.sin(az)
    x[v], x[v + 1], x[v + 2] = rho, az, math.atan2(se, ce)
    f.anchor[j, :3] = x[:3]
    inverse = Mat3(
        ce * ca, ce * sa, se, -sa / (rho * ce), ca / (rho * ce), 0.0, -se * ca / rho, -se * sa / rho, ce / rho
    )
    by = np.empty((3, TOUCHED))
    put_mat(by, inverse)
    by_psi, by_theta = mat_vec(inverse, mat_vec(turned.by_psi, n)), mat_vec(inverse, mat_vec(turned.by_theta, n))
    by_phi = mat_vec(inverse, mat_vec(turned.by_phi, n))
    put_mat(by[:, 3:], scaled(columns(by_psi, by_theta, by_phi), rho))
    put_mat(by[:, VT:], mat_mat(inverse, turned.r))
    for r in range(3):
        b = vec_of(by[r, VT:])
        by[r, OFFSET] = -by_offset if r == 0 else 0.0
        by[r, VT] = b.x * n.x + b.y * n.y + b.z * n.z
        by[r, VT + 1] = rho * cl * (-b.x * sb + b.y * cb)
        by[r, VT + 2] = rho * (-b.x * sl * cb - b.y * sl * sb + b.z * cl)
    for r in range(3):
        for i in range(v):
            total = by[r, OFFSET] * p[offset, i]
            for c in range(POSE):
                total += by[r, c] * p[c, i]
            p[v + r, i] = total
            p[i, v + r] = total
    for r in range(3):
        for s in range(r, 3):
            total = p[v + r, offset] * by[s, OFFSET]
            for c in range(POSE):
                total += p[v + r, c] * by[s, c]
            for c in range(3):
                total += by[r, VT + c] * q[c] * by[s, VT + c]
            p[v + r, v + s] = total
            p[v + s, v + r] = total
