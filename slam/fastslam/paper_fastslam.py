"""The paper's extended FastSLAM: particles of the path, each with a map of its own, an EKF for each VT.

State
    Particle i is a path r_{i,1:t} of the vehicle (eq. 18), r = [r_x, r_y, r_z, r_psi, r_theta, r_phi] (eq. 13). Given
    the path the VTs are independent, those of different links (j, k) too (eq. 16), and VT l of a link is
    v ~ N(mu, Sigma) in Cartesian coordinates (eq. 21).

Recursion, for each particle and snapshot, link by link
    predict     r_t ~ p(r_t | r_{t-1}, u_t)                                                             (eq. 17, 19)
    associate   c = argmin of the sum of e^T S^-1 e, Hungarian algorithm, within a gate                      (eq. 35)
                e = z - z^,  z^ = h(mu, r),  H = dh/dv,  S = H Sigma H^T + Q             (eq. 22 to 27, 33, Q: 34)
    update      K = Sigma H^T S^-1,  mu <- mu + K e,  Sigma <- Sigma - K H Sigma                      (eq. 28 to 30)
    begin       a VT from each measurement that is left over: mu = h^-1(z, r),  Sigma = J Q J^T,  J = dh^-1/dz
    weigh       w <- w prod |2 pi S|^(-1/2) exp(-e^T S^-1 e / 2)                                        (eq. 31, 32)
    resample    in proportion to w, maps and all, where the effective sample size is small

Misprints of the paper put right: azimuth atan2(y, x) and elevation atan2(z, sqrt(x^2 + y^2)) (eq. 25, 26); R takes body
to world, so that eq. 27 has its transpose; S with H Sigma H^T (eq. 33 has H^T Sigma H); Q with the variance at an SNR
of one over the SNR lambda (eq. 34 has a product).

What the paper lacks: theta = (beta, s), the constant bias of the yaw rate and the scale error of the odometer. Sampled
(`motion="sampled"`: as printed), theta is drawn at the start like all else of the path, and no particle is near the
truth for long. Marginalised, theta ~ N(theta^, P) in each particle, with D = dr/dtheta, G = dmu/dtheta and
A = dz^/dtheta = H (G - B), where B says how theta moves a point that is fixed in the vehicle's frame:
    predict     D by the chain rule
    associate   with S + A P A^T
    update      G <- G - K A, the VTs all given theta^;  y = sum A^T S^-1 e,  I = sum A^T S^-1 A
                P <- (P^-1 + I)^-1,  theta^ <- theta^ + P y,  r and all mu follow by D and G
    begin       G = B
    weigh       w <- w |1 + I P|^(-1/2) exp(y^T (P^-1 + I)^-1 y / 2): jointly exact where the model is linear
With P = 0 this is the paper's filter to the letter.

Assumed, where the paper is silent. The clock offset of a site (eq. 5) is the mean of its prior: given where
`radio.clock_offset_std_m` is 0, ignored otherwise. A VT that was unseen for more snapshots than it was seen is dropped
(the counter of Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, table 13.3). Variances are those that the front
end has on the whole, every error taken for white. Nothing in the weights speaks of clutter or of missed detections.

Sources: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
information", sections III and IV; theta: Schoen, Gustafsson and Nordlund, "Marginalized particle filters for mixed
linear/nonlinear state-space models", IEEE Trans. Signal Processing 53(7), 2005.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cellslam.sim.compiling import lean, njit
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.front_end.front_end_options import FrontEndOptions
from cellslam.slam.front_end.looks import Grouping, Looks
from cellslam.slam.front_end.measurement_noise import first_of_link, ports_of
from cellslam.slam.front_end.readings import readings
from cellslam.slam.model import matrices_kernel as algebra
from cellslam.slam.model.assignment_kernel import assign
from cellslam.slam.model.matrices_kernel import Mat3, Sym3, Vec3, dot, mat_mat, mat_vec, quadratic, sym_plus, transposed
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction, spherical, spherical_jacobian
from cellslam.slam.model.pose_moments import pose_moments
from cellslam.slam.model.resampling import systematic

FORWARD, YAW = 0, 3  # of u: what s and beta belong to
# A VT's row: mu (3), Sigma (6), columns of G by beta and s (3 each), identity, snapshot last seen, snapshots seen.
MU, SIGMA, G_BETA, G_S, IDENT, LAST, HITS, WIDTH = 0, 3, 9, 12, 15, 16, 17, 18
UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # where an upper triangle has the entries of its matrix
VTS_PER_LINK = 16  # kept at most: the one unseen for longest makes room
NEAREST_M = 1.0  # a VT begins no nearer
LOG_TURN = math.log(2.0 * math.pi)
CHUNK = 16  # particles that share scratch memory
# Small functions of large arguments: to call them would cost more than what they do.
inlined = lean(forceinline=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})


class Particles(NamedTuple):
    """Of N particles: r (N, 6); D (N, 2, 4), derivatives of x, y, z and psi by beta and s; theta^ (N, 2), P (N, 3), y
    (N, 2) and I (N, 3), of symmetric matrices the upper triangle; log w (N,); VTs of L links, C at most of each (N, L,
    C, WIDTH), and how many there are (N, L). Of one particle: the same without N."""

    r: Floats
    D: Floats
    theta: Floats
    P: Floats
    y: Floats
    I: Floats
    log_w: Floats
    vts: Floats
    count: Ints


class Measured(NamedTuple):
    """A snapshot: its number; the identity of a VT that its first measurement would begin; z (M, 3) in m and rad, clock
    offsets taken off; variances (M, 3) to associate, to update and to begin; what log w lacks (M,) where the first two
    differ; the first measurement of each link (L + 1,); the gate."""

    now: int
    born: int
    z: Floats
    single: Floats
    many: Floats
    fresh: Floats
    lack: Floats
    first: Ints
    gate: float


class Pair(NamedTuple):
    """A matrix (3, 2): its columns by beta and by s."""

    beta: Vec3
    s: Vec3


class Vt(NamedTuple):
    """A VT: mu (m), Sigma (m^2), G."""

    mu: Vec3
    Sigma: Sym3
    G: Pair


class Place(NamedTuple):
    """Where a particle is: position p (m), rotation R, dp/dtheta and dpsi/dtheta."""

    p: Vec3
    R: Mat3
    D: Pair
    psi_beta: float
    psi_s: float


class Seen(NamedTuple):
    """A VT as a particle sees it: z^, H Sigma, H Sigma H^T and A."""

    z: Vec3
    H_Sigma: Mat3
    spread: Sym3
    A: Pair


class Scratch(NamedTuple):
    """Memory: scores (C, M + 1), VTs in reach (C, 24) as `keep` has them and which these are (C,), the one that each
    measurement is assigned to (M,), and numbers for the solver."""

    score: Floats
    seen: Floats
    near: Ints
    row_of: Ints
    work_f: Floats
    work_i: Ints


@inlined
def vec_at(a: Floats, c: int) -> Vec3:
    """Return three neighbours of an array (n,), in the unit that they have."""
    return Vec3(a[c], a[c + 1], a[c + 2])


@inlined
def vt_at(row: Floats) -> Vt:
    """Return the VT of a row (WIDTH,), in m."""
    Sigma = Sym3(row[SIGMA], row[SIGMA + 1], row[SIGMA + 2], row[SIGMA + 3], row[SIGMA + 4], row[SIGMA + 5])
    return Vt(vec_at(row, MU), Sigma, Pair(vec_at(row, G_BETA), vec_at(row, G_S)))


@inlined
def put_vt(row: Floats, vt: Vt) -> None:
    """Write a VT into a row (WIDTH,), in m."""
    mu, Sigma, (b, s) = vt
    row[MU], row[MU + 1], row[MU + 2] = mu.x, mu.y, mu.z
    row[SIGMA], row[SIGMA + 1], row[SIGMA + 2] = Sigma.xx, Sigma.xy, Sigma.xz
    row[SIGMA + 3], row[SIGMA + 4], row[SIGMA + 5] = Sigma.yy, Sigma.yz, Sigma.zz
    row[G_BETA], row[G_BETA + 1], row[G_BETA + 2], row[G_S], row[G_S + 1], row[G_S + 2] = b.x, b.y, b.z, s.x, s.y, s.z


@inlined
def predict(x: Particles, u: Floats, dt: float) -> None:
    """Move a particle by velocities u (6,), less beta and s, for dt (s): r (eq. 17), with the attitude half-way, and
    D."""
    r, D, half, (beta, s) = x.r, x.D, 0.5 * dt, (x.theta[0], x.theta[1])
    turn, speed = u[YAW] - beta, u[FORWARD] / (1.0 + s)
    R = algebra.rotation(r[3] + half * turn, r[4] + half * u[4], r[5] + half * u[5])
    moved = algebra.vec_scaled(mat_vec(R, Vec3(speed, u[1], u[2])), dt)
    for c in range(2):  # by beta, which turns the vehicle back, and by s, which slows it down
        turned, slowed = (half, 0.0) if c == 0 else (0.0, speed * dt / (1.0 + s))
        psi = D[c, 3] - turned
        D[c, 0] -= moved.y * psi + R.xx * slowed
        D[c, 1] += moved.x * psi - R.yx * slowed
        D[c, 2] -= R.zx * slowed
        D[c, 3] -= 2.0 * turned
    r[0], r[1], r[2] = r[0] + moved.x, r[1] + moved.y, r[2] + moved.z
    r[3], r[4], r[5] = wrap(r[3] + dt * turn), wrap(r[4] + dt * u[4]), wrap(r[5] + dt * u[5])


@inlined
def place_of(x: Particles) -> Place:
    """Return where a particle is."""
    r, D = x.r, x.D
    R, moved = algebra.rotation(r[3], r[4], r[5]), Pair(vec_at(D[0], 0), vec_at(D[1], 0))
    return Place(vec_at(r, 0), R, moved, D[0, 3], D[1, 3])


@inlined
def carried(at: Place, w: Vec3) -> Pair:
    """Return B: how theta moves a point w (m) from the vehicle, in the world frame, that is fixed in the vehicle's."""
    (b, s), psi_b, psi_s = at.D, at.psi_beta, at.psi_s
    return Pair(Vec3(b.x - psi_b * w.y, b.y + psi_b * w.x, b.z), Vec3(s.x - psi_s * w.y, s.y + psi_s * w.x, s.z))


@inlined
def pair_minus(a: Pair, b: Pair) -> Pair:
    """Return a - b."""
    return Pair(algebra.vec_minus(a.beta, b.beta), algebra.vec_minus(a.s, b.s))


@inlined
def times(m: Mat3, a: Pair) -> Pair:
    """Return m a."""
    return Pair(mat_vec(m, a.beta), mat_vec(m, a.s))


@inlined
def see(at: Place, vt: Vt) -> Seen:
    """Return z^ = h(mu, r) (eq. 23 to 27), H Sigma, H Sigma H^T and A = H (G - B) of a VT."""
    w = algebra.vec_minus(vt.mu, at.p)
    body = algebra.transposed_vec(at.R, w)
    H, h = mat_mat(spherical_jacobian(body), transposed(at.R)), spherical(body)
    H_Sigma, A = algebra.mat_sym(H, vt.Sigma), times(H, pair_minus(vt.G, carried(at, w)))
    return Seen(Vec3(h.distance, h.azimuth, h.elevation), H_Sigma, algebra.sym_product(H_Sigma, transposed(H)), A)


@inlined
def with_constants(seen: Seen, P: Floats) -> Sym3:
    """Return H Sigma H^T + A P A^T; P (3,)."""
    b, s = seen.A
    crossed, own = algebra.sym_scaled(algebra.outer_sum(b, s), P[1]), algebra.sym_scaled(algebra.outer(b), P[0])
    return sym_plus(sym_plus(seen.spread, crossed), sym_plus(own, algebra.sym_scaled(algebra.outer(s), P[2])))


@inlined
def within_reach(at: Place, vt: Vt, P: Floats, m: Measured, l: int) -> bool:
    """Return whether a measurement of link l has its distance within the gate: no component alone has a greater
    normalised distance than all three, and most VTs need no more than this."""
    w = algebra.vec_minus(vt.mu, at.p)
    distance = max(math.sqrt(dot(w, w)), NEAREST_M)
    n, apart = algebra.vec_scaled(w, 1.0 / distance), pair_minus(vt.G, carried(at, w))
    b, s = dot(n, apart.beta), dot(n, apart.s)
    spread = quadratic(vt.Sigma, n) + b * b * P[0] + 2.0 * b * s * P[1] + s * s * P[2]
    for k in range(m.first[l], m.first[l + 1]):
        e = m.z[k, 0] - distance
        if e * e < m.gate * (spread + m.single[k, 0]):
            return True
    return False


@inlined
def innovation(z: Floats, predicted: Vec3) -> Vec3:
    """Return e = z - z^; z (3,) in m and rad."""
    return Vec3(z[0] - predicted.x, wrap(z[1] - predicted.y), z[2] - predicted.z)


@inlined
def with_noise(s: Sym3, q: Floats) -> Sym3:
    """Return S = s + Q (eq. 33), with the variances q (3,) in m^2 and rad^2."""
    return Sym3(s.xx + q[0], s.xy, s.xz, s.yy + q[1], s.yz, s.zz + q[2])


@inlined
def score(m: Measured, l: int, predicted: Vec3, spread: Sym3, out: Floats) -> bool:
    """Write into `out` (M + 1,) by how much e^T S^-1 e of each measurement of link l is within the gate (eq. 35);
    return if any is."""
    found, start = False, m.first[l]
    for k in range(start, m.first[l + 1]):
        e, S, within = innovation(m.z[k], predicted), with_noise(spread, m.single[k]), -1.0
        if e.x * e.x < m.gate * S.xx and e.y * e.y < m.gate * S.yy and e.z * e.z < m.gate * S.zz:
            cofactors = algebra.adjugate(S)
            det = algebra.determinant(S, cofactors)
            if det > 0.0:  # rounding may have spoilt a covariance
                within = m.gate - quadratic(cofactors, e) / det
        out[k - start] = within
        found = found or within > 0.0
    return found


@inlined
def keep(seen: Seen, a: Floats) -> None:
    """Keep in `a` (24,) how a VT is seen until it is updated."""
    z, h, c, (b, s) = seen
    a[0], a[1], a[2], a[3], a[4], a[5] = z.x, z.y, z.z, h.xx, h.xy, h.xz
    a[6], a[7], a[8], a[9], a[10], a[11] = h.yx, h.yy, h.yz, h.zx, h.zy, h.zz
    a[12], a[13], a[14], a[15], a[16], a[17] = c.xx, c.xy, c.xz, c.yy, c.yz, c.zz
    a[18], a[19], a[20], a[21], a[22], a[23] = b.x, b.y, b.z, s.x, s.y, s.z


@inlined
def kept(a: Floats) -> Seen:
    """Return what `keep` has kept in `a` (24,)."""
    H_Sigma = Mat3(a[3], a[4], a[5], a[6], a[7], a[8], a[9], a[10], a[11])
    spread = Sym3(a[12], a[13], a[14], a[15], a[16], a[17])
    return Seen(vec_at(a, 0), H_Sigma, spread, Pair(vec_at(a, 18), vec_at(a, 21)))


@inlined
def update(x: Particles, row: Floats, seen: Seen, e: Vec3, S: Sym3) -> float:
    """Update the VT of a row (WIDTH,) (eq. 28 to 30), add its part to y and I, and return log N(e; 0, S) (eq. 32)."""
    cofactors, A, vt = algebra.adjugate(S), seen.A, vt_at(row)
    det = algebra.determinant(S, cofactors)
    S_inv = algebra.sym_scaled(cofactors, 1.0 / det)
    K = algebra.mat_sym(transposed(seen.H_Sigma), S_inv)
    Sigma = algebra.sym_minus(vt.Sigma, algebra.sym_product(K, seen.H_Sigma))
    put_vt(row, Vt(algebra.vec_plus(vt.mu, mat_vec(K, e)), Sigma, pair_minus(vt.G, times(K, A))))
    b, s = algebra.sym_vec(S_inv, A.beta), algebra.sym_vec(S_inv, A.s)
    x.y[0] += dot(b, e)
    x.y[1] += dot(s, e)
    x.I[0] += dot(b, A.beta)
    x.I[1] += dot(b, A.s)
    x.I[2] += dot(s, A.s)
    return -0.5 * (quadratic(S_inv, e) + math.log(det) + 3.0 * LOG_TURN)


@inlined
def begin(row: Floats, at: Place, z: Floats, q: Floats) -> None:
    """Write into a row (WIDTH,) the VT that z (3,), variances q (3,), points to: mu = h^-1(z, r), J Q J^T, G = B."""
    d = max(z[0], NEAREST_M)
    w = algebra.vec_scaled(mat_vec(at.R, direction(z[1], z[2])), d)
    J = mat_mat(at.R, cartesian_jacobian(d, z[1], z[2]))
    Sigma = algebra.congruence(J, Sym3(q[0], 0.0, 0.0, q[1], 0.0, q[2]))
    put_vt(row, Vt(algebra.vec_plus(at.p, w), Sigma, carried(at, w)))


@inlined
def drop_dubious(x: Particles, l: int, now: int) -> None:
    """Drop the VTs of link l that were unseen for more snapshots than they were seen."""
    vts, j = x.vts[l], 0
    while j < x.count[l]:
        if now - vts[j, LAST] <= vts[j, HITS] + 1.0:
            j += 1
            continue
        x.count[l] -= 1
        for c in range(WIDTH):
            vts[j, c] = vts[x.count[l], c]


@inlined
def room(x: Particles, l: int) -> int:
    """Return the place for a new VT of link l: that of the one unseen for longest, if there is no other."""
    vts, oldest = x.vts[l], 0
    if x.count[l] < len(vts):
        x.count[l] += 1
        return int(x.count[l]) - 1
    for j in range(len(vts)):
        oldest = j if vts[j, LAST] < vts[oldest, LAST] else oldest
    return oldest


@inlined
def associate(x: Particles, at: Place, m: Measured, l: int, t: Scratch) -> None:
    """Assign the measurements of link l to its VTs (eq. 35)."""
    rivals = 0
    for j in range(x.count[l]):
        vt = vt_at(x.vts[l, j])
        if within_reach(at, vt, x.P, m, l):
            seen = see(at, vt)
            if score(m, l, seen.z, with_constants(seen, x.P), t.score[rivals]):
                keep(seen, t.seen[rivals])
                t.near[rivals] = j
                rivals += 1
    assign(t.score, rivals, m.first[l + 1] - m.first[l], t.row_of, t.work_f, t.work_i)


@inlined
def use_link(x: Particles, at: Place, m: Measured, l: int, association: Ints, t: Scratch) -> float:
    """Update and begin VTs of link l, as assigned; return the log of its factor of w. association (M,): identities."""
    log_w, start = 0.0, m.first[l]
    for k in range(start, m.first[l + 1]):
        n = t.row_of[k - start]
        row = x.vts[l, t.near[n] if n >= 0 else room(x, l)]
        if n >= 0:
            seen = kept(t.seen[n])
            S = with_noise(seen.spread, m.many[k])
            log_w += update(x, row, seen, innovation(m.z[k], seen.z), S) + m.lack[k]
            row[HITS] += 1.0
            association[k] = int(row[IDENT])
        else:
            begin(row, at, m.z[k], m.fresh[k])
            row[IDENT], row[HITS], association[k] = m.born + k, 1.0, -1
        row[LAST] = m.now
    return log_w


@inlined
def learn_constants(x: Particles) -> float:
    """P <- (P^-1 + I)^-1, theta^ <- theta^ + P y, followed by r and all mu; return the log of the factor of w.

    With two constants (P^-1 + I)^-1 = (P + det P adj I) / |1 + I P|, where P = 0 does no harm.
    """
    P, I, y, D = x.P, x.I, x.y, x.D
    det_P, det_I = max(P[0] * P[2] - P[1] * P[1], 0.0), max(I[0] * I[2] - I[1] * I[1], 0.0)
    det = 1.0 + P[0] * I[0] + 2.0 * P[1] * I[1] + P[2] * I[2] + det_P * det_I
    P[0], P[1], P[2] = (P[0] + det_P * I[2]) / det, (P[1] - det_P * I[1]) / det, (P[2] + det_P * I[0]) / det
    beta, s = P[0] * y[0] + P[1] * y[1], P[1] * y[0] + P[2] * y[1]
    x.theta[0] += beta
    x.theta[1] += s
    for c in range(4):
        x.r[c] += D[0, c] * beta + D[1, c] * s
    for l in range(len(x.count)):
        for j in range(x.count[l]):
            row = x.vts[l, j]
            for c in range(3):
                row[MU + c] += row[G_BETA + c] * beta + row[G_S + c] * s
    return 0.5 * (y[0] * beta + y[1] * s - math.log(det))


@inlined
def use_particle(x: Particles, m: Measured, u: Floats, dt: float, association: Ints, t: Scratch) -> float:
    """Predict, associate and update one particle; return the log of the factor of w."""
    if dt > 0.0:
        predict(x, u, dt)
    at, log_w = place_of(x), 0.0
    x.y[:] = 0.0
    x.I[:] = 0.0
    for l in range(len(x.count)):
        drop_dubious(x, l, m.now)
        if m.first[l] < m.first[l + 1]:
            associate(x, at, m, l, t)
            log_w += use_link(x, at, m, l, association, t)
    return log_w + learn_constants(x)


@inlined
def use_one(x: Particles, i: int, m: Measured, u: Floats, dt: float, association: Ints, t: Scratch) -> float:
    own = Particles(x.r[i], x.D[i], x.theta[i], x.P[i], x.y[i], x.I[i], x.log_w[i : i + 1], x.vts[i], x.count[i])
    return use_particle(own, m, u[i], dt, association[i], t)


@njit(cache=True, parallel=True)
def use_snapshot(x: Particles, m: Measured, u: Floats, dt: float, association: Ints) -> None:
    """Use a snapshot in every particle; u (N, 6) in m/s and rad/s, dt in s; association (N, M) is written."""
    count, most, measured = len(x.r), x.vts.shape[2], len(m.z)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        wide = 4 * (most + measured + 2)
        t = Scratch(
            np.empty((most, measured + 1)), np.empty((most, 24)), np.empty(most, np.int64),
            np.empty(measured, np.int64), np.empty(wide), np.empty(wide, np.int64),
        )  # fmt: skip
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count)):
            x.log_w[i] += use_one(x, i, m, u, dt, association, t)


@njit(cache=True, parallel=True)
def copy_maps(x: Particles, target: Ints, source: Ints) -> None:
    """Copy the map of each source particle (n,) over that of its target (n,), which is no source."""
    for n in prange(len(target)):
        i, of = target[n], source[n]
        x.count[i] = x.count[of]
        for l in range(x.count.shape[1]):
            x.vts[i, l, : x.count[of, l]] = x.vts[of, l, : x.count[of, l]]


class PaperFastSlamOptions(BaseModel):
    """What a scenario may set under `estimator.paper-fastslam`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: int = Field(100, ge=1, le=100_000, description="number of particles")
    motion: Literal["sampled", "marginalised"] = Field(
        "marginalised",
        description="yaw-rate bias and odometer scale: drawn at the start, as the paper, or marginalised",
    )
    sharing: Literal["none", "site"] = Field(
        "none", description="whether what the ports and sectors of a site measure of a path is fused first"
    )
    noise: Literal["white", "persisting"] = Field(
        "white", description="whether variances are raised for errors that persist from snapshot to snapshot"
    )
    gate: float = Field(16.3, gt=0, le=1000, description="squared Mahalanobis distance beyond which a VT begins")
    effective_share: float = Field(
        0.5, ge=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )


class PaperFastSlam:
    """FastSLAM as the paper has it, with yaw-rate bias and odometer scale marginalised: see the module."""

    name: ClassVar[str] = "paper-fastslam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[PaperFastSlamOptions]] = PaperFastSlamOptions

    def __init__(self, options: PaperFastSlamOptions | None = None) -> None:
        self.options = options or PaperFastSlamOptions()

    def warm_up(self) -> None:
        """Compile the kernels on a drive of four snapshots."""
        small = type(self)(self.options.model_copy(update={"particles": 2}))
        warm_up.drive(small)
        small._resample(np.array([1.0, 0.0]))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw poses and errors of the odometry."""
        o, model, self._rng = self.options, setup.odometry_model, rng
        self._grouping = Grouping(setup, FrontEndOptions(sharing=o.sharing))
        links = self._grouping.setup.links
        self._model, self._port, self._now, self._born = model, ports_of(links.site, links.port), 0, 0
        self._offset_of = np.array(setup.sites.clock_offset_mean_m[links.site], np.float64)
        shape, N, L = (o.particles, 6), o.particles, len(links)
        r = setup.start_pose + setup.start_std * rng.standard_normal(shape)
        self._bias, self._scale = model.bias * rng.standard_normal(shape), model.scale * rng.standard_normal(shape)
        theta, P = np.stack([self._bias[:, YAW], self._scale[:, FORWARD]], axis=1), np.zeros((N, 3))
        self._bias[:, YAW] = self._scale[:, FORWARD] = 0.0
        if o.motion == "marginalised":
            theta[:], P[:] = 0.0, [model.bias[YAW] ** 2, 0.0, model.scale[FORWARD] ** 2]
        self._x = Particles(
            r, np.zeros((N, 2, 4)), theta, P, np.zeros((N, 2)), np.zeros((N, 3)), np.zeros(N),
            np.zeros((N, L, VTS_PER_LINK, WIDTH)), np.zeros((N, L), np.int64),
        )  # fmt: skip

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Predict, associate, update, weigh and resample.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        o, x, looks = self.options, self._x, self._grouping.looks(snapshot)
        m, whole = self._measured(looks, odometry * dt_s)
        some, association = np.empty((o.particles, len(m.z)), np.int64), np.full(len(looks), -1)
        use_snapshot(x, m, self._velocities(dt_s, odometry), dt_s, some)
        w = np.exp(x.log_w - x.log_w.max())
        w /= w.sum()
        best = int(np.argmax(w))
        association[whole] = some[best]
        answer = self._grouping.answer(self._estimate(w, best, association), looks)
        if 1.0 / np.sum(w**2) < o.effective_share * len(w):
            self._resample(w)
        self._now += 1
        self._born += len(looks)
        return answer

    def _measured(self, looks: Looks, moved: Floats) -> tuple[Measured, NDArray[np.bool_]]:
        """Return the whole measurements of a snapshot, and which are (M,); moved (6,): since the last one, as measured."""
        v = readings(looks, self._port, self._grouping.options, moved[YAW], moved[FORWARD])
        if self.options.noise == "white":
            v = replace(v, many=v.single, fresh=v.single, lack=np.zeros(len(looks)))
        whole = np.isfinite(v.z).all(axis=1)
        z = v.z[whole]
        z[:, 0] -= self._offset_of[looks.link[whole]]
        first = np.concatenate([[0], np.cumsum(whole)])[first_of_link(looks, len(self._offset_of))]
        columns = (column[whole] for column in (v.single, v.many, v.fresh, v.lack))
        return Measured(self._now, self._born, z, *columns, first, self.options.gate), whole

    def _velocities(self, dt_s: float, odometry: Floats) -> Floats:
        """Draw velocities (N, 6) in m/s and rad/s, from which beta and s are not taken yet (eq. 19)."""
        model, shape = self._model, self._bias.shape
        if dt_s == 0.0:
            return np.zeros(shape)
        self._bias += model.bias_walk_density * np.sqrt(dt_s) * self._rng.standard_normal(shape)
        noise = model.noise_density / np.sqrt(dt_s) * self._rng.standard_normal(shape)
        return np.asarray((odometry - self._bias - noise) / (1.0 + self._scale))

    def _estimate(self, w: Floats, best: int, association: Ints) -> Estimate:
        """Return mean and covariance over the particles, and the map of the best one."""
        x = self._x
        mean, covariance = pose_moments(x.r, w, x.r[best])
        link, j = np.nonzero(np.arange(VTS_PER_LINK) < x.count[best][:, None])
        vts = x.vts[best, link, j]
        covariance[:4, :4] += np.einsum("n,nab,nar,nbc->rc", w, x.P[:, [[0, 1], [1, 2]]], x.D, x.D)
        G = np.stack([vts[:, G_BETA:G_S], vts[:, G_S:IDENT]], axis=2)
        Sigma = vts[:, SIGMA + UPPER] + G @ x.P[best][[[0, 1], [1, 2]]] @ np.swapaxes(G, 1, 2)
        return Estimate(
            mean, covariance, association, vts=VtEstimate(vts[:, IDENT].astype(np.int64), link, vts[:, :SIGMA], Sigma)
        )

    def _resample(self, w: Floats) -> None:
        """Copy likely particles over unlikely ones, by weights (N,) without unit that sum to 1."""
        kept, times = np.unique(systematic(w, len(w), self._rng), return_counts=True)
        target, source = np.setdiff1d(np.arange(len(w)), kept), np.repeat(kept, times - 1)
        for of in (*self._x[:7], self._bias, self._scale):
            of[target] = of[source]
        copy_maps(self._x, target, source)
        self._x.log_w[:] = 0.0
