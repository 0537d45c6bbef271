"""Compiled: VTs begin, make room, and end; the map in the world frame.

A VT whose distance or azimuth was not measured begins as several guesses, of which time leaves one. A lone distance
begins VTs around the circle, a lone direction begins VTs at distances that double, all of them with one identity and a
share of the probability each: a Gaussian sum for one VT. While guesses are left, measurements correct them and their
shares, but not the pose or the clock offset, which are considered only: whatever a wrong guess would teach does no
harm. Guesses that agree become one, and the last one is a VT like any other.

Sources: paper, eq. 26 and 27; Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics",
1990: the state augmented and marginalised, covariances through Jacobians; Alspach and Sorenson, "Nonlinear Bayesian
estimation using Gaussian sum approximations", IEEE Trans. Automatic Control 17(4), 1972; Sola et al., "Undelayed
initialization in bearing only SLAM", IROS 2005 (distances that grow geometrically); Schmidt, "Application of
state-space methods to navigation problems", 1966 (considered states).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.compiling import lean, njit, part
from cellslam.sim.frames.frames_kernel import TURN, wrap
from cellslam.sim.recording import Floats
from cellslam.slam.joint.snapshot.sight_kernel import (
    Sight,
    coordinates,
    errors_of,
    geometry,
    range_factor,
    roof_first,
    rotations_of,
)
from cellslam.slam.joint.snapshot.sizes_kernel import count_weight
from cellslam.slam.joint.snapshot.update_kernel import (
    LOG_2PI,
    BlockMeasurement,
    Innovation,
    Pending,
    blank,
    compare,
    correct,
    expected_share,
    gains,
    innovate,
    log_likelihood,
    settle,
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
    LAST,
    LINK,
    MERGED,
    OF_VT,
    POSE,
    POSITION,
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
    cholesky,
    congruence,
    mat_mat,
    mat_vec,
    put_sym,
    solved,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction, spherical, spherical_jacobian

NEAREST_M = 1.0  # a VT does not begin nearer
UNKNOWN = 0.9999  # variance, of 1, from which an error is as good as unknown
AROUND, AHEAD = 20, 7  # guesses of an azimuth, of a distance
FIRST_M, FARTHER = 15.0, 2.0  # first distance, ratio of one to the next
WIDTH = 0.5  # deviation of a guess, in distances of neighbours
LEAST = 1e-5  # share below which a guess is given up
AGREE = 0.5  # guesses this close, in their deviations, are one


@lean
def give_birth(
    f: Filter, a: ArrayErrors, j: int, offset: int, z: Floats, q: Floats, ranged: bool, diffuse: float, now: int,
    s: Sight, w: Pending,
) -> bool:  # fmt: skip
    """Begin VT j where a measurement points to once the errors are taken off it that are believed in; return whether
    there was room.

    z, q (3,): the measurement in m and rad, and its variances; ranged: the distance was measured, with the clock offset
    in it; diffuse: share of the diffuse errors in it. With D the Jacobian by the VT and H that by all other states, the
    VT is D^-1 (z - H x): its covariance D^-1 (H P H^T + R) D^-T, that with the others -D^-1 H P.
    """
    first = f.size[0]
    if first + 3 > len(f.x):
        return False
    for c in range(3):
        enter(f, owner_of(j, VT + c, f.vts.state.shape[1]), 0.0)
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
        s.by[0, POSE] = 0.0  # a guess has nothing to do with the clock, nor with the scale of range
        if f.core.range_scale >= 0:
            s.by[0, POSE + 1] = 0.0
    vt = coordinates(f, j)
    world = vec_scaled(direction(vt.azimuth, vt.elevation), vt.distance)
    by = cartesian_jacobian(seen.distance / factor, seen.azimuth, seen.elevation)
    by = Mat3(by.xx / factor, by.xy, by.xz, by.yx / factor, by.yy, by.yz, by.zx / factor, by.zy, by.zz)
    inverse = mat_mat(mat_mat(spherical_jacobian(world), turned.r), by)
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
def add(
    f: Filter, a: ArrayErrors, b: Block, seen: Measured, link: int, ident: int, k: int, z: Floats, q: Floats,
    ranged: bool, s: Sight, w: Pending,
) -> bool:  # fmt: skip
    """Begin a VT with measurement k of a snapshot, as z with variances q (3,); return whether there was room.

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
    f.vts.state[new] = -1
    if not give_birth(f, a, new, offset, z, q, ranged, seen.noise.diffuse[k], seen.now, s, w):
        return False
    anchor, slots = f.vts.anchor[new], f.vts.slots[new]
    anchor[EXISTS], anchor[SHARE] = 1.0, 1.0
    anchor[MERGED], anchor[WORTH] = expected_share(seen.rules.merge_rate), 0.0
    slots[LINK], slots[HITS], slots[LAST], slots[IDENT] = link, 1, seen.now, ident
    slots[UNSEEN], slots[BEYOND], slots[SURVEYED] = 0, 0, 0
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
    """Return the VT to give up for a new one, -1: none. What was surveyed stays."""
    worst, rank = -1, math.inf
    for j in range(f.count[0]):
        if f.vts.slots[j, LAST] < now and b.sums.detections[j] == 0 and f.vts.slots[j, SURVEYED] == 0:
            value = f.vts.slots[j, LAST] + (1e9 if f.vts.slots[j, HITS] >= confirm else 0.0)
            if value < rank:
                worst, rank = j, value
    return worst


@part
def remove(f: Filter, b: Block, j: int) -> None:
    """Drop VT j and what is its own; the last VT takes its number."""
    for c in range(f.vts.state.shape[1]):
        if f.vts.state[j, c] >= 0:
            leave(f, f.vts.state[j, c])
    last = f.count[0] - 1
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
    """Write identity, link, position (3,) in m and covariance (9,) in m^2 of VT j into out (14,)."""
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
    put_sym(out[SPREAD:].reshape(3, 3), spread)


@njit(cache=True)
def map_of(mixture: Filter, k: int, hits: int) -> Floats:
    """Return the VTs of filter k of a mixture with at least `hits` detections, as their likely guesses, (v, 14).

    Columns as `keep` writes them, in m and m^2.
    """
    f, found = one_of(mixture, k), 0
    out = np.empty((f.count[0], ENTRY))
    for j in range(f.count[0]):
        if f.vts.slots[j, HITS] >= hits and f.vts.anchor[j, SHARE] > 0.5:
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
def births(z: Floats, q: Floats, begins: NDArray[np.bool_], flat: float) -> Births:
    """Return measurements as VTs begin with them: those that may (m,), on the horizon where there is no elevation.

    z (m, 3): in m and rad, NaN where not measured; q (m, 3): variances; flat: that of an elevation not measured, rad^2.
    """
    z, q, guesses = z.copy(), q.copy(), 0
    for k in range(len(z)):
        if math.isnan(z[k, 2]):
            z[k, 2], q[k, 2] = 0.0, flat
        if not begins[k]:
            z[k] = math.nan
        elif math.isnan(z[k, 0]) != math.isnan(z[k, 1]):
            guesses += AROUND if math.isnan(z[k, 1]) else AHEAD
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
        if add(f, a, b, seen, link, ident, k, guess, wide, ranged, s, w):
            f.vts.anchor[f.count[0] - 1, SHARE] = 1.0 / guesses


@lean
def _room_for(f: Filter, guesses: int) -> bool:
    """Return whether so many VTs can be added without that others make room."""
    return bool(f.count[0] + guesses <= len(f.vts.slots) and f.size[0] + 3 * guesses <= len(f.x))


@lean
def is_guess(f: Filter, i: int, link: int, ident: int) -> bool:
    """Return whether VT i is a guess of this VT."""
    return bool(f.vts.slots[i, IDENT] == ident and f.vts.slots[i, LINK] == link)


@lean
def correct_guesses(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, rules: Rules, s: Sight, w: Pending
) -> float:
    """Update the guesses of the VT that j is one of by a measurement; return its log-density.

    Guesses given up have the share 0.
    """
    if len(f.particles.weight) == 0:  # the rows of a filter with particles are needed until these are updated, too
        settle(f, w)
    slots, share = f.vts.slots, f.vts.anchor[:, SHARE]
    link, ident, last, hits = slots[j, LINK], slots[j, IDENT], slots[j, LAST], slots[j, HITS]
    best = -math.inf
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            slots[i, LAST], slots[i, HITS] = last, hits
            if share[i] > 0.0:
                e, hph = compare(f, a, i, offset, measurement, s, w)
                new = innovate(e, measurement.q, hph)
                distance2, log_det = log_likelihood(new)
                share[i] = math.log(share[i]) + max(-0.5 * (distance2 + log_det + new.measured * LOG_2PI), -1e6)
                best = max(best, share[i])
            else:
                share[i] = -math.inf
    total = 0.0
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] = math.exp(share[i] - best)
            total += share[i]
    left, only = _unite(f, link, ident, total)
    if left == 1:
        share[only] = 1.0
        correct(f, a, only, offset, measurement, rules, s, w)
    else:
        for i in range(f.count[0]):
            if is_guess(f, i, link, ident) and share[i] > 0.0:
                e, hph = compare(f, a, i, offset, measurement, s, w)
                consider(f, i, innovate(e, measurement.q, hph), e, w)
    return best + math.log(total)


@lean
def _unite(f: Filter, link: int, ident: int, total: float) -> tuple[int, int]:
    """Make the shares of a VT's guesses sum to one, give up the improbable ones and doubles; return how many are left,
    and the last of them."""
    share = f.vts.anchor[:, SHARE]
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] = share[i] / total if share[i] > LEAST * total else 0.0
    for a in range(f.count[0]):
        if not is_guess(f, a, link, ident) or share[a] == 0.0:
            continue
        for b in range(f.count[0]):
            if b == a or not is_guess(f, b, link, ident) or share[b] == 0.0:
                continue
            if share[b] > share[a] or not _agree(f, a, b):
                continue
            share[a] += share[b]
            share[b] = 0.0
    left, last, total = 0, -1, 0.0
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident) and share[i] > 0.0:
            left, last = left + 1, i
            total += share[i]
    for i in range(f.count[0]):
        if is_guess(f, i, link, ident):
            share[i] /= total
    return left, last


@lean
def _agree(f: Filter, i: int, j: int) -> bool:
    """Return whether two guesses of one VT are the same by now."""
    for c in range(3):
        a, b = f.vts.state[i, VT + c], f.vts.state[j, VT + c]
        gap = wrap(f.x[a] - f.x[b]) if c == 1 else f.x[a] - f.x[b]
        if gap * gap > AGREE * AGREE * (f.p[a, a] + f.p[b, b]):
            return False
    return True


@part
def consider(f: Filter, j: int, new: Innovation, e: Vec3, w: Pending) -> None:
    """Update VT j alone by an innovation, T being in w.t, and e with NaN where not measured; all else is considered:
    covariances with it change, its own do not."""
    p, t, at, n = f.p, w.t, f.vts.state[j], f.size[0]
    root = cholesky(new.s)
    if root.xx == 0.0:
        return
    blank(w, e)
    whitened = solved(root, new.e)
    for i in range(n):
        u = solved(root, Vec3(t[0, i], t[1, i], t[2, i]))
        t[0, i], t[1, i], t[2, i] = u.x, u.y, u.z
    own = np.empty((3, n))
    for c in range(3):
        i = at[VT + c]
        w.added[i] += t[0, i] * whitened.x + t[1, i] * whitened.y + t[2, i] * whitened.z
        for k in range(n):
            own[c, k] = p[i, k] - (t[0, i] * t[0, k] + t[1, i] * t[1, k] + t[2, i] * t[2, k])
    for c in range(3):
        i = at[VT + c]
        put(p[i], own[c])
        put(p[:, i], own[c])
