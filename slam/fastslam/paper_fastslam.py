"""The paper's extended FastSLAM: particles of the path, each with a map of its own, an EKF for each VT.

State: particle i is a path r_{i,1:t} of the vehicle (eq. 18), r = [r_x, r_y, r_z, r_psi, r_theta, r_phi] (eq. 13).
Given the path, VTs are independent, those of other links (j, k) too (eq. 16): v ~ N(mu, Sigma), Cartesian (eq. 21).

Recursion, for each particle and snapshot, link by link; `use_particle` calls a function of each step's name, weighing
is in `update`, resampling in `_resample`:
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
(`motion="sampled"`: as printed, P = 0), theta is drawn at the start with the path, and soon no particle is near the
truth. Marginalised, theta ~ N(theta^, P) in each particle; with D = dr/dtheta, G = dmu/dtheta, A = dz^/dtheta =
H (G - B), where B says how theta moves a point that is fixed in the vehicle's frame:
    predict     D by the chain rule
    associate   with S + A P A^T
    update      G <- G - K A, the VTs all given theta^;  y = sum A^T S^-1 e,  I = sum A^T S^-1 A
                P <- (P^-1 + I)^-1,  theta^ <- theta^ + P y,  r and all mu follow by D and G
    begin       G = B
    weigh       w <- w |1 + I P|^(-1/2) exp(y^T (P^-1 + I)^-1 y / 2): jointly exact where the model is linear
The update of theta and this weight are in `learn_constants`; B is `carried`.

Assumed, where the paper is silent. The clock offset of a site (eq. 5) is the mean of its prior: given where
`radio.clock_offset_std_m` is 0, ignored otherwise. A VT that was unseen for more snapshots than it was seen is dropped
(as by the counter of Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, chapter 13), and none begins where there
is no room. Transmitters that were surveyed are in the map from the start, and stay. Every error is taken for white, of
the variance that the front end has on the whole. No clutter, no misses.

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
from pydantic import BaseModel, ConfigDict, Field

from cellslam.sim.compiling import lean, njit
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.measurements.fusion import FusedMeasurements, Fusion
from cellslam.slam.measurements.measurement_options import MeasurementOptions
from cellslam.slam.measurements.readings import ports_of, readings
from cellslam.slam.model import matrices_kernel as algebra
from cellslam.slam.model.assignment_kernel import assign
from cellslam.slam.model.matrices_kernel import Mat3, Mat32, Sym3, Vec3, dot, mat_mat, mat_mat32, mat_vec, transposed
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction, spherical, spherical_jacobian
from cellslam.slam.model.pose_moments import pose_moments
from cellslam.slam.model.resampling import systematic

FORWARD, YAW = 0, 3  # of u: what s and beta belong to
# A VT's row: mu (3); snapshot in which it was last seen, in how many it was, identity; G by columns (6), Sigma (6).
MU, LAST, HITS, IDENT, G, SIGMA, WIDTH = 0, 3, 4, 5, 6, 12, 18
UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # where an upper triangle has the entries of its matrix
VTS, LEAST_VTS = 192, 16  # that there is room for in a particle, and for a link at least
NEAREST_M, FAR_M = 1.0, 60.0  # a VT begins no nearer; out of the gate whatever the spread
CHUNK = 16  # particles that share scratch memory
# To call these small functions with many arguments would cost more than what they do.
inlined = lean(forceinline=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})


class Particles(NamedTuple):
    """Of N particles: r (N, 6); D (N, 2, 4), derivatives of x, y, z and psi by beta and s; theta^ (N, 2), P (N, 3), y
    (N, 2) and I (N, 3), of symmetric matrices the upper triangle; log w (N, 1); VTs of L links, C at most of each (N,
    L, C, WIDTH), and how many there are (N, L). Of one particle: the same without N."""

    r: Floats
    D: Floats
    theta: Floats
    P: Floats
    y: Floats
    info: Floats
    log_w: Floats
    vts: Floats
    counts: Ints


class Measured(NamedTuple):
    """A snapshot: its number; the identity of a VT that its first measurement would begin; the gate; z (M, 3) in m and
    rad, clock offsets taken off; variances (M, 3) to associate, to update and to begin; what log w lacks (M,) where the
    first two differ; the first measurement of each link (L + 1,)."""

    now: int
    born: int
    gate: float
    z: Floats
    single: Floats
    many: Floats
    fresh: Floats
    lack: Floats
    first: Ints


class Seen(NamedTuple):
    """A VT as a particle sees it: z^, H Sigma, H Sigma H^T and A."""

    z: Vec3
    H_Sigma: Mat3
    spread: Sym3
    A: Mat32


class Scratch(NamedTuple):
    """Memory: scores (C, M + 1); VTs in reach (C, 24), see `keep`; which these are (C,); numbers for the solver."""

    score: Floats
    seen: Floats
    near: Ints
    work_f: Floats
    work_i: Ints


@inlined
def put_vt(row: Floats, mu: Vec3, Sigma: Sym3, gain: Mat32) -> None:
    """Write a VT into a row (WIDTH,), in m."""
    algebra.put_vec_at(row, MU, mu)
    algebra.put_sym_at(row, SIGMA, Sigma)
    algebra.put_mat32_at(row, G, gain)


@inlined
def predict(x: Particles, u: Floats, dt: float) -> None:
    """Move a particle by velocities u (6,), less beta and s, for dt (s): r (eq. 17) and D; attitude half-way."""
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
def carried(D: Floats, w: Vec3) -> Mat32:
    """Return B: how theta moves a point at w (m) from the vehicle that is fixed in its frame; D (2, 4)."""
    b, s, by_b, by_s = algebra.vec_at(D[0], 0), algebra.vec_at(D[1], 0), D[0, 3], D[1, 3]
    return Mat32(Vec3(b.x - by_b * w.y, b.y + by_b * w.x, b.z), Vec3(s.x - by_s * w.y, s.y + by_s * w.x, s.z))


@inlined
def see(x: Particles, R: Mat3, row: Floats) -> Seen:
    """Return z^ = h(mu, r), m and rad (eq. 23 to 27), H Sigma, H Sigma H^T and A = H (G - B) of a VT's row (WIDTH,)."""
    w = algebra.vec_minus(algebra.vec_at(row, MU), algebra.vec_at(x.r, 0))
    body, apart = algebra.transposed_vec(R, w), algebra.mat32_minus(algebra.mat32_at(row, G), carried(x.D, w))
    H, h = mat_mat(spherical_jacobian(body), transposed(R)), spherical(body)
    H_Sigma = algebra.mat_sym(H, algebra.sym_at(row, SIGMA))
    spread = algebra.sym_product(H_Sigma, transposed(H))
    return Seen(Vec3(h.distance, h.azimuth, h.elevation), H_Sigma, spread, mat_mat32(H, apart))


@inlined
def within_reach(x: Particles, row: Floats, m: Measured, link: int) -> bool:
    """Return whether a measurement of a link has its distance (m) within the gate of the VT of a row (WIDTH,). No
    component alone has a greater normalised distance than all three: of most VTs nothing else need be known."""
    P, w = x.P, algebra.vec_minus(algebra.vec_at(row, MU), algebra.vec_at(x.r, 0))
    distance, least = max(math.sqrt(dot(w, w)), NEAREST_M), FAR_M**2
    for k in range(m.first[link], m.first[link + 1]):
        least = min(least, (m.z[k, 0] - distance) ** 2 - m.gate * m.single[k, 0])
    if least == FAR_M**2:
        return False
    n, apart = algebra.vec_scaled(w, 1.0 / distance), algebra.mat32_minus(algebra.mat32_at(row, G), carried(x.D, w))
    b, s = dot(n, apart.a), dot(n, apart.b)
    spread = algebra.quadratic(algebra.sym_at(row, SIGMA), n) + b * b * P[0] + 2.0 * b * s * P[1] + s * s * P[2]
    return bool(least < m.gate * spread)


@inlined
def innovation(z: Floats, q: Floats, predicted: Vec3, s: Sym3) -> tuple[Vec3, Sym3]:
    """Return e = z - z^ and S = s + Q (eq. 33); z (3,) in m and rad, variances q (3,)."""
    e = Vec3(z[0] - predicted.x, wrap(z[1] - predicted.y), z[2] - predicted.z)
    return e, Sym3(s.xx + q[0], s.xy, s.xz, s.yy + q[1], s.yz, s.zz + q[2])


@inlined
def score(seen: Seen, P: Floats, m: Measured, link: int, out: Floats) -> bool:
    """Write (M + 1,) without unit by how much e^T (S + A P A^T)^-1 e is within the gate, return if any is (eq. 35)."""
    found, start, spread = False, m.first[link], algebra.sym_plus(seen.spread, algebra.congruence32(seen.A, P))
    for k in range(start, m.first[link + 1]):
        (e, S), within = innovation(m.z[k], m.single[k], seen.z, spread), -1.0
        if e.x * e.x < m.gate * S.xx and e.y * e.y < m.gate * S.yy and e.z * e.z < m.gate * S.zz:
            cofactors = algebra.adjugate(S)
            det = algebra.determinant(S, cofactors)
            if det > 0.0:  # rounding may have spoilt a covariance
                within = m.gate - algebra.quadratic(cofactors, e) / det
        out[k - start] = within
        found = found or within > 0.0
    return found


@inlined
def keep(seen: Seen, a: Floats) -> None:
    """Keep in `a` (24,), in m and rad, how a VT is seen, until it is updated."""
    algebra.put_vec_at(a, 0, seen.z)
    algebra.put_mat_at(a, 3, seen.H_Sigma)
    algebra.put_sym_at(a, 12, seen.spread)
    algebra.put_mat32_at(a, 18, seen.A)


@inlined
def kept(a: Floats) -> Seen:
    """Return what `keep` has kept in `a` (24,), in m and rad."""
    return Seen(algebra.vec_at(a, 0), algebra.mat_at(a, 3), algebra.sym_at(a, 12), algebra.mat32_at(a, 18))


@inlined
def update(x: Particles, row: Floats, seen: Seen, e: Vec3, S: Sym3) -> float:
    """Update the VT of a row (WIDTH,) (eq. 28 to 30), add its part to y and I, and return log N(e; 0, S) (eq. 32)."""
    cofactors, A, y, info = algebra.adjugate(S), seen.A, x.y, x.info
    det = algebra.determinant(S, cofactors)
    S_inv = algebra.sym_scaled(cofactors, 1.0 / det)
    K = algebra.mat_sym(transposed(seen.H_Sigma), S_inv)
    mu = algebra.vec_plus(algebra.vec_at(row, MU), mat_vec(K, e))
    Sigma = algebra.sym_minus(algebra.sym_at(row, SIGMA), algebra.sym_product(K, seen.H_Sigma))
    put_vt(row, mu, Sigma, algebra.mat32_minus(algebra.mat32_at(row, G), mat_mat32(K, A)))
    b, s = algebra.sym_vec(S_inv, A.a), algebra.sym_vec(S_inv, A.b)
    y[0], y[1] = y[0] + dot(b, e), y[1] + dot(s, e)
    info[0], info[1], info[2] = info[0] + dot(b, A.a), info[1] + dot(b, A.b), info[2] + dot(s, A.b)
    return float(-0.5 * (algebra.quadratic(S_inv, e) + math.log(det) + 3.0 * math.log(2.0 * math.pi)))


@inlined
def begin(x: Particles, R: Mat3, row: Floats, z: Floats, q: Floats) -> None:
    """Write into a row (WIDTH,) the VT that z (3,) in m and rad, of variances q (3,), points to."""
    d = max(z[0], NEAREST_M)
    w = algebra.vec_scaled(mat_vec(R, direction(z[1], z[2])), d)
    J = mat_mat(R, cartesian_jacobian(d, z[1], z[2]))
    Sigma = algebra.congruence(J, Sym3(q[0], 0.0, 0.0, q[1], 0.0, q[2]))
    put_vt(row, algebra.vec_plus(algebra.vec_at(x.r, 0), w), Sigma, carried(x.D, w))


@inlined
def drop_unlikely(x: Particles, link: int, now: int) -> None:
    """Drop the VTs of a link that were unseen for more snapshots than they were seen."""
    vts, j = x.vts[link], 0
    while j < x.counts[link]:
        if now - vts[j, LAST] > vts[j, HITS] + 1.0:
            x.counts[link] -= 1
            for c in range(WIDTH):
                vts[j, c] = vts[x.counts[link], c]
        else:
            j += 1


@inlined
def associate(x: Particles, R: Mat3, m: Measured, link: int, assigned: Ints, t: Scratch) -> None:
    """Assign the measurements of a link (n,) to its VTs in reach, numbered as in `t.near`, -1 for none (eq. 35)."""
    rivals = 0
    for j in range(x.counts[link]):
        if within_reach(x, x.vts[link, j], m, link):
            seen = see(x, R, x.vts[link, j])
            if score(seen, x.P, m, link, t.score[rivals]):
                keep(seen, t.seen[rivals])
                t.near[rivals] = j
                rivals += 1
    assign(t.score, rivals, len(assigned), assigned, t.work_f, t.work_i)


@inlined
def use_link(x: Particles, R: Mat3, m: Measured, link: int, association: Ints, t: Scratch) -> None:
    """Associate the measurements of a link, update and begin its VTs, and weigh; association (M,): identities."""
    associate(x, R, m, link, association[m.first[link] : m.first[link + 1]], t)
    for k in range(m.first[link], m.first[link + 1]):
        n, count = association[k], x.counts[link]
        association[k] = -1
        if n >= 0:
            row, seen = x.vts[link, t.near[n]], kept(t.seen[n])
            e, S = innovation(m.z[k], m.many[k], seen.z, seen.spread)
            x.log_w[0] += update(x, row, seen, e, S) + m.lack[k]
            row[LAST], row[HITS], association[k] = m.now, row[HITS] + 1.0, int(row[IDENT])
        elif count < x.vts.shape[1]:
            row = x.vts[link, count]
            begin(x, R, row, m.z[k], m.fresh[k])
            row[IDENT], row[LAST], row[HITS], x.counts[link] = m.born + k, m.now, 1.0, count + 1


@inlined
def learn_constants(x: Particles) -> None:
    """P <- (P^-1 + I)^-1, theta^ <- theta^ + P y, followed by r and all mu, and w.

    With two constants (P^-1 + I)^-1 = (P + det P adj I) / |1 + I P|, where P = 0 does no harm.
    """
    P, info, y, D = x.P, x.info, x.y, x.D
    det_P, det_I = max(P[0] * P[2] - P[1] * P[1], 0.0), max(info[0] * info[2] - info[1] * info[1], 0.0)
    det = 1.0 + P[0] * info[0] + 2.0 * P[1] * info[1] + P[2] * info[2] + det_P * det_I
    P[0], P[1], P[2] = (P[0] + det_P * info[2]) / det, (P[1] - det_P * info[1]) / det, (P[2] + det_P * info[0]) / det
    beta, s = P[0] * y[0] + P[1] * y[1], P[1] * y[0] + P[2] * y[1]
    x.log_w[0] += 0.5 * (y[0] * beta + y[1] * s - math.log(det))
    x.theta[0], x.theta[1] = x.theta[0] + beta, x.theta[1] + s
    for c in range(4):
        x.r[c] += D[0, c] * beta + D[1, c] * s
    for link in range(len(x.counts)):
        for j in range(x.counts[link]):
            row = x.vts[link, j]
            for c in range(3):
                row[MU + c] += row[G + c] * beta + row[G + 3 + c] * s


@inlined
def use_particle(a: Particles, i: int, m: Measured, u: Floats, dt: float, association: Ints, t: Scratch) -> None:
    """Predict, associate, update and weigh particle i; u (6,) in m/s and rad/s, dt in s, association (M,)."""
    x = Particles(a.r[i], a.D[i], a.theta[i], a.P[i], a.y[i], a.info[i], a.log_w[i], a.vts[i], a.counts[i])
    if dt > 0.0:
        predict(x, u, dt)
    R = algebra.rotation(x.r[3], x.r[4], x.r[5])
    x.y[:] = 0.0
    x.info[:] = 0.0
    for link in range(len(x.counts)):
        drop_unlikely(x, link, m.now)
        if m.first[link] < m.first[link + 1]:
            use_link(x, R, m, link, association, t)
    learn_constants(x)


@njit(cache=True, parallel=True)
def use_snapshot(x: Particles, m: Measured, u: Floats, dt: float, association: Ints) -> None:
    """Use a snapshot in every particle; u (N, 6) in m/s and rad/s, dt in s; association (N, M) is written."""
    count, most, measured = len(x.r), x.vts.shape[2], len(m.z)
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        wide = 4 * (most + measured + 2)
        scores, seen, near = np.empty((most, measured + 1)), np.empty((most, 24)), np.empty(most, np.int64)
        t = Scratch(scores, seen, near, np.empty(wide), np.empty(wide, np.int64))
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count)):
            use_particle(x, i, m, u[i], dt, association[i], t)


@njit(cache=True, parallel=True)
def copy_maps(vts: Floats, count: Ints, target: Ints, source: Ints) -> None:
    """Copy the map (rows) of each source particle (n,) over that of its target (n,), which is no source."""
    # The arrays alone: Numba loses what a prange itself writes into arrays of a tuple.
    for n in prange(len(target)):
        for link in range(count.shape[1]):
            some = count[source[n], link]
            count[target[n], link] = some
            vts[target[n], link, :some] = vts[source[n], link, :some]


class PaperFastSlamOptions(BaseModel):
    """What a scenario may set under `estimator.paper-fastslam`: all but the first are steps away from the paper."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: int = Field(100, ge=1, le=100_000, description="number of particles")
    motion: Literal["sampled", "marginalised"] = Field(
        "marginalised", description="yaw-rate bias and odometer scale: drawn at the start, or marginalised"
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
        self._fusion = Fusion(setup, MeasurementOptions(sharing=o.sharing))
        links, N = self._fusion.setup.links, o.particles
        self._model, self._port = model, ports_of(links.site, links.port)
        self._now, self._born = 0, len(links)  # the first identities are those of surveyed transmitters
        self._offset_of = np.array(setup.sites.clock_offset_mean_m[links.site], np.float64)
        r = setup.start_pose + setup.start_std * rng.standard_normal((N, 6))
        self._bias, self._scale = model.bias * rng.standard_normal((N, 6)), model.scale * rng.standard_normal((N, 6))
        theta, P = np.stack([self._bias[:, YAW], self._scale[:, FORWARD]], axis=1), np.zeros((N, 3))
        self._bias[:, YAW] = self._scale[:, FORWARD] = 0.0
        if o.motion == "marginalised":
            theta[:], P[:] = 0.0, [model.bias[YAW] ** 2, 0.0, model.scale[FORWARD] ** 2]
        counts, capacity = np.zeros((N, len(links)), np.int64), max(VTS // max(len(links), 1), LEAST_VTS)
        sums = np.zeros((N, 2)), np.zeros((N, 3)), np.zeros((N, 1))
        vts, (link, position_m, std_m) = np.zeros((*counts.shape, capacity, WIDTH)), self._fusion.setup.surveyed
        counts[:, link], vts[:, link, 0, MU:LAST] = 1, position_m
        vts[:, link[:, None], 0, SIGMA + np.diag(UPPER)] = std_m**2
        vts[:, link, 0, HITS], vts[:, link, 0, IDENT] = np.inf, link  # never dropped
        self._x = Particles(r, np.zeros((N, 2, 4)), theta, P, *sums, vts, counts)

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Predict, associate, update, weigh and resample.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        o, log_w, measurements = self.options, self._x.log_w[:, 0], self._fusion.fuse(snapshot)
        m, whole = self._measured(measurements, odometry * dt_s)
        some, association = np.empty((o.particles, len(m.z)), np.int64), np.full(len(measurements), -1)
        use_snapshot(self._x, m, self._velocities(dt_s, odometry), dt_s, some)
        w = np.exp(log_w - log_w.max())
        w /= w.sum()
        best = int(np.argmax(w))
        association[whole] = some[best]
        answer = self._fusion.answer(self._estimate(w, best, association), measurements)
        if 1.0 / np.sum(w**2) < o.effective_share * len(w):
            self._resample(w)
        self._now, self._born = self._now + 1, self._born + len(measurements)
        return answer

    def _measured(self, measurements: FusedMeasurements, moved: Floats) -> tuple[Measured, Ints]:
        """Return the whole measurements of a snapshot, and which are (M,); moved (6,) since the last one."""
        v = readings(measurements, self._port, self._fusion.options, moved[YAW], moved[FORWARD])
        if self.options.noise == "white":
            v = replace(v, many=v.single, fresh=v.single)
        whole = np.flatnonzero(np.isfinite(v.z).all(axis=1))
        z, single, many, fresh = (column[whole] for column in (v.z, v.single, v.many, v.fresh))
        z[:, 0] -= self._offset_of[measurements.link[whole]]
        first = np.searchsorted(measurements.link[whole], np.arange(len(self._offset_of) + 1))
        lack = 0.5 * np.log(many / single).sum(axis=1)
        return Measured(self._now, self._born, self.options.gate, z, single, many, fresh, lack, first), whole

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
        x, P, (beta, s) = self._x, self._x.P[best, [[0, 1], [1, 2]]], np.swapaxes(self._x.D, 0, 1)
        mean, covariance = pose_moments(x.r, w, x.r[best])
        bb, bs, ss = (w * x.P.T)[..., None]
        covariance[:4, :4] += (bb * beta).T @ beta + (bs * beta).T @ s + (bs * s).T @ beta + (ss * s).T @ s
        link, j = np.nonzero(np.arange(x.vts.shape[2]) < x.counts[best][:, None])
        vts = x.vts[best, link, j]
        gain = vts[:, G:SIGMA].reshape(-1, 2, 3)
        Sigma = vts[:, SIGMA + UPPER] + np.swapaxes(gain, 1, 2) @ P @ gain
        found = VtEstimate(vts[:, IDENT].astype(np.int64), link, vts[:, MU:LAST], Sigma)
        return Estimate(mean, covariance, association, vts=found)

    def _resample(self, w: Floats) -> None:
        """Copy likely particles over unlikely ones, by weights (N,) that sum to 1."""
        alive, times = np.unique(systematic(w, len(w), self._rng), return_counts=True)
        target, source = np.setdiff1d(np.arange(len(w)), alive), np.repeat(alive, times - 1)
        for of in (*self._x[:7], self._bias, self._scale):
            of[target] = of[source]
        copy_maps(self._x.vts, self._x.counts, target, source)
        self._x.log_w[:] = 0.0
