"""Compiled: what a filter expects to measure of a VT, errors that persist included, and the Jacobian by its states.

    z = diag(1 + k, 1, 1) (h(pose, VT) + e_1 excess) + e_1 offset + calibration(direction) + roof(direction) + diffuse
        + turns + ground + white,    k: scale of range

A VT is where a path seems to come from. If it is a mirror image, the path is as long as it is far: the excess is 0. If
it is a scatterer, it came to it from its illuminator, another VT of the link: excess = |scatterer - illuminator|. The
illuminator is the transmitter; an image of it illuminates what is seen over two bounces.

The direction is the predicted one, in the body frame. Fields of direction are linear in their weights: a row of bells.
Their slope is left out of the Jacobian: with it the filter takes an error of the pose for one of the array.

Sources: paper, eq. 22 to 27, with the elevation corrected; coordinates about an anchor as in Civera, Davison and
Montiel, "Inverse depth parametrization for monocular SLAM", IEEE Trans. Robotics 24(5), 2008, but with the range
itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import lean, part
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.state.layout import DIFFUSE, ILLUMINATOR, POSE, SCATTERER, TOUCHED, VT, ArrayErrors, Filter
from cellslam.slam.joint.state.states_kernel import enter, owner_of
from cellslam.slam.model.field_kernel import MOST_BELLS, Grid, bells
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Vec3,
    columns,
    dot,
    mat_mat,
    mat_vec,
    scaled,
    transposed,
    transposed_vec,
    vec_minus,
    vec_plus,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import (
    Rotations,
    Spherical,
    cartesian_jacobian,
    direction,
    rotations,
    spherical,
    spherical_jacobian,
)

FLATTEST = 0.05  # cosine of an elevation, at least, where azimuths turn with pitch and roll
LEAST_EXCESS_M = 1e-3  # a scatterer is not at its illuminator
PERMITTIVITY = 5.0  # of the ground, about that of concrete


class Jacobian(NamedTuple):
    """The Jacobian of a measurement: `by` (3, W), of which `size` (1,) columns are in use, and `at` (W,), the states
    they are by; `cells`, `values` (MOST_BELLS,): scratch."""

    at: Ints
    by: Floats
    size: Ints
    cells: Ints
    values: Floats


@part
def new_jacobian() -> Jacobian:
    """Return memory for a Jacobian."""
    return Jacobian(
        at=np.empty(TOUCHED, np.int64), by=np.empty((3, TOUCHED)), size=np.empty(1, np.int64),
        cells=np.empty(MOST_BELLS, np.int64), values=np.empty(MOST_BELLS),
    )  # fmt: skip


@lean
def rotations_of(f: Filter) -> Rotations:
    """Return the rotation of a filter's pose, and its derivatives."""
    return rotations(f.x[3], f.x[4], f.x[5])


@lean
def put(s: Jacobian, index: int, row0: float, row1: float, row2: float) -> None:
    """Add a column: the derivative of distance, azimuth and elevation by a state."""
    n = s.size[0]
    s.at[n] = index
    s.by[0, n], s.by[1, n], s.by[2, n] = row0, row1, row2
    s.size[0] = n + 1


@lean
def put_one(f: Filter, s: Jacobian, index: int, c: int, load: float) -> Vec3:
    """Add the column of a state that changes component c alone; return what the state does to the measurement."""
    by = Vec3(load if c == 0 else 0.0, load if c == 1 else 0.0, load if c == 2 else 0.0)
    put(s, index, by.x, by.y, by.z)
    return vec_scaled(by, f.x[index])


@lean
def put_three(s: Jacobian, index: int, m: Mat3) -> None:
    """Add the columns by three states that follow one another."""
    put(s, index, m.xx, m.yx, m.zx)
    put(s, index + 1, m.xy, m.yy, m.zy)
    put(s, index + 2, m.xz, m.yz, m.zz)


@lean
def put_vt(s: Jacobian, at: Ints, m: Mat3) -> None:
    """Add the columns by the coordinates of a VT whose states are `at` (6,)."""
    put(s, at[VT], m.xx, m.yx, m.zx)
    put(s, at[VT + 1], m.xy, m.yy, m.zy)
    put(s, at[VT + 2], m.xz, m.yz, m.zz)


@lean
def coordinates(f: Filter, j: int) -> Spherical:
    """Return range (m), azimuth and elevation (rad) of VT j about its anchor."""
    at = f.vts.state[j]
    return Spherical(f.x[at[VT]], f.x[at[VT + 1]], f.x[at[VT + 2]])


@lean
def range_factor(f: Filter) -> float:
    """Return how many times as long as it is a distance is measured, clock offsets left out: 1 + k."""
    return 1.0 + f.x[f.core.range_scale] if f.core.range_scale >= 0 else 1.0


@lean
def position_of(f: Filter, j: int) -> Vec3:
    """Return where VT j stands, in m."""
    vt = coordinates(f, j)
    to_vt = vec_scaled(direction(vt.azimuth, vt.elevation), vt.distance)
    return vec_plus(Vec3(f.vts.anchor[j, 0], f.vts.anchor[j, 1], f.vts.anchor[j, 2]), to_vt)


@lean
def put_illuminator(f: Filter, illuminator: int, position: Vec3, around: Mat3, factor: float, s: Jacobian) -> float:
    """Add to the Jacobian s, whose last columns are by a scatterer's coordinates, what these and its illuminator's do
    to the range; return the excess (m).

    position: of the scatterer (m), `around`: its derivative by the scatterer's coordinates; factor: 1 + k.
    """
    path, at, first = vec_minus(position, position_of(f, illuminator)), f.vts.state[illuminator], s.size[0] - 3
    excess = math.sqrt(max(dot(path, path), LEAST_EXCESS_M**2))
    by_place = vec_scaled(path, factor / excess)
    own = transposed_vec(around, by_place)
    s.by[0, first] += own.x
    s.by[0, first + 1] += own.y
    s.by[0, first + 2] += own.z
    vt = coordinates(f, illuminator)
    by = transposed_vec(cartesian_jacobian(vt.distance, vt.azimuth, vt.elevation), by_place)
    put_vt(s, at, Mat3(-by.x, -by.y, -by.z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    return excess


@lean
def geometry(
    f: Filter, j: int, offset: int, position: Vec3, turned: Rotations, vt: Spherical, s: Jacobian
) -> Spherical:
    """Begin the Jacobian s of a measurement of VT j with pose, clock offset, scale of range, VT and illuminator;
    return h,
    scaled, without the offset, in m and rad.

    Seen from a position (m) with the rotation `turned`, the VT having these coordinates about its anchor. A position
    besides the present one, as that of an earlier measurement, turns with the vehicle.
    """
    anchor, at = Vec3(f.vts.anchor[j, 0], f.vts.anchor[j, 1], f.vts.anchor[j, 2]), f.vts.state[j]
    point = vec_plus(anchor, vec_scaled(direction(vt.azimuth, vt.elevation), vt.distance))
    to_vt = vec_minus(point, position)
    body = transposed_vec(turned.r, to_vt)
    seen, factor, by = spherical(body), range_factor(f), spherical_jacobian(body)
    by_body = Mat3(factor * by.xx, factor * by.xy, factor * by.xz, by.yx, by.yy, by.yz, by.zx, by.zy, by.zz)
    by_place = mat_mat(by_body, transposed(turned.r))
    by_yaw = mat_vec(by_body, transposed_vec(turned.by_psi, to_vt))
    by_turn = mat_vec(by_place, Vec3(f.x[1] - position.y, position.x - f.x[0], 0.0))
    s.size[0] = 0
    put_three(s, 0, scaled(by_place, -1.0))
    put_three(s, 3, columns(
        vec_minus(by_yaw, by_turn), mat_vec(by_body, transposed_vec(turned.by_theta, to_vt)),
        mat_vec(by_body, transposed_vec(turned.by_phi, to_vt)),
    ))  # fmt: skip
    put(s, offset, 1.0, 0.0, 0.0)
    if f.core.range_scale >= 0:
        put(s, f.core.range_scale, seen.distance, 0.0, 0.0)
    around = cartesian_jacobian(vt.distance, vt.azimuth, vt.elevation)
    put_vt(s, at, mat_mat(by_place, around))
    if f.vts.slots[j, SCATTERER] == 0:
        return Spherical(factor * seen.distance, seen.azimuth, seen.elevation)
    excess = put_illuminator(f, f.vts.slots[j, ILLUMINATOR], point, around, factor, s)
    if f.core.range_scale >= 0:
        s.by[0, POSE + 1] += excess
    return Spherical(factor * (seen.distance + excess), seen.azimuth, seen.elevation)


@lean
def field(f: Filter, g: Grid, std: Floats, first: int, seen: Spherical, now: int, s: Jacobian) -> Vec3:
    """Add a field's columns to the Jacobian; return its value in m and rad.

    std (3,): deviations, 0 where the field has no such component; first: number of its first weight; seen: the
    predicted direction; now: snapshot, or -1: weights that are not in the state stay out of it.
    """
    count, value = bells(g, seen.azimuth, seen.elevation, s.cells, s.values), Vec3(0.0, 0.0, 0.0)
    component = 0
    for c in range(3):
        if std[c] <= 0.0:
            continue
        for k in range(count):
            owner = first + component * g.cells + s.cells[k]
            index = f.fields.state[owner]
            if now >= 0:
                f.fields.met[owner] = now
                if index < 0:
                    index = enter(f, owner, 1.0)
            if index >= 0:
                value = vec_plus(value, put_one(f, s, index, c, std[c] * s.values[k]))
        component += 1
    return value


@lean
def believed(f: Filter, g: Grid, std: Floats, first: int, seen: Spherical, s: Jacobian) -> Vec3:
    """Return a field's value in m and rad, as `field` does, and leave the Jacobian as it is."""
    size = s.size[0]
    value = field(f, g, std, first, seen, -1, s)
    s.size[0] = size
    return value


@lean
def turns(f: Filter, seen: Spherical, share: float, s: Jacobian) -> Vec3:
    """Add the turns of the array within a snapshot to the Jacobian; return what they do to a measurement, in m and rad.

    share: what of their deviation is left in the measurement, which may be a mean over a while.
    """
    if f.core.sway[0] < 0:
        return Vec3(0.0, 0.0, 0.0)
    tangent = math.sin(seen.elevation) / max(math.cos(seen.elevation), FLATTEST)
    sa, ca = math.sin(seen.azimuth), math.cos(seen.azimuth)
    yaw, pitch, roll = f.core.sway[0], f.core.sway[1], f.core.sway[2]
    put(s, yaw, 0.0, -share, 0.0)
    put(s, pitch, 0.0, share * tangent * sa, share * ca)
    put(s, roll, 0.0, share * tangent * ca, -share * sa)
    x, y, z = f.x[yaw], f.x[pitch], f.x[roll]
    return Vec3(0.0, share * (tangent * (sa * y + ca * z) - x), share * (ca * y - sa * z))


@lean
def ground(f: Filter, seen: Spherical, s: Jacobian) -> Vec3:
    """Add what the ground reflects to the Jacobian of a measurement; return what it does to it, in m and rad.

    A path that is reflected from the ground besides arrives from as far below the horizon, too little later to be told
    apart. The elevation measured is the mean of both, weighted by their powers: 1, and the square of Fresnel's
    coefficient for vertical polarisation. The state is how many times as much that pulls, 0 for no ground.
    """
    index = f.core.ground
    if index < 0 or seen.elevation <= 0.0:
        return Vec3(0.0, 0.0, 0.0)
    sine = math.sin(seen.elevation)
    root = math.sqrt(PERMITTIVITY - 1.0 + sine * sine)
    power = ((PERMITTIVITY * sine - root) / (PERMITTIVITY * sine + root)) ** 2
    pull = -2.0 * seen.elevation * power / (1.0 + power)
    put(s, index, 0.0, 0.0, pull)
    return Vec3(0.0, 0.0, pull * f.x[index])


@lean
def diffuse(f: Filter, j: int, std: Floats, share: float, enters: bool, s: Jacobian) -> Vec3:
    """Add a VT's diffuse errors to the Jacobian; return them, in m and rad.

    std (3,): deviations; share: what of them is left in the measurement; enters: whether those enter that are not in
    the state.
    """
    value = Vec3(0.0, 0.0, 0.0)
    for c in range(3):
        index = f.vts.state[j, DIFFUSE + c]
        if index < 0 and enters and std[c] > 0.0:
            index = enter(f, owner_of(j, DIFFUSE + c, f.vts.state.shape[1]), 1.0)
        if index >= 0:
            value = vec_plus(value, put_one(f, s, index, c, share * std[c]))
    return value


@lean
def errors_of(
    f: Filter, a: ArrayErrors, j: int, seen: Spherical, diffuse_share: float, turn_share: float, now: int, s: Jacobian
) -> Vec3:
    """Add all errors that persist to the Jacobian of a measurement of VT j; return their sum as it is believed, m and
    rad."""
    value = field(f, a.calibration_grid, a.calibration, 0, seen, now, s)
    value = vec_plus(value, field(f, a.roof_grid, a.roof, roof_first(a), seen, now, s))
    value = vec_plus(value, turns(f, seen, turn_share, s))
    value = vec_plus(value, ground(f, seen, s))
    return vec_plus(value, diffuse(f, j, a.diffuse, diffuse_share, now >= 0, s))


@lean
def roof_first(a: ArrayErrors) -> int:
    """Return the number of the roof's first weight."""
    fields = 0
    for c in range(3):
        fields += 1 if a.calibration[c] > 0.0 else 0
    return fields * a.calibration_grid.cells
