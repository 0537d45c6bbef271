"""Compiled: innovation of one measurement, its likelihood, and the Kalman update of the whole state.

Several measurements are taken in before the state is written, and are linearised about the same one: what they add to
the mean waits, as what they take off the covariance, P - G^T G, in the rows of G.

What the array cannot resolve is measured as one path, somewhere between: azimuths of a VT err by some degrees from one
moment to the next, and for as long as that lasts. A single measurement does not tell, a jump does. So each VT has a
probability that another path has merged with its own, that of a hidden Markov chain with two modes, and its azimuths
count for less by it: `expect_merging`, `allow_for_merging`.

Sources: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation", 2001, section 5.2,
with S = L L^T and gains whitened by L; section 11.6 for modes that switch; that one update with the mean information of
both modes will do is an approximation of our own.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellslam.sim.compiling import lean
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.joint.snapshot.observation_kernel import Jacobian, coordinates, errors_of, geometry, range_factor
from cellslam.slam.joint.snapshot.sizes_kernel import count_diffuse, count_white
from cellslam.slam.joint.state.layout import (
    DIFFUSE,
    HITS,
    ILLUMINATOR,
    LINK,
    MERGED,
    POSE,
    SCATTERER,
    VT,
    WEIGHT,
    ArrayErrors,
    Block,
    Filter,
    Rules,
)
from cellslam.slam.model.arrays_kernel import downdate
from cellslam.slam.model.matrices_kernel import (
    Sym3,
    Vec3,
    cholesky,
    dot,
    solved,
    sym_minus,
    sym_plus,
    sym_scaled,
    transposed_vec,
    vec_minus,
    vec_plus,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import Rotations, Spherical, direction, rotations, spherical

LOG_2PI = math.log(2.0 * math.pi)
LIKELY = 9.0  # squared distance of an innovation: up to here it fits
END_RATE = 0.1  # merged paths part so often, 1/s
SHIFT2 = math.radians(2.5) ** 2  # variance of azimuth by merging
LASTS = 5.0  # for how many means of a block one such shift counts
BESIDE = 0.3  # probability where a VT that is not seen should be seen beside
UNRESOLVED = (9.2, 0.27, 0.28)  # so near, in m and rad: what an LTE front end with 20 MHz does not resolve


class Steps(NamedTuple):
    """What a block says of steps of the S clocks, and of shifts of the vehicle along its path and in heading, at its
    begin: of a unit step or shift, in m or rad, what is `left` (S + 2, n) to be corrected in each state; the slope of
    the log-likelihood by it, `score` (S + 2,), and its `information` (S + 2,). Rows `used` (1,): none where neither
    clocks step nor wheels slip."""

    used: Ints
    left: Floats
    score: Floats
    information: Floats


class Pending(NamedTuple):
    """What updates have taken off the covariance: `rows`, G (k, n), of which `used` (1,), and `added` (n,) to the mean;
    `t` (3, n): H P of a measurement; what the measurements say of `steps`; and, where there are particles, the
    innovations that the rows go with, `whitened` (k, N) of each particle and `whitened_mean` (k,)."""

    rows: Floats
    used: Ints
    added: Floats
    t: Floats
    steps: Steps
    whitened: Floats
    whitened_mean: Floats


class BlockMeasurement(NamedTuple):
    """A measurement, or the mean of several: `z`, `q` (3,): distance, azimuth, elevation in m and rad, NaN where not
    measured, and their variances, `white` (3,) but for what merged paths do; seen from the `pose` (6,), which is
    `position` (m) and the rotation `turned`, by each particle from a pose that differs from this one by `deviation`
    (6, N); `diffuse`, `turn`: what is left in it of the deviation of these errors; `now`: snapshot."""

    z: Floats
    q: Floats
    white: Floats
    pose: Floats
    position: Vec3
    turned: Rotations
    diffuse: float
    turn: float
    now: int
    deviation: Floats


class Innovation(NamedTuple):
    """Innovation `e` = z - h(x), its covariance `s` = H P H^T + R, and how many components were measured: a missing one
    is 0 in e, and in s as if it were independent, of variance 1."""

    e: Vec3
    s: Sym3
    measured: int


@lean
def innovate(e: Vec3, q: Floats, hph: Sym3) -> Innovation:
    """Return the innovation e (m and rad, NaN where not measured) with its covariance.

    q (3,): variances of the measurement; hph: H P H^T.
    """
    far, across, up = not math.isnan(e.x), not math.isnan(e.y), not math.isnan(e.z)
    s = Sym3(
        hph.xx + q[0] if far else 1.0, hph.xy if far and across else 0.0, hph.xz if far and up else 0.0,
        hph.yy + q[1] if across else 1.0, hph.yz if across and up else 0.0, hph.zz + q[2] if up else 1.0,
    )  # fmt: skip
    given = Vec3(e.x if far else 0.0, wrap(e.y) if across else 0.0, e.z if up else 0.0)
    return Innovation(given, s, int(far) + int(across) + int(up))


@lean
def log_likelihood(i: Innovation) -> tuple[float, float]:
    """Return e^T S^-1 e and log det S; infinite where S has no root."""
    root = cholesky(i.s)
    if root.xx == 0.0:
        return math.inf, 0.0
    w = solved(root, i.e)
    return dot(w, w), 2.0 * math.log(root.xx * root.yy * root.zz)


@lean
def covariance(f: Filter, s: Jacobian) -> Sym3:
    """Return H P H^T in m^2, m rad and rad^2, H being the Jacobian s: the triangle below P's diagonal, twice."""
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(s.size[0]):
        row, a, b, c = f.p[s.at[k]], s.by[0, k], s.by[1, k], s.by[2, k]
        half = 0.5 * row[s.at[k]]
        x, y, z = half * a, half * b, half * c
        for i in range(k):
            value = row[s.at[i]]
            x += s.by[0, i] * value
            y += s.by[1, i] * value
            z += s.by[2, i] * value
        xx, xy, xz = xx + 2.0 * a * x, xy + a * y + b * x, xz + a * z + c * x
        yy, yz, zz = yy + 2.0 * b * y, yz + b * z + c * y, zz + 2.0 * c * z
    return Sym3(xx, xy, xz, yy, yz, zz)


@lean
def gains(f: Filter, s: Jacobian, w: Pending) -> Sym3:
    """Write T = H P (3, n) into w.t, less what the pending rows G have taken off: T - (H G^T) G; return T H^T."""
    n, t0, t1, t2 = f.size[0], w.t[0], w.t[1], w.t[2]
    t0[:n] = 0.0
    t1[:n] = 0.0
    t2[:n] = 0.0
    for k in range(s.size[0]):
        row, h0, h1, h2 = f.p[s.at[k]], s.by[0, k], s.by[1, k], s.by[2, k]
        if h0 != 0.0 and h1 == 0.0 and h2 == 0.0:
            _add(t0, h0, row, n)
        elif h0 == 0.0 and h1 != 0.0 and h2 == 0.0:
            _add(t1, h1, row, n)
        elif h0 == 0.0 and h1 == 0.0 and h2 != 0.0:
            _add(t2, h2, row, n)
        elif row[s.at[k]] > 0.0:
            for i in range(n):
                t0[i] += h0 * row[i]
                t1[i] += h1 * row[i]
                t2[i] += h2 * row[i]
    for r in range(0, w.used[0], 3):  # an update leaves three
        g0, g1, g2 = w.rows[r], w.rows[r + 1], w.rows[r + 2]
        a, b, c = times(s, g0), times(s, g1), times(s, g2)
        for i in range(n):
            t0[i] -= a.x * g0[i] + b.x * g1[i] + c.x * g2[i]
            t1[i] -= a.y * g0[i] + b.y * g1[i] + c.y * g2[i]
            t2[i] -= a.z * g0[i] + b.z * g1[i] + c.z * g2[i]
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(s.size[0]):
        at, h0, h1, h2 = s.at[k], s.by[0, k], s.by[1, k], s.by[2, k]
        xx, xy, xz = xx + t0[at] * h0, xy + t0[at] * h1, xz + t0[at] * h2
        yy, yz, zz = yy + t1[at] * h1, yz + t1[at] * h2, zz + t2[at] * h2
    return Sym3(xx, xy, xz, yy, yz, zz)


@lean
def times(s: Jacobian, column: Floats) -> Vec3:
    """Return the Jacobian s times a column (n,)."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(s.size[0]):
        value = column[s.at[k]]
        x, y, z = x + s.by[0, k] * value, y + s.by[1, k] * value, z + s.by[2, k] * value
    return Vec3(x, y, z)


@lean
def _add(t: Floats, factor: float, row: Floats, n: int) -> None:
    for i in range(n):
        t[i] += factor * row[i]


@lean
def update(f: Filter, i: Innovation, w: Pending) -> float:
    """Take in an innovation whose T is in w.t; what it takes off P goes to three more rows of w.rows, rows of what was
    not measured being zero. Return log N(e; 0, S)."""
    root = cholesky(i.s)
    if root.xx == 0.0:
        return 0.0
    whitened, k, n, added = solved(root, i.e), w.used[0], f.size[0], w.added
    t0, t1, t2, g0, g1, g2 = w.t[0], w.t[1], w.t[2], w.rows[k], w.rows[k + 1], w.rows[k + 2]
    for m in range(n):
        u = solved(root, Vec3(t0[m], t1[m], t2[m]))
        g0[m], g1[m], g2[m] = u.x, u.y, u.z
        added[m] += dot(u, whitened)
    w.rows[k : k + 3, n:] = 0.0  # states may enter before these rows are settled
    w.used[0] = k + 3
    log_root = math.log(root.xx * root.yy * root.zz)
    return float(-0.5 * dot(whitened, whitened) - log_root - 0.5 * i.measured * LOG_2PI)


@lean
def blank(w: Pending, e: Vec3) -> None:
    """Clear the rows of T of what was not measured: NaN in e."""
    if math.isnan(e.x):
        w.t[0] = 0.0
    if math.isnan(e.y):
        w.t[1] = 0.0
    if math.isnan(e.z):
        w.t[2] = 0.0


@lean
def settle(f: Filter, w: Pending) -> None:
    """Take off P what is pending."""
    downdate(f.p, f.size[0], w.rows, w.used[0])
    w.used[0] = 0


@lean
def add_up(f: Filter, w: Pending) -> None:
    """Settle, and add to the mean what is pending."""
    settle(f, w)
    for i in range(f.size[0]):
        f.x[i] += w.added[i]
        w.added[i] = 0.0


@lean
def correct(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, part: float, rules: Rules,
    s: Jacobian, w: Pending,
) -> float:  # fmt: skip
    """Take in what a measurement of VT j says of the whole state; return its log-density.

    part: of the measurement that counts, the others being of other hypotheses.
    """
    if w.used[0] + 6 > len(w.rows):
        settle(f, w)
    e, hph = compare(f, a, j, offset, measurement, s, w)
    blank(w, e)
    spread, lacks = spread_of(f, j, e), 0.0
    new = innovate(e, measurement.q, sym_plus(hph, spread))
    plain = new.s
    if rules.merge_rate > 0.0 and not math.isnan(e.y):
        allowed, lacks = allow_for_merging(f, j, new.e.y, new.s, measurement.q[1])
        new = Innovation(new.e, allowed, new.measured)
    weight = part * huber_weight(new)
    count_sizes(f, j, measurement, Innovation(vec_scaled(new.e, math.sqrt(weight)), plain, new.measured), w)
    widened = sym_scaled(new.s, 1.0 / weight)
    counted = Innovation(new.e, sym_minus(widened, spread), new.measured)
    if len(f.particles.weight) > 0:
        innovate_particles(f, j, offset, measurement, e, counted, s, w)
    density = update(f, counted, w)
    if len(f.particles.weight) > 0:
        distance2, log_det = log_likelihood(Innovation(new.e, widened, new.measured))
        density = -0.5 * (distance2 + log_det + new.measured * LOG_2PI)
    show_steps(f, e, new, counted.s, s, w)
    return density + lacks


@lean
def spread_of(f: Filter, j: int, e: Vec3) -> Sym3:
    """Return the covariance over the particles of what they expect of VT j, zero where e is NaN: not measured."""
    far, across, up, s = not math.isnan(e.x), not math.isnan(e.y), not math.isnan(e.z), f.vts.spread[j]
    return Sym3(
        s[0] if far else 0.0, s[1] if far and across else 0.0, s[2] if far and up else 0.0, s[3] if across else 0.0,
        s[4] if across and up else 0.0, s[5] if up else 0.0,
    )  # fmt: skip


@lean
def innovate_particles(
    f: Filter, j: int, offset: int, measurement: BlockMeasurement, e: Vec3, mean: Innovation, s: Jacobian, w: Pending
) -> None:
    """Write the next three rows of w.whitened: what a measurement of VT j differs by from what each particle expects,
    given the measurements before it in the block, whitened by the covariance of the mean's innovation.

    e: the mean's innovation as `compare` returns it. Geometry is that of each particle, errors of the array are linear.
    """
    d, k, root = f.particles.deviation, w.used[0], cholesky(mean.s)
    if root.xx == 0.0:
        return
    far, across, up = w.whitened[k], w.whitened[k + 1], w.whitened[k + 2]
    own = solved(root, mean.e)
    w.whitened_mean[k], w.whitened_mean[k + 1], w.whitened_mean[k + 2] = own.x, own.y, own.z
    whole, at = vec_plus(e, times(s, w.added)), f.vts.state[j]
    expected = _seen_by(f, j, measurement, -1)
    for c in range(len(f.particles.weight)):
        h = _seen_by(f, j, measurement, c)
        far[c] = whole.x + expected.distance - h.distance - d[offset, c]
        across[c] = wrap(whole.y + expected.azimuth - h.azimuth)
        up[c] = whole.z + expected.elevation - h.elevation
    for m in range(s.size[0]):
        index, b0, b1, b2 = s.at[m], s.by[0, m], s.by[1, m], s.by[2, m]
        if (
            index < POSE
            or index == offset
            or index == f.core.range_scale
            or at[0] == index
            or at[1] == index
            or at[2] == index
            or is_of_illuminator(f, j, index)
        ):
            continue  # geometry, clock and scale of range, which are above
        _subtract(far, across, up, Vec3(b0, b1, b2), d[index])
    for r in range(k):
        _subtract(far, across, up, times(s, w.rows[r]), w.whitened[r])
    for c in range(len(f.particles.weight)):
        u = solved(root, Vec3(
            0.0 if math.isnan(e.x) else far[c], 0.0 if math.isnan(e.y) else across[c],
            0.0 if math.isnan(e.z) else up[c],
        ))  # fmt: skip
        far[c], across[c], up[c] = u.x, u.y, u.z


@lean
def is_of_illuminator(f: Filter, j: int, index: int) -> bool:
    """Return whether a state is a coordinate of the illuminator of VT j."""
    if f.vts.slots[j, SCATTERER] == 0:
        return False
    at = f.vts.state[f.vts.slots[j, ILLUMINATOR]]
    return bool(at[VT] == index or at[VT + 1] == index or at[VT + 2] == index)


@lean
def _position_by(f: Filter, j: int, particle: int) -> Vec3:
    """Return where a particle has VT j, in m, or the mean (-1)."""
    at, x, d = f.vts.state[j], f.x, f.particles.deviation
    distance, azimuth, elevation = x[at[0]], x[at[1]], x[at[2]]
    if particle >= 0:
        distance += d[at[0], particle]
        azimuth += d[at[1], particle]
        elevation += d[at[2], particle]
    anchor = Vec3(f.vts.anchor[j, 0], f.vts.anchor[j, 1], f.vts.anchor[j, 2])
    return vec_plus(anchor, vec_scaled(direction(azimuth, elevation), distance))


@lean
def _seen_by(f: Filter, j: int, measurement: BlockMeasurement, particle: int) -> Spherical:
    """Return the measured distance (m), without clock offset, and direction (rad) of VT j as a particle has both, or
    the mean (-1)."""
    d, position, turned = f.particles.deviation, measurement.position, measurement.turned.r
    factor, scale = range_factor(f), f.core.range_scale
    if particle >= 0:
        factor += d[scale, particle] if scale >= 0 else 0.0
        by = measurement.deviation[:, particle]
        position = Vec3(position.x + by[0], position.y + by[1], position.z + by[2])
        turned = rotations(measurement.pose[3] + by[3], measurement.pose[4] + by[4], measurement.pose[5] + by[5]).r
    point = _position_by(f, j, particle)
    seen = spherical(transposed_vec(turned, vec_minus(point, position)))
    if f.vts.slots[j, SCATTERER] == 0:
        return Spherical(factor * seen.distance, seen.azimuth, seen.elevation)
    path = vec_minus(point, _position_by(f, f.vts.slots[j, ILLUMINATOR], particle))
    return Spherical(factor * (seen.distance + math.sqrt(dot(path, path))), seen.azimuth, seen.elevation)


@lean
def _subtract(far: Floats, across: Floats, up: Floats, by: Vec3, row: Floats) -> None:
    if by.x != 0.0:
        for c in range(len(row)):
            far[c] -= by.x * row[c]
    if by.y != 0.0:
        for c in range(len(row)):
            across[c] -= by.y * row[c]
    if by.z != 0.0:
        for c in range(len(row)):
            up[c] -= by.z * row[c]


@lean
def show_steps(f: Filter, e: Vec3, new: Innovation, counted: Sym3, s: Jacobian, w: Pending) -> None:
    """Take in what an innovation says of steps of clocks, after the update by it, which took `counted` for its
    covariance; e with NaN where not measured."""
    if w.steps.used[0] == 0:
        return
    root, taken, n, k = cholesky(new.s), cholesky(counted), f.size[0], w.used[0] - 3
    if root.xx == 0.0 or taken.xx == 0.0:
        return
    seen, g0, g1, g2 = solved(root, new.e), w.rows[k], w.rows[k + 1], w.rows[k + 2]
    for row in range(w.steps.used[0]):
        left, shows = w.steps.left[row], _shown(w.steps.left[row], e, s)
        by_step, gone = solved(root, shows), solved(taken, shows)
        w.steps.score[row] += dot(by_step, seen)
        w.steps.information[row] += dot(by_step, by_step)
        for i in range(n):
            left[i] -= gone.x * g0[i] + gone.y * g1[i] + gone.z * g2[i]


@lean
def _shown(left: Floats, e: Vec3, s: Jacobian) -> Vec3:
    """Return H left, zero where e is NaN."""
    h = times(s, left)
    return Vec3(0.0 if math.isnan(e.x) else h.x, 0.0 if math.isnan(e.y) else h.y, 0.0 if math.isnan(e.z) else h.z)


@lean
def count_sizes(f: Filter, j: int, measurement: BlockMeasurement, i: Innovation, w: Pending) -> None:
    """Take in what a measurement of VT j, whose T is in w.t, says of the sizes of white noise and diffuse errors.

    As if no paths merged: what is counted for that is none of these sizes.
    """
    q, white = measurement.q, measurement.white
    s = Sym3(
        i.s.xx + white[0] - q[0], i.s.xy, i.s.xz, i.s.yy + white[1] - q[1], i.s.yz, i.s.zz + white[2] - q[2]
    )  # fmt: skip
    count_white(f, i.e, s, white)
    for c in range(3):
        index = f.vts.state[j, DIFFUSE + c]
        if index >= 0:
            before = f.p[index, index]
            for r in range(w.used[0]):
                before -= w.rows[r, index] ** 2
            count_diffuse(f, c, before, white[c], Vec3(w.t[0, index], w.t[1, index], w.t[2, index]), i.e, s)


@lean
def huber_weight(i: Innovation) -> float:
    """Return the weight, 1 at most, of an innovation: less where it is unlikely large. What no model has, as paths that
    merge, must not outweigh what it has.

    Source: Huber, Robust Statistics, 1981, section 7: weights that fall as the residual.
    """
    distance2, _ = log_likelihood(i)
    return LIKELY / distance2 if LIKELY < distance2 < math.inf else 1.0


@lean
def compare(
    f: Filter, a: ArrayErrors, j: int, offset: int, measurement: BlockMeasurement, s: Jacobian, w: Pending
) -> tuple[Vec3, Sym3]:
    """Return what a measurement of VT j differs by from what is expected, and H P H^T; H P is left in w.t."""
    seen, z = geometry(f, j, offset, measurement.position, measurement.turned, coordinates(f, j), s), measurement.z
    errors = errors_of(f, a, j, seen, measurement.diffuse, measurement.turn, measurement.now, s)
    e = Vec3(
        z[0] - seen.distance - f.x[offset] - errors.x, z[1] - seen.azimuth - errors.y, z[2] - seen.elevation - errors.z
    )
    return vec_minus(e, times(s, w.added)), gains(f, s, w)


@lean
def merge_probability(rate: float) -> float:
    """Return the probability that another path has merged with one of which nothing is known.

    rate: how often that begins, 1/s; 0: never.
    """
    return rate / (rate + END_RATE)


@lean
def expect_merging(f: Filter, rate: float, dt: float) -> None:
    """Let paths merge and part for a time dt (s)."""
    stationary, left = merge_probability(rate), math.exp(-(rate + END_RATE) * dt)
    for j in range(f.count[0]):
        f.vts.anchor[j, MERGED] = stationary + left * (f.vts.anchor[j, MERGED] - stationary)


@lean
def expect_beside(
    f: Filter, b: Block, j: int, offset: int, seen: Spherical, position: Vec3, turned: Rotations, confirm: int,
    s: Jacobian,
) -> None:  # fmt: skip
    """Expect that another path has merged with that of VT j, seen there (m and rad) in this block, where a confirmed VT
    that is not seen has its place within what is resolved."""
    for i in range(f.count[0]):
        sought = (
            f.vts.slots[i, LINK] == f.vts.slots[j, LINK]
            and f.vts.slots[i, HITS] >= confirm
            and f.vts.anchor[i, WEIGHT] == 1.0
        )
        if i == j or b.sums.detections[i] > 0 or not sought:
            continue
        other = geometry(f, i, offset, position, turned, coordinates(f, i), s)
        if (
            abs(other.distance - seen.distance) < UNRESOLVED[0]
            and abs(wrap(other.azimuth - seen.azimuth)) < UNRESOLVED[1]
            and abs(other.elevation - seen.elevation) < UNRESOLVED[2]
        ):
            f.vts.anchor[j, MERGED] = max(f.vts.anchor[j, MERGED], BESIDE)


@lean
def allow_for_merging(f: Filter, j: int, e: float, s: Sym3, q: float) -> tuple[Sym3, float]:
    """Judge by the innovation e (rad) of its azimuth whether another path has merged with that of VT j.

    s: covariance of the innovation, in m and rad, of which q (rad^2) is the measurement's. Return the covariance that
    the azimuth counts with, and by what the log-density of such a measurement, merged or not, is greater than by that
    covariance.
    """
    before, wide, e2 = f.vts.anchor[j, MERGED], s.yy + SHIFT2, e * e
    plain, merged = math.log(s.yy) + e2 / s.yy, math.log(wide) + e2 / wide
    least = min(plain, merged)
    log_sum = -0.5 * least + math.log(
        (1.0 - before) * math.exp(-0.5 * (plain - least)) + before * math.exp(-0.5 * (merged - least))
    )
    after = before * math.exp(-0.5 * merged - log_sum)
    f.vts.anchor[j, MERGED] = after
    counted = s.yy - q + 1.0 / ((1.0 - after) / q + after / (q + LASTS * SHIFT2))
    lacks = log_sum + 0.5 * (math.log(counted) + e2 / counted)
    return Sym3(s.xx, s.xy, s.xz, counted, s.yz, s.zz), lacks
