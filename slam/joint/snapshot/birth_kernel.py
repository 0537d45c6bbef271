"""Compiled: VTs begin, make room, and end; the map in the world frame.

A VT whose distance or azimuth was not measured begins as several guesses, of which time leaves one (`trial_kernel`): a
lone distance begins VTs around the circle, a lone direction begins VTs at distances that double. Where paths may be
scattered, a distance with an azimuth begins a mirror image and a scatterer: it is where the ray meets the ellipsoid of
points with this length of path from the light, r being that length, l the light from here, u the direction,

    |d u - l| + d = r,    d = (r^2 - |l|^2) / (2 (r - u l)).

What lights it is the transmitter: the VT that was surveyed, or else the one that is nearest wherever it is seen, as
nothing is nearer than the transmitter itself. Where one that has a say turns out to be nearer, the other one was an
image, and what was held against it begins again.

Sources: paper, eq. 26 and 27; Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics",
1990: the state augmented and marginalised, covariances through Jacobians; Sola et al., "Undelayed initialization in
bearing only SLAM", IROS 2005 (distances that grow geometrically); scatterers: own derivation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.frames.frames_kernel import TURN
from cellslam.sim.recording import Floats
from cellslam.slam.joint.snapshot.sight_kernel import (
    LEAST_EXCESS_M,
    Sight,
    coordinates,
    errors_of,
    geometry,
    place_of,
    range_factor,
    roof_first,
    rotations_of,
)
from cellslam.slam.joint.snapshot.sizes_kernel import count_weight
from cellslam.slam.joint.snapshot.trial_kernel import UNTRIED, is_guess
from cellslam.slam.joint.snapshot.update_kernel import (
    BlockMeasurement,
    Pending,
    covariance,
    expected_share,
    gains,
    times,
)
from cellslam.slam.joint.state.layout import (
    BELIEF,
    BEYOND,
    DIFFUSE,
    ENTRY,
    EXISTS,
    FREE,
    HITS,
    IDENT,
    KIND,
    LAST,
    LIGHT,
    LINK,
    MERGED,
    MOST_SCORE,
    OF_VT,
    POSE,
    POSITION,
    SCORE,
    SHARE,
    SPREAD,
    SURVEYED,
    UNSEEN,
    VT,
    WORTH,
    ArrayErrors,
    Births,
    Block,
    Filter,
    Measured,
    Rules,
    one_of,
)
from cellslam.slam.joint.state.states_kernel import covariance_of, enter, leave, owner_of
from cellslam.slam.model.arrays_kernel import put
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
    Vec3,
    columns,
    congruence,
    dot,
    mat_mat,
    mat_minus,
    mat_vec,
    put_sym,
    transposed_vec,
    vec_minus,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction, spherical, spherical_jacobian

NEAREST_M = 1.0  # a VT does not begin nearer
UNKNOWN = 0.9999  # variance, of 1, from which an error is as good as unknown
AROUND, AHEAD = 20, 7  # guesses of an azimuth, of a distance
FIRST_M, FARTHER = 15.0, 2.0  # first distance, ratio of one to the next
WIDTH = 0.5  # deviation of a guess, in distances of neighbours
LEAST_OPENING = 0.05  # of 1 + cosine between the ways to a scatterer: on the line of sight its place is not told
NEARER = 3.0  # deviations by which a VT is surely nearer than another one


@lean
def give_birth(
    f: Filter, a: ArrayErrors, j: int, offset: int, z: Floats, q: Floats, ranged: bool, diffuse: float, now: int,
    s: Sight, w: Pending,
) -> bool:  # fmt: skip
    """Begin VT j where a measurement points to once the errors are taken off it that are believed in; return whether
    there was room.

    z, q (3,): the measurement in m and rad, and its variances; ranged: the distance was measured, with the clock offset
    in it; diffuse: share of the diffuse errors in it. With D the Jacobian by the VT and H that by all other states, the
    VT is D^-1 (z - H x): its covariance D^-1 (H P H^T + R) D^-T, that with the others -D^-1 H P. For a scatterer D is
    that of a mirror image, and what its excess adds, e_1 g^T (inverse: Sherman and Morrison, 1950).
    """
    first = f.size[0]
    if first + 3 > len(f.x):
        return False
    for c in range(3):
        enter(f, owner_of(j, VT + c, f.vts.state.shape[1]), 0.0)
    turned, here, factor, light = (
        rotations_of(f),
        Vec3(f.x[0], f.x[1], f.x[2]),
        range_factor(f),
        f.vts.slots[j, LIGHT] - 1,
    )
    f.vts.anchor[j, 0], f.vts.anchor[j, 1], f.vts.anchor[j, 2] = here.x, here.y, here.z
    errors = Vec3(0.0, 0.0, 0.0)
    for _ in range(2):  # where it points to, and once more from there, with the errors of that direction
        away = (z[0] - errors.x - (f.x[offset] if ranged else 0.0)) / factor
        to = spherical(mat_vec(turned.r, direction(z[1] - errors.y, z[2] - errors.z)))
        at = f.vts.state[j]
        if light >= 0:
            away = on_ellipsoid(vec_minus(place_of(f, light), here), direction(to.azimuth, to.elevation), away)
        f.x[at[VT]], f.x[at[VT + 1]], f.x[at[VT + 2]] = max(away, NEAREST_M), to.azimuth, to.elevation
        seen = geometry(f, j, offset, here, turned, coordinates(f, j), s)
        errors = errors_of(f, a, j, seen, diffuse, 1.0, now, s)
    if not ranged:
        s.by[0, POSE] = 0.0  # a guess has nothing to do with the clock, nor with the scale of range
        if f.core.range_scale >= 0:
            s.by[0, POSE + 1] = 0.0
    vt = coordinates(f, j)
    world = vec_scaled(direction(vt.azimuth, vt.elevation), vt.distance)
    far = seen.distance / factor if light < 0 else vt.distance
    by = cartesian_jacobian(far, seen.azimuth, seen.elevation)
    by = Mat3(by.xx / factor, by.xy, by.xz, by.yx / factor, by.yy, by.yz, by.zx / factor, by.zy, by.zz)
    inverse = mat_mat(mat_mat(spherical_jacobian(world), turned.r), by)
    if light >= 0:
        way = vec_minus(place_of(f, j), place_of(f, light))
        inverse = with_excess(
            inverse,
            transposed_vec(
                cartesian_jacobian(vt.distance, vt.azimuth, vt.elevation),
                vec_scaled(way, factor / math.sqrt(dot(way, way))),
            ),
        )
    hph = gains(f, s, w)  # the VT's own states have no variance yet
    spread = congruence(inverse, Sym3(hph.xx + q[0], hph.xy, hph.xz, hph.yy + q[1], hph.yz, hph.zz + q[2]))
    p, d, x, y, z_ = f.p, f.particles.deviation, first, first + 1, first + 2  # the states that have entered above
    for i in range(f.size[0]):
        to_vt = mat_vec(inverse, Vec3(w.t[0, i], w.t[1, i], w.t[2, i]))
        p[x, i] = p[i, x] = -to_vt.x
        p[y, i] = p[i, y] = -to_vt.y
        p[z_, i] = p[i, z_] = -to_vt.z
    for i in range(len(f.particles.weight)):
        to_vt = mat_vec(inverse, times(s, d[:, i]))
        d[x, i], d[y, i], d[z_, i] = -to_vt.x, -to_vt.y, -to_vt.z
    put_sym(p[first : first + 3, first : first + 3], spread)
    return True


@lean
def on_ellipsoid(to_light: Vec3, along: Vec3, length: float) -> float:
    """Return how far away (m) in a direction (unit vector) a scatterer is, over which the path from the light, which is
    seen at `to_light` (m), is so long (m)."""
    return float(
        (length * length - dot(to_light, to_light)) / (2.0 * max(length - dot(along, to_light), LEAST_EXCESS_M))
    )


@lean
def with_excess(inverse: Mat3, g: Vec3) -> Mat3:
    """Return (D + e_1 g^T)^-1, given the inverse of D: by Sherman and Morrison."""
    row, divisor = transposed_vec(inverse, g), 1.0 + inverse.xx * g.x + inverse.yx * g.y + inverse.zx * g.z
    first = vec_scaled(Vec3(inverse.xx, inverse.yx, inverse.zx), 1.0 / divisor)
    return mat_minus(inverse, columns(vec_scaled(first, row.x), vec_scaled(first, row.y), vec_scaled(first, row.z)))


@lean
def light_for(f: Filter, link: int, offset: int, z: Floats) -> int:
    """Return the VT that lights what scatters a path with a measurement z (3,), -1: none that could."""
    light, here = f.lights[link] - 1, Vec3(f.x[0], f.x[1], f.x[2])
    if light < 0:
        return -1
    way, length = vec_minus(place_of(f, light), here), (z[0] - f.x[offset]) / range_factor(f)
    if length < math.sqrt(dot(way, way)) + LEAST_EXCESS_M:
        return -1
    along = mat_vec(rotations_of(f).r, direction(z[1], z[2]))
    far = on_ellipsoid(way, along, length)
    opening = 1.0 + (far - dot(along, way)) / max(length - far, LEAST_EXCESS_M)
    return light if far > NEAREST_M and opening > LEAST_OPENING else -1


@lean
def relight(f: Filter, j: int, offset: int, measurement: BlockMeasurement, s: Sight) -> None:
    """Take VT j, which has a say and was measured, for the transmitter if it is surely nearer than what was taken for
    it: that one, and all that was held against it, has to begin again, and has no share any more."""
    link = f.vts.slots[j, LINK]
    light = f.lights[link] - 1
    if light == j or f.vts.slots[j, LIGHT] > 0 or f.vts.anchor[j, SCORE] <= 0.0:
        return
    if light >= 0:
        if f.vts.slots[light, SURVEYED] == 1:
            return
        h = geometry(f, light, offset, measurement.place, measurement.turned, coordinates(f, light), s)
        apart = h.distance + f.x[offset] - measurement.z[0]
        if not apart > NEARER * math.sqrt(covariance(f, s).xx + measurement.q[0]):
            return
    f.lights[link] = j + 1
    for i in range(f.count[0]):
        if i == light or (light >= 0 and abs(f.vts.slots[i, LIGHT]) == light + 1):
            f.vts.anchor[i, SHARE] = 0.0


@lean
def add(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, link: int, ident: int, k: int, z: Floats, q: Floats,
    ranged: bool, scatters: bool, s: Sight, w: Pending,
) -> bool:  # fmt: skip
    """Begin a VT with measurement k of a snapshot, as z with variances q (3,), one that scatters or a mirror image;
    return whether it could.

    Unconfirmed VTs make room before confirmed ones, then the longest unseen; confirmed ones given up are kept.
    """
    if f.count[0] == len(f.vts.slots):
        j = _gives_way(f, b, seen.now, seen.rules.lifetime.confirm)
        if j < 0:
            return False
        if (
            f.vts.slots[j, HITS] >= seen.rules.lifetime.confirm
            and f.vts.anchor[j, SHARE] > 0.5
            and f.lost.used[0] < len(f.lost.rows)
        ):
            keep(f, j, f.lost.rows[f.lost.used[0]])
            f.lost.used[0] += 1
        remove(f, b, int(j))
    new, offset = f.count[0], f.core.first_offset + seen.site_of[link]
    light = light_for(f, link, offset, z) if scatters else -1
    if scatters and light < 0:
        return False
    f.vts.state[new], f.vts.slots[new, LIGHT] = -1, light + 1
    if not give_birth(f, a, new, offset, z, q, ranged, seen.noise.diffuse[k], seen.now, s, w):
        return False
    anchor, slots = f.vts.anchor[new], f.vts.slots[new]
    anchor[EXISTS], anchor[SHARE] = 1.0, 1.0
    anchor[MERGED], anchor[WORTH] = expected_share(seen.rules.merge_rate), 0.0
    slots[LINK], slots[HITS], slots[LAST], slots[IDENT] = link, 1, seen.now, ident
    slots[UNSEEN], slots[BEYOND], slots[SURVEYED] = 0, 0, 0
    anchor[SCORE] = UNTRIED if seen.rules.scatterers else MOST_SCORE
    f.vts.spread[new] = 0.0
    clear(b, new)
    f.count[0] = new + 1
    return True


@lean
def clear(b: Block, j: int) -> None:
    """Forget what the block has of VT j."""
    b.sums.detections[j] = 0
    b.sums.e[j] = 0.0
    b.sums.q[j] = 0.0
    b.sums.measured[j] = 0.0
    b.sums.diffuse[j] = 0.0
    b.sums.odds[j] = 0.0


@lean
def _gives_way(f: Filter, b: Block, now: int, confirm: int) -> int:
    """Return the VT to give up for a new one, -1: none. What was surveyed stays, and what lights others."""
    worst, rank = -1, math.inf
    for j in range(f.count[0]):
        stays = f.vts.slots[j, SURVEYED] == 1
        for i in range(f.count[0]):
            stays = stays or f.vts.slots[i, LIGHT] == j + 1
        if f.vts.slots[j, LAST] < now and b.sums.detections[j] == 0 and not stays:
            value = f.vts.slots[j, LAST] + (1e9 if f.vts.slots[j, HITS] >= confirm else 0.0)
            if value < rank:
                worst, rank = j, value
    return worst


@part
def remove(f: Filter, b: Block, j: int) -> None:
    """Drop VT j and what is its own; the last VT takes its number. What j has lit is lost, too."""
    for c in range(f.vts.state.shape[1]):
        if f.vts.state[j, c] >= 0:
            leave(f, f.vts.state[j, c])
    last = f.count[0] - 1
    for i in range(f.count[0]):
        light = f.vts.slots[i, LIGHT]
        if light == j + 1:
            f.vts.anchor[i, SHARE] = 0.0
        if abs(light) == j + 1:
            f.vts.slots[i, LIGHT] = 0
        elif abs(light) == last + 1:
            f.vts.slots[i, LIGHT] = j + 1 if light > 0 else -1 - j
    for link in range(len(f.lights)):
        if f.lights[link] == j + 1:
            f.lights[link] = 0
        elif f.lights[link] == last + 1:
            f.lights[link] = j + 1
    if j != last:
        put(f.vts.anchor[j], f.vts.anchor[last])
        put(f.vts.slots[j], f.vts.slots[last])
        put(f.vts.spread[j], f.vts.spread[last])
        for c in range(f.vts.state.shape[1]):
            place = f.vts.state[last, c]
            f.vts.state[j, c], f.vts.state[last, c] = place, -1
            if place >= 0:
                f.owner[place] = owner_of(j, c, f.vts.state.shape[1])
        b.sums.detections[j], b.sums.diffuse[j], b.sums.odds[j] = (
            b.sums.detections[last],
            b.sums.diffuse[last],
            b.sums.odds[last],
        )
        put(b.sums.seen[j], b.sums.seen[last])
        put(b.sums.e[j], b.sums.e[last])
        put(b.sums.q[j], b.sums.q[last])
        put(b.sums.measured[j], b.sums.measured[last])
    f.count[0] = last


@part
def keep(f: Filter, j: int, out: Floats) -> None:
    """Write identity, link, position (3,) in m, covariance (9,) in m^2 of VT j, and whether it scatters, into out
    (15,)."""
    vt, at = coordinates(f, j), f.vts.state[j]
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
    out[0], out[1] = f.vts.slots[j, IDENT], f.vts.slots[j, LINK]
    out[POSITION], out[POSITION + 1] = f.vts.anchor[j, 0] + to_vt.x, f.vts.anchor[j, 1] + to_vt.y
    out[POSITION + 2] = f.vts.anchor[j, 2] + to_vt.z
    put_sym(out[SPREAD:KIND].reshape(3, 3), spread)
    out[KIND] = 1.0 if f.vts.slots[j, LIGHT] > 0 else 0.0


@njit(cache=True)
def map_of(mixture: Filter, k: int, hits: int) -> Floats:
    """Return the VTs of filter k of a mixture with at least `hits` detections, as their likely guesses, (v, 15), and
    none without a say.

    Columns as `keep` writes them, in m and m^2.
    """
    f, found = one_of(mixture, k), 0
    out = np.empty((f.count[0], ENTRY))
    for j in range(f.count[0]):
        if f.vts.slots[j, HITS] >= hits and f.vts.anchor[j, SHARE] > 0.5 and f.vts.anchor[j, SCORE] > 0.0:
            keep(f, j, out[found])
            found += 1
    return out[:found]


@lean
def _hand_on(f: Filter, j: int) -> None:
    """Let a guess that is left, if any, have what a guess at the same VT was worth."""
    for i in range(f.count[0]):
        same = f.vts.slots[i, IDENT] == f.vts.slots[j, IDENT] and f.vts.slots[i, LINK] == f.vts.slots[j, LINK]
        if i != j and same and f.vts.anchor[i, SHARE] > 0.0:
            f.vts.anchor[i, WORTH] += f.vts.anchor[j, WORTH]
            return


@lean
def tidy(f: Filter, a: ArrayErrors, b: Block, now: int, rules: Rules) -> None:
    """Drop VTs that were seen once or twice and not again, guesses given up, weights of the roof that were not met for
    long, and diffuse errors that are as good as unknown again."""
    j = np.int64(0)
    mode, lifetime = rules.association.mode, rules.lifetime
    while j < f.count[0]:
        age, hits = now - f.vts.slots[j, LAST], f.vts.slots[j, HITS]
        gone = hits < lifetime.confirm and age > (lifetime.age_once if hits < 2 else lifetime.age_twice)
        if mode == BELIEF:
            gone = f.vts.anchor[j, EXISTS] < rules.existence.drop and hits < lifetime.confirm
        if f.vts.anchor[j, SHARE] == 0.0 or (mode in (FREE, BELIEF) and gone):
            _hand_on(f, int(j))
            remove(f, b, int(j))
        else:
            j += 1
    place = np.int64(f.core.size)
    while place < f.size[0]:
        owner = f.owner[place]
        if owner >= 0:
            gone = owner >= roof_first(a) and now - f.fields.met[owner] > lifetime.hold
        else:
            gone = (OF_VT - owner) % f.vts.state.shape[1] >= DIFFUSE and f.p[place, place] > UNKNOWN
        if gone:
            if owner >= 0:
                count_weight(f, a, int(place))
            leave(f, int(place))
        else:
            place += 1


@lean
def possible(z: Floats, b: float) -> bool:
    """Return whether a VT can begin with a measurement z (3,): its distance, its azimuth or both are known.

    A distance must be 1 m beyond the clock offset b (m).
    """
    return z[0] - b > 1.0 or (math.isnan(z[0]) and not math.isnan(z[1]))


@njit(cache=True)
def births(z: Floats, q: Floats, begins: NDArray[np.bool_], flat: float, scatterers: bool) -> Births:
    """Return measurements as VTs begin with them: those that may (m,), on the horizon where there is no elevation.

    z (m, 3): in m and rad, NaN where not measured; q (m, 3): variances; flat: that of an elevation not measured, rad^2;
    scatterers: whether paths may be scattered.
    """
    z, q, guesses = z.copy(), q.copy(), 0
    for k in range(len(z)):
        if math.isnan(z[k, 2]):
            z[k, 2], q[k, 2] = 0.0, flat
        if not begins[k]:
            z[k] = math.nan
        elif math.isnan(z[k, 0]) != math.isnan(z[k, 1]):
            guesses += AROUND if math.isnan(z[k, 1]) else AHEAD
        elif scatterers:
            guesses += 1
    return Births(z=z, q=q, guesses=guesses)


@part
def begin(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, link: int, ident: int, k: int, s: Sight, w: Pending
) -> None:
    """Give birth to a VT, or to its guesses, with measurement k of a snapshot."""
    z, q = seen.births.z[k], seen.births.q[k]
    ranged = not math.isnan(z[0])
    whole = ranged and not math.isnan(z[1])
    guesses = 1 if whole else (AROUND if ranged else AHEAD)
    guess, wide = z.copy(), q.copy()
    if guesses > 1 and not _room_for(f, guesses):
        return
    for n in range(guesses):
        if not ranged:
            guess[0] = FIRST_M * FARTHER**n
            wide[0] = (WIDTH * math.log(FARTHER) * guess[0]) ** 2
        elif not whole:
            guess[1] = TURN * n / AROUND
            wide[1] = (WIDTH * TURN / AROUND) ** 2
        if add(f, a, b, seen, link, ident, k, guess, wide, ranged, False, s, w):
            f.vts.anchor[f.count[0] - 1, SHARE] = 1.0 / guesses
    if (
        whole
        and seen.rules.scatterers
        and light_for(f, link, f.core.first_offset + seen.site_of[link], z) >= 0
        and add(f, a, b, seen, link, ident, k, guess, wide, True, True, s, w)
    ):
        for j in range(f.count[0]):
            if is_guess(f, j, link, ident):
                f.vts.anchor[j, SHARE] = 0.5
                if f.vts.slots[j, LIGHT] == 0:
                    f.vts.slots[j, LIGHT] = -f.lights[link]
    elif whole and seen.rules.scatterers and f.lights[link] == 0:
        f.lights[link] = f.count[0]


@lean
def _room_for(f: Filter, guesses: int) -> bool:
    """Return whether so many VTs can be added without that others make room."""
    return bool(f.count[0] + guesses <= len(f.vts.slots) and f.size[0] + 3 * guesses <= len(f.x))
