"""Compiled: VTs begin, make room, and end; the map in the world frame.

Sources: paper, eq. 26 and 27; Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics",
1990: the state augmented and marginalised, covariances through Jacobians.
"""

from __future__ import annotations

import math

import numpy as np

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.recording import Floats
from cellslam.slam.joint.snapshot.merging_kernel import expected_share
from cellslam.slam.joint.snapshot.sight_kernel import Sight, coordinates, errors_of, geometry, roof_first, rotations_of
from cellslam.slam.joint.snapshot.sizes_kernel import count_weight
from cellslam.slam.joint.snapshot.update_kernel import Pending, gains, times
from cellslam.slam.joint.state.layout import (
    BELIEF,
    BEYOND,
    DIFFUSE,
    ENTRY,
    EXISTS,
    FREE,
    HITS,
    IDENT,
    LAST,
    LINK,
    MERGED,
    OF_VT,
    POSITION,
    SHARE,
    SPREAD,
    UNSEEN,
    VT,
    WORTH,
    ArrayErrors,
    Block,
    Filter,
    Measured,
    Rules,
    one_of,
)
from cellslam.slam.joint.state.states_kernel import covariance_of, enter, leave, owner_of
from cellslam.slam.model.copy_kernel import put
from cellslam.slam.model.matrices_kernel import Sym3, Vec3, congruence, mat_mat, mat_vec, put_sym, vec_scaled
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction, spherical, spherical_jacobian

NEAREST_M = 1.0  # a VT does not begin nearer
UNKNOWN = 0.9999  # variance, of 1, from which an error is as good as unknown


@lean
def give_birth(
    f: Filter, a: ArrayErrors, j: int, offset: int, z: Floats, q: Floats, ranged: bool, diffuse: float, now: int,
    s: Sight, w: Pending,
) -> bool:  # fmt: skip
    """Begin VT j where a measurement points to once the errors are taken off it that are believed in; return whether
    there was room.

    z, q (3,): the measurement in m and rad, and its variances; ranged: the distance was measured, with the clock offset
    in it; diffuse: share of the diffuse errors in it. With D the Jacobian by the VT and H that by all other states, the
    VT is D^-1 (z - H x): its covariance D^-1 (H P H^T + Q) D^-T, that with the others -D^-1 H P.
    """
    first = f.size[0]
    if first + 3 > len(f.x):
        return False
    for c in range(3):
        enter(f, owner_of(j, VT + c, f.vt_state.shape[1]), 0.0)
    turned, here = rotations_of(f), Vec3(f.x[0], f.x[1], f.x[2])
    f.anchor[j, 0], f.anchor[j, 1], f.anchor[j, 2] = here.x, here.y, here.z
    errors = Vec3(0.0, 0.0, 0.0)
    for _ in range(2):  # where it points to, and once more from there, with the errors of that direction
        away = z[0] - errors.x - (f.x[offset] if ranged else 0.0)
        to = spherical(mat_vec(turned.r, direction(z[1] - errors.y, z[2] - errors.z)))
        at = f.vt_state[j]
        f.x[at[VT]], f.x[at[VT + 1]], f.x[at[VT + 2]] = max(away, NEAREST_M), to.azimuth, to.elevation
        seen = geometry(f, j, offset, here, turned, coordinates(f, j), s)
        errors = errors_of(f, a, j, seen, diffuse, 1.0, now, s)
    if not ranged:
        s.by[0, 6] = 0.0  # a guess has nothing to do with the clock
    vt = coordinates(f, j)
    world = vec_scaled(direction(vt.azimuth, vt.elevation), vt.distance)
    inverse = mat_mat(
        mat_mat(spherical_jacobian(world), turned.r), cartesian_jacobian(seen.distance, seen.azimuth, seen.elevation)
    )
    hph = gains(f, s, w)  # the VT's own states have no variance yet
    spread = congruence(inverse, Sym3(hph.xx + q[0], hph.xy, hph.xz, hph.yy + q[1], hph.yz, hph.zz + q[2]))
    at = f.vt_state[j]
    for i in range(f.size[0]):
        to_vt = mat_vec(inverse, Vec3(w.t[0, i], w.t[1, i], w.t[2, i]))
        f.p[at[VT], i] = f.p[i, at[VT]] = -to_vt.x
        f.p[at[VT + 1], i] = f.p[i, at[VT + 1]] = -to_vt.y
        f.p[at[VT + 2], i] = f.p[i, at[VT + 2]] = -to_vt.z
    for i in range(len(f.weight)):
        to_vt = mat_vec(inverse, times(s, f.deviation[:, i]))
        f.deviation[at[VT], i], f.deviation[at[VT + 1], i], f.deviation[at[VT + 2], i] = -to_vt.x, -to_vt.y, -to_vt.z
    p, x, y, z_ = f.p, at[VT], at[VT + 1], at[VT + 2]
    p[x, x], p[y, y], p[z_, z_] = spread.xx, spread.yy, spread.zz
    p[x, y] = p[y, x] = spread.xy
    p[x, z_] = p[z_, x] = spread.xz
    p[y, z_] = p[z_, y] = spread.yz
    return True


@lean
def add(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, link: int, ident: int, k: int, z: Floats, q: Floats,
    ranged: bool, s: Sight, w: Pending,
) -> bool:  # fmt: skip
    """Begin a VT with measurement k of a snapshot, as z with variances q (3,); return whether there was room.

    Unconfirmed VTs make room before confirmed ones, then the longest unseen; confirmed ones given up are kept.
    """
    if f.count[0] == len(f.slots):
        j = _gives_way(f, b, seen.now, seen.rules.lifetime.confirm)
        if j < 0:
            return False
        if f.slots[j, HITS] >= seen.rules.lifetime.confirm and f.anchor[j, SHARE] > 0.5 and f.losses[0] < len(f.lost):
            keep(f, j, f.lost[f.losses[0]])
            f.losses[0] += 1
        remove(f, b, int(j))
    new, offset = f.count[0], f.core.first_offset + seen.site_of[link]
    f.vt_state[new] = -1
    if not give_birth(f, a, new, offset, z, q, ranged, seen.noise.diffuse[k], seen.now, s, w):
        return False
    f.anchor[new, EXISTS] = f.anchor[new, SHARE] = 1.0
    f.anchor[new, MERGED], f.anchor[new, WORTH] = expected_share(seen.rules.merge_rate), 0.0
    f.slots[new, LINK], f.slots[new, HITS], f.slots[new, LAST], f.slots[new, IDENT] = link, 1, seen.now, ident
    f.slots[new, UNSEEN], f.slots[new, BEYOND] = 0, 0
    f.spread[new] = 0.0
    clear(b, new)
    f.count[0] = new + 1
    return True


@lean
def clear(b: Block, j: int) -> None:
    """Forget what the block has of VT j."""
    b.detections[j] = 0
    b.e[j] = 0.0
    b.q[j] = 0.0
    b.measured[j] = 0.0
    b.diffuse[j] = 0.0
    b.odds[j] = 0.0


@lean
def _gives_way(f: Filter, b: Block, now: int, confirm: int) -> int:
    """Return the VT to give up for a new one, -1: none. What was surveyed, a VT without variance, stays."""
    worst, rank = -1, math.inf
    for j in range(f.count[0]):
        place = f.vt_state[j, VT]
        if f.slots[j, LAST] < now and b.detections[j] == 0 and f.p[place, place] > 0.0:
            value = f.slots[j, LAST] + (1e9 if f.slots[j, HITS] >= confirm else 0.0)
            if value < rank:
                worst, rank = j, value
    return worst


@part
def remove(f: Filter, b: Block, j: int) -> None:
    """Drop VT j and what is its own; the last VT takes its number."""
    for c in range(f.vt_state.shape[1]):
        if f.vt_state[j, c] >= 0:
            leave(f, f.vt_state[j, c])
    last = f.count[0] - 1
    if j != last:
        put(f.anchor[j], f.anchor[last])
        put(f.slots[j], f.slots[last])
        put(f.spread[j], f.spread[last])
        for c in range(f.vt_state.shape[1]):
            place = f.vt_state[last, c]
            f.vt_state[j, c], f.vt_state[last, c] = place, -1
            if place >= 0:
                f.owner[place] = owner_of(j, c, f.vt_state.shape[1])
        b.detections[j], b.diffuse[j], b.odds[j] = b.detections[last], b.diffuse[last], b.odds[last]
        put(b.seen[j], b.seen[last])
        put(b.e[j], b.e[last])
        put(b.q[j], b.q[last])
        put(b.measured[j], b.measured[last])
    f.count[0] = last


@part
def keep(f: Filter, j: int, out: Floats) -> None:
    """Write identity, link, position (3,) in m and covariance (9,) in m^2 of VT j into out (14,)."""
    vt, at = coordinates(f, j), f.vt_state[j]
    x, y, z = at[VT], at[VT + 1], at[VT + 2]
    to_vt = vec_scaled(direction(vt.azimuth, vt.elevation), vt.distance)
    spread = congruence(
        cartesian_jacobian(vt.distance, vt.azimuth, vt.elevation),
        Sym3(
            covariance_of(f, x, x),
            covariance_of(f, x, y),
            covariance_of(f, x, z),
            covariance_of(f, y, y),
            covariance_of(f, y, z),
            covariance_of(f, z, z),
        ),
    )
    out[0], out[1] = f.slots[j, IDENT], f.slots[j, LINK]
    out[POSITION], out[POSITION + 1] = f.anchor[j, 0] + to_vt.x, f.anchor[j, 1] + to_vt.y
    out[POSITION + 2] = f.anchor[j, 2] + to_vt.z
    put_sym(out[SPREAD:].reshape(3, 3), spread)


@njit(cache=True)
def map_of(mixture: Filter, k: int, hits: int) -> Floats:
    """Return the VTs of filter k of a mixture with at least `hits` detections, as their likely guesses, (v, 14).

    Columns as `keep` writes them, in m and m^2.
    """
    f, found = one_of(mixture, k), 0
    out = np.empty((f.count[0], ENTRY))
    for j in range(f.count[0]):
        if f.slots[j, HITS] >= hits and f.anchor[j, SHARE] > 0.5:
            keep(f, j, out[found])
            found += 1
    return out[:found]


@lean
def _hand_on(f: Filter, j: int) -> None:
    """Let a guess that is left, if any, have what a guess at the same VT was worth."""
    for i in range(f.count[0]):
        same = f.slots[i, IDENT] == f.slots[j, IDENT] and f.slots[i, LINK] == f.slots[j, LINK]
        if i != j and same and f.anchor[i, SHARE] > 0.0:
            f.anchor[i, WORTH] += f.anchor[j, WORTH]
            return


@lean
def tidy(f: Filter, a: ArrayErrors, b: Block, now: int, rules: Rules) -> None:
    """Drop VTs that were seen once or twice and not again, guesses given up, weights of the roof that were not met for
    long, and diffuse errors that are as good as unknown again."""
    j = np.int64(0)
    mode, lifetime = rules.association.mode, rules.lifetime
    while j < f.count[0]:
        age, hits = now - f.slots[j, LAST], f.slots[j, HITS]
        gone = hits < lifetime.confirm and age > (lifetime.age_once if hits < 2 else lifetime.age_twice)
        if mode == BELIEF:
            gone = f.anchor[j, EXISTS] < rules.existence.drop and hits < lifetime.confirm
        if f.anchor[j, SHARE] == 0.0 or (mode in (FREE, BELIEF) and gone):
            _hand_on(f, int(j))
            remove(f, b, int(j))
        else:
            j += 1
    place = np.int64(f.core.size)
    while place < f.size[0]:
        owner = f.owner[place]
        if owner >= 0:
            gone = owner >= roof_first(a) and now - f.weight_met[owner] > lifetime.hold
        else:
            gone = (OF_VT - owner) % f.vt_state.shape[1] >= DIFFUSE and f.p[place, place] > UNKNOWN
        if gone:
            if owner >= 0:
                count_weight(f, a, int(place))
            leave(f, int(place))
        else:
            place += 1
