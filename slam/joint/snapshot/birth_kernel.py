"""Compiled: VTs begin, displace others, and end; the map in the world frame.

A VT whose distance or azimuth was not measured begins as several hypotheses, of which time leaves one
(`tentative_kernel`): a lone distance begins VTs around the circle, a lone direction at distances that double. Where
paths may be scattered, a distance r with an azimuth begins a mirror image and a scatterer. That is where the ray u
meets the ellipsoid of points over which a path from the illuminator l is so long,

    |d u - l| + d = r,    d = (r^2 - |l|^2) / (2 (r - u l)).

The illuminator is the transmitter: the VT that was surveyed, or else the one that is nearest wherever it is seen, as
nothing is nearer than the transmitter itself (`choose_illuminator`).

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
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.observation_kernel import (
    LEAST_EXCESS_M,
    Jacobian,
    coordinates,
    errors_of,
    geometry,
    position_of,
    put_three,
    put_vt,
    range_factor,
    roof_first,
    rotations_of,
)
from cellslam.slam.joint.snapshot.sizes_kernel import count_weight
from cellslam.slam.joint.snapshot.tentative_kernel import FIRST_SCORE, is_hypothesis
from cellslam.slam.joint.snapshot.update_kernel import Pending, covariance, gains, merge_probability, times
from cellslam.slam.joint.state.layout import (
    BELIEF,
    BEYOND,
    DIFFUSE,
    ENTRY,
    EXISTS,
    FREE,
    HITS,
    IDENT,
    ILLUMINATOR,
    KIND,
    LAST,
    LINK,
    LOG_RATIO,
    MERGED,
    MOST_SCORE,
    OF_VT,
    POSE,
    POSITION,
    SCATTERER,
    SCORE,
    SPREAD,
    SURVEYED,
    UNSEEN,
    VT,
    WEIGHT,
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
    scaled,
    transposed_vec,
    vec_minus,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction, spherical, spherical_jacobian

NEAREST_M = 1.0  # a VT does not begin nearer
UNKNOWN = 0.9999  # variance, of 1, from which an error is as good as unknown
AROUND, AHEAD = 20, 7  # hypotheses of an azimuth, of a distance
FIRST_M, FARTHER = 15.0, 2.0  # first distance, ratio of one to the next
WIDTH = 0.5  # deviation of a hypothesis, in distances of neighbours
LEAST_OPENING = 0.05  # of 1 + cosine of the directions to a scatterer: on the line of sight its place is unknown
NOTHING = Vec3(0.0, 0.0, 0.0)
IDENTITY = Mat3(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
NEARER = 3.0  # deviations by which a VT is surely nearer than another one


@lean
def give_birth(
    f: Filter, a: ArrayErrors, j: int, offset: int, z: Floats, q: Floats, ranged: bool, diffuse: float, now: int,
    s: Jacobian, w: Pending,
) -> bool:  # fmt: skip
    """Begin VT j where a measurement points to once the errors are taken off it that are believed in; return whether
    the arrays can hold it.

    z, q (3,): the measurement in m and rad, and its variances; ranged: the distance was measured, with the clock offset
    in it; diffuse: share of the diffuse errors in it. With D the Jacobian by the VT and H that by all other states, the
    VT is D^-1 (z - H x): its covariance D^-1 (H P H^T + R) D^-T, that with the others -D^-1 H P.
    """
    first = f.size[0]
    if first + 3 > len(f.x):
        return False
    enter_vt(f, j)
    turned, here, factor = rotations_of(f), Vec3(f.x[0], f.x[1], f.x[2]), range_factor(f)
    f.vts.anchor[j, 0], f.vts.anchor[j, 1], f.vts.anchor[j, 2] = here.x, here.y, here.z
    errors = Vec3(0.0, 0.0, 0.0)
    for _ in range(2):  # where it points to, and once more from there, with the errors of that direction
        away = (z[0] - errors.x - (f.x[offset] if ranged else 0.0)) / factor
        to = spherical(mat_vec(turned.r, direction(z[1] - errors.y, z[2] - errors.z)))
        at = f.vts.state[j]
        f.x[at[VT]], f.x[at[VT + 1]], f.x[at[VT + 2]] = max(away, NEAREST_M), to.azimuth, to.elevation
        seen = geometry(f, j, offset, here, turned, coordinates(f, j), s)
        errors = errors_of(f, a, j, seen, diffuse, 1.0, now, s)
    if not ranged:
        s.by[0, POSE] = 0.0  # a hypothesis has nothing to do with the clock, nor with the scale of range
        if f.core.range_scale >= 0:
            s.by[0, POSE + 1] = 0.0
    vt = coordinates(f, j)
    world = vec_scaled(direction(vt.azimuth, vt.elevation), vt.distance)
    by = cartesian_jacobian(seen.distance / factor, seen.azimuth, seen.elevation)
    by = Mat3(by.xx / factor, by.xy, by.xz, by.yx / factor, by.yy, by.yz, by.zx / factor, by.zy, by.zz)
    inverse = mat_mat(mat_mat(spherical_jacobian(world), turned.r), by)
    correlate(f, first, scaled(inverse, -1.0), Vec3(q[0], q[1], q[2]), s, w)
    return True


@lean
def enter_vt(f: Filter, j: int) -> None:
    """Let the states of VT j enter, which have neither mean nor variance yet."""
    for c in range(3):
        enter(f, owner_of(j, VT + c, f.vts.state.shape[1]), 0.0)


@lean
def correlate(f: Filter, first: int, by: Mat3, q: Vec3, s: Jacobian, w: Pending) -> None:
    """Let three states that have entered, from the `first` on, err by A (H dx + v): dx are the errors of all others, v
    is N(0, diag(q)).

    With A `by` and H the Jacobian s, their covariance is A (H P H^T + R) A^T, and A H P with the others.
    """
    p, d, hph = f.p, f.particles.deviation, gains(f, s, w)
    spread = congruence(by, Sym3(hph.xx + q.x, hph.xy, hph.xz, hph.yy + q.y, hph.yz, hph.zz + q.z))
    for i in range(f.size[0]):
        with_i = mat_vec(by, Vec3(w.t[0, i], w.t[1, i], w.t[2, i]))
        p[first, i] = p[i, first] = with_i.x
        p[first + 1, i] = p[i, first + 1] = with_i.y
        p[first + 2, i] = p[i, first + 2] = with_i.z
    for i in range(len(f.particles.weight)):
        own = mat_vec(by, times(s, d[:, i]))
        d[first, i], d[first + 1, i], d[first + 2, i] = own.x, own.y, own.z
    put_sym(p[first : first + 3, first : first + 3], spread)


@lean
def add(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, link: int, ident: int, k: int, z: Floats, q: Floats,
    ranged: bool, s: Jacobian, w: Pending,
) -> bool:  # fmt: skip
    """Begin a VT with measurement k of a snapshot, as z with variances q (3,); return whether there is a place
    for it.

    Tentative VTs are displaced before confirmed ones, then the longest unseen; confirmed ones are kept in `lost`.
    """
    if f.count[0] == len(f.vts.slots):
        j = _displaced(f, b, seen.now, seen.rules.lifetime.confirm)
        if j < 0:
            return False
        if (
            f.vts.slots[j, HITS] >= seen.rules.lifetime.confirm
            and f.vts.anchor[j, WEIGHT] > 0.5
            and f.lost.used[0] < len(f.lost.rows)
        ):
            keep(f, j, f.lost.rows[f.lost.used[0]])
            f.lost.used[0] += 1
        remove(f, b, int(j))
    new, offset = f.count[0], f.core.first_offset + seen.site_of[link]
    f.vts.state[new], f.vts.slots[new, SCATTERER] = -1, 0
    if not give_birth(f, a, new, offset, z, q, ranged, seen.noise.diffuse[k], seen.now, s, w):
        return False
    anchor, slots = f.vts.anchor[new], f.vts.slots[new]
    anchor[EXISTS], anchor[WEIGHT] = 1.0, 1.0
    anchor[MERGED], anchor[LOG_RATIO] = merge_probability(seen.rules.merge_rate), 0.0
    slots[LINK], slots[HITS], slots[LAST], slots[IDENT] = link, 1, seen.now, ident
    slots[UNSEEN], slots[BEYOND], slots[SURVEYED], slots[ILLUMINATOR] = 0, 0, 0, -1
    anchor[SCORE] = FIRST_SCORE if seen.rules.scatterers else MOST_SCORE
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
def scatterer_of(f: Filter, b: Block, j: int, s: Jacobian, w: Pending) -> None:
    """Begin a scatterer as a second hypothesis of what VT j is, if the illuminator of its link can illuminate one and
    the arrays can hold it: on the ray from the anchor to VT j, and over it the path is as long as VT j is far.

    With the ray u and e from the illuminator l to the scatterer, unit vectors, and r how far VT j is,

        dd (1 + u e) = dr - d (du e) + e dl,    du by the direction of VT j

    All of these are as the receiver sees them. The receiver stands beside the anchor, by dq = dp + J (anchor - p) dpsi,
    since the vehicle's place p and yaw err. If receiver, VT j and illuminator are all shifted by dq, the scatterer is
    shifted by dq as well. So its coordinates v depend on the receiver by

        dv = (D - dv/dv_j D_j - dv/dl) dq,    v_j: coordinates of VT j; D, D_j: derivatives of v and v_j by a place
    """
    first, new, illuminator = f.size[0], f.count[0], f.illuminators[f.vts.slots[j, LINK]]
    if illuminator < 0 or illuminator == j or new == len(f.vts.slots) or first + 3 > len(f.x):
        return
    vt, anchor = coordinates(f, j), Vec3(f.vts.anchor[j, 0], f.vts.anchor[j, 1], f.vts.anchor[j, 2])
    r, u, its = vt.distance, direction(vt.azimuth, vt.elevation), coordinates(f, illuminator)
    l_ = vec_minus(position_of(f, illuminator), anchor)
    if r < math.sqrt(dot(l_, l_)) + LEAST_EXCESS_M:
        return
    d = (r * r - dot(l_, l_)) / (2.0 * (r - dot(u, l_)))
    e = vec_scaled(vec_minus(vec_scaled(u, d), l_), 1.0 / max(r - d, LEAST_EXCESS_M))
    opening = 1.0 + dot(u, e)
    if d < NEAREST_M or opening < LEAST_OPENING:
        return
    f.vts.state[new], s.size[0] = -1, 0
    enter_vt(f, new)
    f.x[first], f.x[first + 1], f.x[first + 2] = d, vt.azimuth, vt.elevation
    du = vec_scaled(transposed_vec(cartesian_jacobian(d, vt.azimuth, vt.elevation), e), 1.0 / opening)
    by_vt = Mat3(1.0 / opening, -du.y, -du.z, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    by_illuminator = Mat3(e.x / opening, e.y / opening, e.z / opening, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    by_receiver = mat_minus(spherical_jacobian(vec_scaled(u, d)), mat_mat(by_vt, spherical_jacobian(vec_scaled(u, r))))
    by_receiver = mat_minus(by_receiver, by_illuminator)
    by_yaw = mat_vec(by_receiver, Vec3(f.x[1] - anchor.y, anchor.x - f.x[0], 0.0))
    put_three(s, 0, by_receiver)
    put_three(s, 3, columns(by_yaw, NOTHING, NOTHING))
    put_vt(s, f.vts.state[j], by_vt)
    put_vt(
        s,
        f.vts.state[illuminator],
        mat_mat(by_illuminator, cartesian_jacobian(its.distance, its.azimuth, its.elevation)),
    )
    correlate(f, first, IDENTITY, Vec3(0.0, 0.0, 0.0), s, w)
    f.vts.anchor[j, WEIGHT], f.vts.slots[j, ILLUMINATOR] = 0.5, illuminator
    put(f.vts.anchor[new], f.vts.anchor[j])
    put(f.vts.slots[new], f.vts.slots[j])
    put(f.vts.spread[new], f.vts.spread[j])
    f.vts.slots[new, SCATTERER], f.vts.anchor[new, LOG_RATIO] = 1, 0.0
    clear(b, new)
    f.count[0] = new + 1


@lean
def choose_illuminator(f: Filter, b: Block, seen: Measured, link: int, slot_of: Ints, s: Jacobian, w: Pending) -> None:
    """Take a confirmed mirror image for the transmitter of a link if it is measured, as VT slot_of (m,), surely nearer
    than what was taken for it. That one was an image, then, and scatterers stand elsewhere than it illuminated them."""
    old, offset = f.illuminators[link], f.core.first_offset + seen.site_of[link]
    if old >= 0 and f.vts.slots[old, SURVEYED] == 1:
        return
    variance, far, nearer = 0.0, math.inf, -1
    if old >= 0:
        here = Vec3(f.x[0], f.x[1], f.x[2])
        far = geometry(f, old, offset, here, rotations_of(f), coordinates(f, old), s).distance + f.x[offset]
        variance = covariance(f, s).xx
    for k in range(seen.first[link], seen.first[link + 1]):
        j = slot_of[k]
        if j < 0 or j == old or f.vts.slots[j, SCATTERER] == 1 or f.vts.anchor[j, SCORE] <= 0.0:
            continue
        least = NEARER * math.sqrt(variance + seen.noise.single[k, 0])
        if f.vts.anchor[j, WEIGHT] == 1.0 and seen.z[k, 0] < far - least:
            far, nearer, variance = seen.z[k, 0], j, 0.0
    if nearer < 0:
        return
    f.illuminators[link] = nearer
    for j in range(f.count[0]):
        if f.vts.slots[j, LINK] != link or j == nearer or f.vts.slots[j, ILLUMINATOR] == nearer:
            continue
        if f.vts.slots[j, SCATTERER] == 1:
            f.vts.anchor[j, WEIGHT] = 0.0
        elif f.vts.anchor[j, WEIGHT] > 0.0:
            f.vts.anchor[j, WEIGHT], f.vts.slots[j, ILLUMINATOR] = 1.0, -1
            scatterer_of(f, b, j, s, w)


@lean
def _displaced(f: Filter, b: Block, now: int, confirm: int) -> int:
    """Return the VT that a new one displaces, -1: none. What was surveyed stays, and what illuminates others."""
    worst, rank = -1, math.inf
    for j in range(f.count[0]):
        stays = f.vts.slots[j, SURVEYED] == 1
        for i in range(f.count[0]):
            stays = stays or (f.vts.slots[i, SCATTERER] == 1 and f.vts.slots[i, ILLUMINATOR] == j)
        if f.vts.slots[j, LAST] < now and b.sums.detections[j] == 0 and not stays:
            value = f.vts.slots[j, LAST] + (1e9 if f.vts.slots[j, HITS] >= confirm else 0.0)
            if value < rank:
                worst, rank = j, value
    return worst


@part
def remove(f: Filter, b: Block, j: int) -> None:
    """Drop VT j and what is its own; the last VT takes its number. What j illuminates is dropped, too."""
    for c in range(f.vts.state.shape[1]):
        if f.vts.state[j, c] >= 0:
            leave(f, f.vts.state[j, c])
    last = f.count[0] - 1
    for i in range(f.count[0]):
        if f.vts.slots[i, ILLUMINATOR] == j:
            if f.vts.slots[i, SCATTERER] == 1:
                f.vts.anchor[i, WEIGHT] = 0.0
            f.vts.slots[i, SCATTERER], f.vts.slots[i, ILLUMINATOR] = 0, -1
        elif f.vts.slots[i, ILLUMINATOR] == last:
            f.vts.slots[i, ILLUMINATOR] = j
    for link in range(len(f.illuminators)):
        if f.illuminators[link] == j:
            f.illuminators[link] = -1
        elif f.illuminators[link] == last:
            f.illuminators[link] = j
    if j != last:
        put(f.vts.anchor[j], f.vts.anchor[last])
        put(f.vts.slots[j], f.vts.slots[last])
        put(f.vts.spread[j], f.vts.spread[last])
        for c in range(f.vts.state.shape[1]):
            index = f.vts.state[last, c]
            f.vts.state[j, c], f.vts.state[last, c] = index, -1
            if index >= 0:
                f.owner[index] = owner_of(j, c, f.vts.state.shape[1])
        b.sums.detections[j], b.sums.diffuse[j] = b.sums.detections[last], b.sums.diffuse[last]
        b.sums.odds[j] = b.sums.odds[last]
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
    own = Sym3(
        covariance_of(f, x, x), covariance_of(f, x, y), covariance_of(f, x, z),
        covariance_of(f, y, y), covariance_of(f, y, z), covariance_of(f, z, z),
    )  # fmt: skip
    spread = congruence(cartesian_jacobian(vt.distance, vt.azimuth, vt.elevation), own)
    position = position_of(f, j)
    out[0], out[1], out[POSITION] = f.vts.slots[j, IDENT], f.vts.slots[j, LINK], position.x
    out[POSITION + 1], out[POSITION + 2] = position.y, position.z
    put_sym(out[SPREAD:KIND].reshape(3, 3), spread)
    out[KIND] = float(f.vts.slots[j, SCATTERER])


@njit(cache=True)
def map_of(mixture: Filter, k: int, hits: int) -> Floats:
    """Return the confirmed VTs of filter k of a mixture, with at least `hits` detections, as their likely hypotheses,
    (v, 15).

    Columns as `keep` writes them, in m and m^2.
    """
    f, found = one_of(mixture, k), 0
    out = np.empty((f.count[0], ENTRY))
    for j in range(f.count[0]):
        if f.vts.slots[j, HITS] >= hits and f.vts.anchor[j, WEIGHT] > 0.5 and f.vts.anchor[j, SCORE] > 0.0:
            keep(f, j, out[found])
            found += 1
    return out[:found]


@lean
def _bequeath_log_ratio(f: Filter, j: int) -> None:
    """Let a hypothesis of the same VT that is left, if any, have the log-ratio of VT j."""
    for i in range(f.count[0]):
        same = is_hypothesis(f, i, f.vts.slots[j, LINK], f.vts.slots[j, IDENT])
        if i != j and same and f.vts.anchor[i, WEIGHT] > 0.0:
            f.vts.anchor[i, LOG_RATIO] += f.vts.anchor[j, LOG_RATIO]
            return


@lean
def tidy(f: Filter, a: ArrayErrors, b: Block, now: int, rules: Rules) -> None:
    """Drop VTs that were seen once or twice and not again, hypotheses given up, weights of the roof that were not met
    for long, and diffuse errors that are as good as unknown again."""
    j = np.int64(0)
    mode, lifetime = rules.association.mode, rules.lifetime
    while j < f.count[0]:
        age, hits = now - f.vts.slots[j, LAST], f.vts.slots[j, HITS]
        gone = hits < lifetime.confirm and age > (lifetime.age_once if hits < 2 else lifetime.age_twice)
        if mode == BELIEF:
            gone = f.vts.anchor[j, EXISTS] < rules.existence.drop and hits < lifetime.confirm
        if f.vts.anchor[j, WEIGHT] == 0.0 or (mode in (FREE, BELIEF) and gone):
            _bequeath_log_ratio(f, int(j))
            remove(f, b, int(j))
        else:
            j += 1
    index = np.int64(f.core.size)
    while index < f.size[0]:
        owner = f.owner[index]
        if owner >= 0:
            gone = owner >= roof_first(a) and now - f.fields.met[owner] > lifetime.hold
        else:
            gone = (OF_VT - owner) % f.vts.state.shape[1] >= DIFFUSE and f.p[index, index] > UNKNOWN
        if gone:
            if owner >= 0:
                count_weight(f, a, int(index))
            leave(f, int(index))
        else:
            index += 1


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
    z, q, hypotheses = z.copy(), q.copy(), 0
    for k in range(len(z)):
        if math.isnan(z[k, 2]):
            z[k, 2], q[k, 2] = 0.0, flat
        if not begins[k]:
            z[k] = math.nan
        elif math.isnan(z[k, 0]) != math.isnan(z[k, 1]):
            hypotheses += AROUND if math.isnan(z[k, 1]) else AHEAD
        elif scatterers:
            hypotheses += 1
    return Births(z=z, q=q, hypotheses=hypotheses)


@part
def begin(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, link: int, ident: int, k: int, s: Jacobian, w: Pending
) -> None:
    """Give birth to a VT, or to its hypotheses, with measurement k of a snapshot."""
    z, q = seen.births.z[k], seen.births.q[k]
    ranged = not math.isnan(z[0])
    whole = ranged and not math.isnan(z[1])
    hypotheses = 1 if whole else (AROUND if ranged else AHEAD)
    mean, wide = z.copy(), q.copy()
    fits = f.count[0] + hypotheses <= len(f.vts.slots) and f.size[0] + 3 * hypotheses <= len(f.x)
    if hypotheses > 1 and not fits:  # they do not displace others
        return
    for n in range(hypotheses):
        if not ranged:
            mean[0] = FIRST_M * FARTHER**n
            wide[0] = (WIDTH * math.log(FARTHER) * mean[0]) ** 2
        elif not whole:
            mean[1] = TURN * n / AROUND
            wide[1] = (WIDTH * TURN / AROUND) ** 2
        if add(f, a, b, seen, link, ident, k, mean, wide, ranged, s, w):
            f.vts.anchor[f.count[0] - 1, WEIGHT] = 1.0 / hypotheses
    if whole and seen.rules.scatterers and f.count[0] > 0 and is_hypothesis(f, f.count[0] - 1, link, ident):
        if f.illuminators[link] < 0:
            f.illuminators[link] = f.count[0] - 1
        scatterer_of(f, b, f.count[0] - 1, s, w)
