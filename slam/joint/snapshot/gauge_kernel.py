"""Compiled: an update leaves unknown what no measurement can show: where the world's frame lies, and how it is turned.

Measurements are relative: with vehicle and VTs shifted and turned together they are the same. The covariance holds
in which directions of the state that is, as derivatives at an estimate. When the estimate moves, they do, too. A
covariance that stays behind lets the next measurements seem to show them: the filter becomes too sure, the more so the
finer its distances.

So it is carried over. With dp, dpsi, dv errors of place, yaw and a VT's coordinates v, C the derivative of the VT's
place l by v, and J a right angle about the vertical, the covariance of

    dp - J p dpsi,   dpsi,   dv - C^-1 (dp + J (l - p) dpsi)

is kept, in which these directions are the same at every estimate.

Sources: Huang, Mourikis and Roumeliotis, "Observability-based rules for designing consistent EKF SLAM estimators", Int.
J. Robotics Research 29(5), 2010; Zhang et al., "Convergence and consistency analysis for a 3-D invariant-EKF SLAM",
IEEE Robotics and Automation Letters 2(2), 2017.
"""

from __future__ import annotations

from cellslam.sim.compiling import lean, njit
from cellslam.sim.recording import Floats
from cellslam.slam.joint.state.layout import VT, Filter
from cellslam.slam.model.matrices_kernel import Mat3, Vec3, mat_minus, mat_vec, vec_minus, vec_scaled
from cellslam.slam.model.measurement_kernel import direction, spherical_jacobian


@njit(cache=True, _nrt=False)  # WALL-SLAM's, too
def carry_over(f: Filter, before: Floats, by: Floats) -> None:
    """Carry the covariance over from the state `before` (n,) to the present one.

    by (4, n), written: what a unit of error of x, y, z (m) and yaw (rad) adds to the error of each state.
    """
    x, n = f.x, f.size[0]
    by[:4, :n] = 0.0
    by[3, 0], by[3, 1] = before[1] - x[1], x[0] - before[0]
    for j in range(f.count[0]):
        at = f.vts.state[j]
        old, old_turn = _of_vt(f, j, before, before)
        new, new_turn = _of_vt(f, j, x, before)
        shift, turn = mat_minus(new, old), vec_minus(new_turn, old_turn)
        _put(by, at[VT], shift.xx, shift.xy, shift.xz, turn.x)
        _put(by, at[VT + 1], shift.yx, shift.yy, shift.yz, turn.y)
        _put(by, at[VT + 2], shift.zx, shift.zy, shift.zz, turn.z)
    _add_errors(f, by)


@lean
def _of_vt(f: Filter, j: int, x: Floats, before: Floats) -> tuple[Mat3, Vec3]:
    """Return the derivatives C^-1 and C^-1 J (l - p) of the coordinates that VT j has in state x by a shift of its
    place l, and by a turn about the vehicle's place p before."""
    at = f.vts.state[j]
    to_vt = vec_scaled(direction(x[at[VT + 1]], x[at[VT + 2]]), x[at[VT]])
    by_place = spherical_jacobian(to_vt)
    east, north = f.vts.anchor[j, 0] + to_vt.x - before[0], f.vts.anchor[j, 1] + to_vt.y - before[1]
    return by_place, mat_vec(by_place, Vec3(-north, east, 0.0))


@lean
def _put(by: Floats, index: int, x: float, y: float, z: float, yaw: float) -> None:
    by[0, index], by[1, index], by[2, index], by[3, index] = x, y, z, yaw


@lean
def _add_errors(f: Filter, by: Floats) -> None:
    """P <- (I + B E) P (I + B E)^T, the rows of B^T being `by`, and E taking x, y, z and yaw out of the state.

    B has rows for x, y and the VTs alone, and what it adds to x and y comes of the yaw. So only these rows of P change,
    and the columns that mirror them.
    """
    p, n, vts = f.p, f.size[0], f.count[0]
    for j in range(vts):
        for c in range(VT, VT + 3):
            i = f.vts.state[j, c]
            _add(p[i], by[0, i], by[1, i], by[2, i], by[3, i], p, n)
    for i in range(2):
        _add(p[i], 0.0, 0.0, 0.0, by[3, i], p, n)
    for i in range(2):
        _add(p[i], p[i, 0], p[i, 1], p[i, 2], p[i, 3], by, n)
    for j in range(vts):
        for c in range(VT, VT + 3):
            row = p[f.vts.state[j, c]]
            _add(row, row[0], row[1], row[2], row[3], by, n)
    for j in range(vts):
        for c in range(VT, VT + 3):
            _mirror(p, f.vts.state[j, c], n)
    for i in range(2):
        _mirror(p, i, n)


@lean
def _add(row: Floats, x: float, y: float, z: float, yaw: float, rows: Floats, n: int) -> None:
    """Add to a row so many times each of the first four rows."""
    r0, r1, r2, r3 = rows[0], rows[1], rows[2], rows[3]
    for k in range(n):
        row[k] += x * r0[k] + y * r1[k] + z * r2[k] + yaw * r3[k]


@lean
def _mirror(p: Floats, i: int, n: int) -> None:
    for k in range(n):
        p[k, i] = p[i, k]
