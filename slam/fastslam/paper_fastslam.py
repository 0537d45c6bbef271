"""The paper's extended FastSLAM: particles of the path, each with a map of its own, an EKF for each VT.

State
    Particle i is a path r_{i,1:t} of the vehicle (eq. 18), r = [r_x, r_y, r_z, r_psi, r_theta, r_phi] (eq. 13). Given
    the path, the VTs are independent, also those of different links (j, k) (eq. 16), and VT l of a link is
    v ~ N(mu, Sigma) in Cartesian coordinates (eq. 21).

Recursion, for each particle and each snapshot, link by link
    predict     r_t ~ p(r_t | r_{t-1}, u_t)                                                             (eq. 17, 19)
    associate   c = argmin over pairs of e^T S^-1 e, Hungarian algorithm within a gate                       (eq. 35)
                e = z - z^,  z^ = h(mu, r),  S = H Sigma H^T + Q             (eq. 22 to 27 and 33; Q: eq. 34)
    update      K = Sigma H^T S^-1,  mu <- mu + K e,  Sigma <- (1 - K H) Sigma                        (eq. 28 to 30)
    begin       a measurement that no VT takes begins one: mu = h^-1(z, r), Sigma = J Q J^T, J = d h^-1 / dz
    weigh       w <- w prod |2 pi S|^(-1/2) exp(-e^T S^-1 e / 2)                                        (eq. 31, 32)
    resample    in proportion to w, where the effective sample size is small; maps are copied

Misprints put right: the azimuth is atan2(y, x) and the elevation atan2(z, sqrt(x^2 + y^2)) (eq. 25, 26); R takes body
to world, so that eq. 27 has its transpose; S has H Sigma H^T (eq. 33 prints H^T Sigma H); Q is the variance at an SNR
of one over the SNR, plus a floor (eq. 34 prints a product).

The one thing added: constants theta = (b_1 ... b_S, beta, s) of the receiver and the vehicle, which the paper does not
estimate: the clock offset of each site (eq. 5, "unknown constants"), the bias of the yaw rate and the scale of the
odometer. In each particle theta ~ N(theta^, P) is marginalised exactly, as far as linear: the path depends on it by
D = dr/dtheta, a VT by G = dmu/dtheta, a measurement by A = dz^/dtheta = H (G - B) + e_d e_b^T, where B is how theta
moves a point that is fixed in the vehicle's frame, and e_d, e_b pick the distance and the offset.
    associate   with S + A P A^T
    update      G <- G - K A;  I = sum A^T S^-1 A,  y = sum A^T S^-1 e  over all VTs, which are updated given theta^
                P <- (P^-1 + I)^-1,  theta^ <- theta^ + P y;  r and every mu follow by D and G
    begin       G = B - n e_b^T,  n the direction of arrival
    weigh       w <- w |1 + I P|^(-1/2) exp(y^T P y / 2), P being the new one
Where P = 0, which `constants="sampled"` makes it, all of this is the paper's filter with theta drawn at the start.

Assumed, where the paper is silent: the gate; that a VT is dropped when it has not been seen for more snapshots than it
has been (Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, section 13.6, which the paper follows); there is
neither clutter nor missed detection in the weights.

Source: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
information", sections III and IV; theta: Schoen, Gustafsson and Nordlund, "Marginalized particle filters for mixed
linear/nonlinear state-space models", IEEE Trans. Signal Processing 53(7), 2005.
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numba import prange
from pydantic import BaseModel, ConfigDict, Field

from cellslam.sim.compiling import lean, njit
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.front_end.front_end_options import FrontEndOptions
from cellslam.slam.front_end.looks import Grouping
from cellslam.slam.front_end.measurement_noise import first_of_link, ports_of
from cellslam.slam.front_end.readings import Readings, readings
from cellslam.slam.model.assignment_kernel import assign
from cellslam.slam.model.matrices_kernel import (
    Mat3,
    Sym3,
    Vec3,
    congruence,
    determinant,
    adjugate,
    mat_mat,
    mat_minus,
    mat_sym,
    mat_vec,
    quadratic,
    rotation,
    sym_minus,
    sym_plus,
    sym_product,
    sym_scaled,
    sym_vec,
    transposed,
    transposed_vec,
    vec_minus,
    vec_plus,
    vec_scaled,
)
from cellslam.slam.model.measurement_kernel import cartesian_jacobian, direction, spherical, spherical_jacobian
from cellslam.slam.model.pose_moments import pose_moments
from cellslam.slam.model.resampling import systematic

# A VT's row: mu (3), upper triangle of Sigma (6), G (3, 3) by rows; identity, snapshot of the last measurement, number of
# measurements.
MU, SIGMA, G, IDENT, LAST, HITS, WIDTH = 0, 3, 9, 18, 19, 20, 21
SEEN_WIDTH = 27
NEAREST_M = 1.0  # a VT begins no nearer
LOG_TURN = math.log(2.0 * math.pi)
CHUNK = 16  # particles that share scratch memory


class Particles(NamedTuple):
    """r (N, 6), D (N, 2, 4): derivatives of x, y, z, psi by beta and by s; theta (N, K), P (N, K, K), log w (N,)."""

    r: Floats
    D: Floats
    theta: Floats
    P: Floats
    log_w: Floats


class Maps(NamedTuple):
    """VTs of N particles and L links, C at most of each: vts (N, L, C, WIDTH), count (N, L)."""

    vts: Floats
    count: Ints


class Measured(NamedTuple):
    """A snapshot: number, identity that its first measurement would begin; z (M, 3) in m and rad with variances (M, 3)
    to associate, update and begin; first measurement of each link (L + 1,) and its site (L,)."""

    now: int
    born: int
    z: Floats
    single: Floats
    many: Floats
    fresh: Floats
    first: Ints
    site: Ints


class Place(NamedTuple):
    """Where a particle is: position, rotation R, dp/dbeta, dp/ds (Vec3) and dpsi/dbeta, dpsi/ds."""

    p: Vec3
    R: Mat3
    p_beta: Vec3
    p_s: Vec3
    psi_beta: float
    psi_s: float


class Seen(NamedTuple):
    """A VT as a particle sees it: z^, H Sigma, H Sigma H^T and A."""

    z: Vec3
    H_Sigma: Mat3
    spread: Sym3
    A: Mat3


class Scratch(NamedTuple):
    """Memory to work in."""

    score: Floats
    seen: Floats
    near: Ints
    vt_of: Ints
    work_f: Floats
    work_i: Ints
    y: Floats
    info: Floats
    solve: Floats


@lean(forceinline=True)
def mean_of(vts: Floats, i: int, l: int, j: int) -> Vec3:
    """Return mu (m) of VT j of link l in particle i."""
    return Vec3(vts[i, l, j, MU], vts[i, l, j, MU + 1], vts[i, l, j, MU + 2])


@lean(forceinline=True)
def covariance_of(vts: Floats, i: int, l: int, j: int) -> Sym3:
    """Return Sigma (m^2)."""
    s = SIGMA
    return Sym3(
        vts[i, l, j, s], vts[i, l, j, s + 1], vts[i, l, j, s + 2], vts[i, l, j, s + 3], vts[i, l, j, s + 4],
        vts[i, l, j, s + 5],
    )  # fmt: skip


@lean(forceinline=True)
def gain_of(vts: Floats, i: int, l: int, j: int) -> Mat3:
    """Return G: columns by the site's offset (m/m), by beta (m s/rad) and by s (m)."""
    g = G
    return Mat3(
        vts[i, l, j, g], vts[i, l, j, g + 1], vts[i, l, j, g + 2], vts[i, l, j, g + 3], vts[i, l, j, g + 4],
        vts[i, l, j, g + 5], vts[i, l, j, g + 6], vts[i, l, j, g + 7], vts[i, l, j, g + 8],
    )  # fmt: skip


@lean(forceinline=True)
def put_vt(vts: Floats, i: int, l: int, j: int, mu: Vec3, Sigma: Sym3, gain: Mat3) -> None:
    """Write a VT."""
    vts[i, l, j, MU], vts[i, l, j, MU + 1], vts[i, l, j, MU + 2] = mu.x, mu.y, mu.z
    s, g = SIGMA, G
    vts[i, l, j, s], vts[i, l, j, s + 1], vts[i, l, j, s + 2] = Sigma.xx, Sigma.xy, Sigma.xz
    vts[i, l, j, s + 3], vts[i, l, j, s + 4], vts[i, l, j, s + 5] = Sigma.yy, Sigma.yz, Sigma.zz
    vts[i, l, j, g], vts[i, l, j, g + 1], vts[i, l, j, g + 2] = gain.xx, gain.xy, gain.xz
    vts[i, l, j, g + 3], vts[i, l, j, g + 4], vts[i, l, j, g + 5] = gain.yx, gain.yy, gain.yz
    vts[i, l, j, g + 6], vts[i, l, j, g + 7], vts[i, l, j, g + 8] = gain.zx, gain.zy, gain.zz


@lean(forceinline=True)
def predict(x: Particles, i: int, u: Floats, dt: float) -> None:
    """Move by velocities u (N, 6), less beta and s: r and D (eq. 17); attitude as half-way."""
    r, D, k = x.r, x.D, x.theta.shape[1]
    turn, speed = u[i, 3] - x.theta[i, k - 2], u[i, 0] / (1.0 + x.theta[i, k - 1])
    half = 0.5 * dt
    R = rotation(r[i, 3] + half * turn, r[i, 4] + half * u[i, 4], r[i, 5] + half * u[i, 5])
    way = vec_scaled(mat_vec(R, Vec3(speed, u[i, 1], u[i, 2])), dt)
    for c in range(2):
        psi = D[i, c, 3] - (half if c == 0 else 0.0)
        slower = 0.0 if c == 0 else speed * dt / (1.0 + x.theta[i, k - 1])
        D[i, c, 0] += -way.y * psi - R.xx * slower
        D[i, c, 1] += way.x * psi - R.yx * slower
        D[i, c, 2] -= R.zx * slower
    D[i, 0, 3] -= dt
    r[i, 0] += way.x
    r[i, 1] += way.y
    r[i, 2] += way.z
    r[i, 3] = wrap(r[i, 3] + dt * turn)
    r[i, 4] = wrap(r[i, 4] + dt * u[i, 4])
    r[i, 5] = wrap(r[i, 5] + dt * u[i, 5])


@lean(forceinline=True)
def place_of(x: Particles, i: int) -> Place:
    """Return where particle i is."""
    r, D = x.r, x.D
    return Place(
        Vec3(r[i, 0], r[i, 1], r[i, 2]), rotation(r[i, 3], r[i, 4], r[i, 5]),
        Vec3(D[i, 0, 0], D[i, 0, 1], D[i, 0, 2]), Vec3(D[i, 1, 0], D[i, 1, 1], D[i, 1, 2]), D[i, 0, 3], D[i, 1, 3],
    )  # fmt: skip


@lean(forceinline=True)
def carried(at: Place, w: Vec3) -> Mat3:
    """Return B: how theta moves a point at w (m) from the vehicle that is fixed in the vehicle's frame."""
    b, s = at.p_beta, at.p_s
    return Mat3(
        0.0, b.x - at.psi_beta * w.y, s.x - at.psi_s * w.y,
        0.0, b.y + at.psi_beta * w.x, s.y + at.psi_s * w.x,
        0.0, b.z, s.z,
    )  # fmt: skip


@lean(forceinline=True)
def own_part(P: Floats, i: int, site: int) -> Sym3:
    """Return the part of P that a link of a site depends on: its offset, beta and s."""
    k = P.shape[1]
    b, s = k - 2, k - 1
    return Sym3(P[i, site, site], P[i, site, b], P[i, site, s], P[i, b, b], P[i, b, s], P[i, s, s])


@lean(forceinline=True)
def see(at: Place, mu: Vec3, Sigma: Sym3, gain: Mat3, offset: float) -> Seen:
    """Return z^, H Sigma, H Sigma H^T and A of a VT (eq. 22 to 27)."""
    w = vec_minus(mu, at.p)
    body = transposed_vec(at.R, w)
    H = mat_mat(spherical_jacobian(body), transposed(at.R))
    H_Sigma, h = mat_sym(H, Sigma), spherical(body)
    A = mat_mat(H, mat_minus(gain, carried(at, w)))
    A = Mat3(A.xx + 1.0, A.xy, A.xz, A.yx, A.yy, A.yz, A.zx, A.zy, A.zz)
    z = Vec3(h.distance + offset, h.azimuth, h.elevation)
    return Seen(z, H_Sigma, sym_product(H_Sigma, transposed(H)), A)


@lean(forceinline=True)
def within_reach(at: Place, m: Measured, l: int, maps: Maps, i: int, j: int, own: Sym3, offset: float, gate: float) -> bool:
    """Return whether a measurement of link l has its distance within a VT's gate: most VTs need no more than that."""
    w = vec_minus(mean_of(maps.vts, i, l, j), at.p)
    length = max(math.sqrt(w.x * w.x + w.y * w.y + w.z * w.z), 1e-3)
    n = vec_scaled(w, 1.0 / length)
    a = transposed_vec(mat_minus(gain_of(maps.vts, i, l, j), carried(at, w)), n)
    spread = quadratic(covariance_of(maps.vts, i, l, j), n) + quadratic(own, Vec3(a.x + 1.0, a.y, a.z))
    for k in range(m.first[l], m.first[l + 1]):
        e = m.z[k, 0] - offset - length
        if e * e < gate * (spread + m.single[k, 0]) + 1e-3:
            return True
    return False


@lean(forceinline=True)
def innovation(z: Floats, k: int, predicted: Vec3) -> Vec3:
    """Return e = z - z^ of measurement k."""
    return Vec3(z[k, 0] - predicted.x, wrap(z[k, 1] - predicted.y), z[k, 2] - predicted.z)


@lean(forceinline=True)
def plus_noise(spread: Sym3, q: Floats, k: int) -> Sym3:
    """Return spread + Q (eq. 33), the variances of measurement k."""
    s = spread
    return Sym3(s.xx + q[k, 0], s.xy, s.xz, s.yy + q[k, 1], s.yz, s.zz + q[k, 2])


@lean(forceinline=True)
def score(m: Measured, l: int, seen: Seen, own: Sym3, gate: float, out: Floats, row: int) -> bool:
    """Write the gate less e^T (S + A P A^T)^-1 e of each measurement of link l; return whether any is positive."""
    found, spread, start = False, sym_plus(seen.spread, congruence(seen.A, own)), m.first[l]
    for k in range(start, m.first[l + 1]):
        e, S = innovation(m.z, k, seen.z), plus_noise(spread, m.single, k)
        out[row, k - start] = -1.0
        if e.x * e.x < gate * S.xx and e.y * e.y < gate * S.yy and e.z * e.z < gate * S.zz:
            cofactors = adjugate(S)
            det = determinant(S, cofactors)
            if det > 0.0:
                out[row, k - start] = gate - quadratic(cofactors, e) / det
                found = found or out[row, k - start] > 0.0
    return found


@lean(forceinline=True)
def keep(seen: Seen, store: Floats, row: int) -> None:
    """Keep how a VT is seen until it is updated."""
    s, h, c, a = store, seen.H_Sigma, seen.spread, seen.A
    s[row, 0], s[row, 1], s[row, 2] = seen.z.x, seen.z.y, seen.z.z
    s[row, 3], s[row, 4], s[row, 5], s[row, 6], s[row, 7], s[row, 8] = h.xx, h.xy, h.xz, h.yx, h.yy, h.yz
    s[row, 9], s[row, 10], s[row, 11] = h.zx, h.zy, h.zz
    s[row, 12], s[row, 13], s[row, 14], s[row, 15], s[row, 16], s[row, 17] = c.xx, c.xy, c.xz, c.yy, c.yz, c.zz
    s[row, 18], s[row, 19], s[row, 20], s[row, 21], s[row, 22], s[row, 23] = a.xx, a.xy, a.xz, a.yx, a.yy, a.yz
    s[row, 24], s[row, 25], s[row, 26] = a.zx, a.zy, a.zz


@lean(forceinline=True)
def kept(s: Floats, row: int) -> Seen:
    """Return what `keep` has kept."""
    return Seen(
        Vec3(s[row, 0], s[row, 1], s[row, 2]),
        Mat3(s[row, 3], s[row, 4], s[row, 5], s[row, 6], s[row, 7], s[row, 8], s[row, 9], s[row, 10], s[row, 11]),
        Sym3(s[row, 12], s[row, 13], s[row, 14], s[row, 15], s[row, 16], s[row, 17]),
        Mat3(s[row, 18], s[row, 19], s[row, 20], s[row, 21], s[row, 22], s[row, 23], s[row, 24], s[row, 25], s[row, 26]),
    )  # fmt: skip


@lean(forceinline=True)
def update(vts: Floats, i: int, l: int, j: int, seen: Seen, e: Vec3, S: Sym3, site: int, y: Floats, info: Floats) -> float:
    """Update a VT (eq. 28 to 30), add its part to y and I, and return log N(e; 0, S) (eq. 32)."""
    cofactors = adjugate(S)
    det = determinant(S, cofactors)
    S_inv, A = sym_scaled(cofactors, 1.0 / det), seen.A
    K = mat_sym(transposed(seen.H_Sigma), S_inv)
    mu = vec_plus(mean_of(vts, i, l, j), mat_vec(K, e))
    Sigma = sym_minus(covariance_of(vts, i, l, j), sym_product(K, seen.H_Sigma))
    put_vt(vts, i, l, j, mu, Sigma, mat_minus(gain_of(vts, i, l, j), mat_mat(K, A)))
    own_y, own_info = transposed_vec(A, sym_vec(S_inv, e)), congruence(transposed(A), S_inv)
    b, s = len(y) - 2, len(y) - 1
    y[site] += own_y.x
    y[b] += own_y.y
    y[s] += own_y.z
    info[site, site] += own_info.xx
    info[site, b] += own_info.xy
    info[site, s] += own_info.xz
    info[b, b] += own_info.yy
    info[b, s] += own_info.yz
    info[s, s] += own_info.zz
    return -0.5 * (quadratic(S_inv, e) + math.log(det) + 3.0 * LOG_TURN)


@lean(forceinline=True)
def begin(vts: Floats, i: int, l: int, j: int, at: Place, m: Measured, k: int, offset: float) -> None:
    """Write the VT that measurement k points to: mu = p + rho n, Sigma = J Q J^T, G = B - n e_b^T."""
    rho = max(m.z[k, 0] - offset, NEAREST_M)
    n = mat_vec(at.R, direction(m.z[k, 1], m.z[k, 2]))
    w, J = vec_scaled(n, rho), mat_mat(at.R, cartesian_jacobian(rho, m.z[k, 1], m.z[k, 2]))
    Q, B = Sym3(m.fresh[k, 0], 0.0, 0.0, m.fresh[k, 1], 0.0, m.fresh[k, 2]), carried(at, w)
    gain = Mat3(-n.x, B.xy, B.xz, -n.y, B.yy, B.yz, -n.z, B.zy, B.zz)
    put_vt(vts, i, l, j, vec_plus(at.p, w), congruence(J, Q), gain)


@lean(forceinline=True)
def drop_dubious(maps: Maps, i: int, l: int, now: int) -> None:
    """Drop the VTs of link l that have not been seen for more snapshots than they have been."""
    vts, count, j = maps.vts, maps.count, 0
    while j < count[i, l]:
        if now - vts[i, l, j, LAST] > vts[i, l, j, HITS] + 1:
            count[i, l] -= 1
            for c in range(WIDTH):
                vts[i, l, j, c] = vts[i, l, count[i, l], c]
        else:
            j += 1


@lean(forceinline=True)
def room(maps: Maps, i: int, l: int) -> int:
    """Return a place for a new VT of link l; where there is none, that of the one unseen for longest."""
    vts, count = maps.vts, maps.count
    if count[i, l] < vts.shape[2]:
        count[i, l] += 1
        return int(count[i, l]) - 1
    oldest = 0
    for j in range(1, count[i, l]):
        if vts[i, l, j, LAST] < vts[i, l, oldest, LAST]:
            oldest = j
    return oldest


@lean(forceinline=True)
def use_link(
    i: int, l: int, at: Place, x: Particles, maps: Maps, m: Measured, gate: float, association: Ints, t: Scratch
) -> float:
    """Associate the measurements of link l, update and begin its VTs in particle i; return the log of its factor of
    w."""
    start, stop, site = m.first[l], m.first[l + 1], m.site[l]
    own, offset, rivals, log_w = own_part(x.P, i, site), x.theta[i, site], 0, 0.0
    for j in range(maps.count[i, l]):
        if within_reach(at, m, l, maps, i, j, own, offset, gate):
            seen = see(
                at, mean_of(maps.vts, i, l, j), covariance_of(maps.vts, i, l, j), gain_of(maps.vts, i, l, j), offset
            )
            if score(m, l, seen, own, gate, t.score, rivals):
                keep(seen, t.seen, rivals)
                t.near[rivals] = j
                rivals += 1
    assign(t.score, rivals, stop - start, t.vt_of, t.work_f, t.work_i)
    for k in range(start, stop):
        association[i, k] = -1
        if t.vt_of[k - start] >= 0:
            row = t.vt_of[k - start]
            j, seen = t.near[row], kept(t.seen, row)
            e, S = innovation(m.z, k, seen.z), plus_noise(seen.spread, m.many, k)
            log_w += update(maps.vts, i, l, j, seen, e, S, site, t.y, t.info)
            maps.vts[i, l, j, LAST] = m.now
            maps.vts[i, l, j, HITS] += 1.0
            association[i, k] = int(maps.vts[i, l, j, IDENT])
        else:
            j = room(maps, i, l)
            begin(maps.vts, i, l, j, at, m, k, offset)
            maps.vts[i, l, j, IDENT], maps.vts[i, l, j, LAST], maps.vts[i, l, j, HITS] = m.born + k, m.now, 1.0
    return log_w


@lean(forceinline=True)
def learn_constants(x: Particles, i: int, y: Floats, info: Floats, work: Floats) -> float:
    """P <- (P^-1 + I)^-1 by eliminating (1 + P I) X = P, and theta^ <- theta^ + P y; return the log of its factor of
    w. The change of theta^ is left in y, the upper triangle of `info` (K, K) is I; work (K, 2 K)."""
    K, log_det, gained = len(y), 0.0, 0.0
    for r in range(K):
        for c in range(K):
            total = 1.0 if r == c else 0.0
            for j in range(K):
                total += x.P[i, r, j] * info[min(j, c), max(j, c)]
            work[r, c], work[r, K + c] = total, x.P[i, r, c]
    for r in range(K):
        pivot = work[r, r]
        log_det += math.log(pivot)
        for c in range(r, 2 * K):
            work[r, c] /= pivot
        for j in range(K):
            if j != r:
                factor = work[j, r]
                for c in range(r, 2 * K):
                    work[j, c] -= factor * work[r, c]
    for r in range(K):
        work[r, 0] = 0.0
        for c in range(K):
            x.P[i, r, c] = 0.5 * (work[r, K + c] + work[c, K + r])
            work[r, 0] += x.P[i, r, c] * y[c]
    for r in range(K):
        gained += y[r] * work[r, 0]
        y[r] = work[r, 0]
        x.theta[i, r] += y[r]
    return 0.5 * (gained - log_det)


@lean(forceinline=True)
def follow(x: Particles, maps: Maps, i: int, site_of: Ints, change: Floats) -> None:
    """Let the pose and all VTs follow a change (K,) of theta^."""
    K, r, D, vts = len(change), x.r, x.D, maps.vts
    for c in range(3):
        r[i, c] += D[i, 0, c] * change[K - 2] + D[i, 1, c] * change[K - 1]
    r[i, 3] = wrap(r[i, 3] + D[i, 0, 3] * change[K - 2] + D[i, 1, 3] * change[K - 1])
    for l in range(len(site_of)):
        own = Vec3(change[site_of[l]], change[K - 2], change[K - 1])
        for j in range(maps.count[i, l]):
            moved = mat_vec(gain_of(vts, i, l, j), own)
            vts[i, l, j, MU] += moved.x
            vts[i, l, j, MU + 1] += moved.y
            vts[i, l, j, MU + 2] += moved.z


@lean(forceinline=True)
def use_particle(
    i: int, x: Particles, maps: Maps, m: Measured, u: Floats, dt: float, gate: float, association: Ints, t: Scratch
) -> None:
    """Predict, associate, update and weigh particle i."""
    if dt > 0.0:
        predict(x, i, u, dt)
    at = place_of(x, i)
    for r in range(len(t.y)):
        t.y[r] = 0.0
        for c in range(len(t.y)):
            t.info[r, c] = 0.0
    for l in range(len(m.site)):
        drop_dubious(maps, i, l, m.now)
        if m.first[l] < m.first[l + 1]:
            x.log_w[i] += use_link(i, l, at, x, maps, m, gate, association, t)
    x.log_w[i] += learn_constants(x, i, t.y, t.info, t.solve)
    follow(x, maps, i, m.site, t.y)


@njit(cache=True, parallel=True)
def use_snapshot(
    x: Particles, maps: Maps, m: Measured, u: Floats, dt: float, gate: float, association: Ints
) -> None:
    """Use a snapshot in every particle; u (N, 6) in m/s and rad/s, dt in s; write association (N, M)."""
    count, most, measured, K = len(x.r), maps.vts.shape[2], len(m.z), x.theta.shape[1]
    for chunk in prange((count + CHUNK - 1) // CHUNK):
        wide = 4 * (most + measured + 2)
        t = Scratch(
            np.empty((most, measured + 1)), np.empty((most, SEEN_WIDTH)), np.empty(most, np.int64),
            np.empty(measured, np.int64), np.empty(wide), np.empty(wide, np.int64),
            np.zeros(K), np.zeros((K, K)), np.empty((K, 2 * K)),
        )  # fmt: skip
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count)):
            use_particle(i, x, maps, m, u, dt, gate, association, t)


@njit(cache=True, parallel=True)
def copy_maps(maps: Maps, target: Ints, source: Ints) -> None:
    """Copy the map of each source particle (n,) over that of a target (n,), which is none of the sources."""
    for k in prange(len(target)):
        i, o = target[k], source[k]
        for l in range(maps.count.shape[1]):
            count = maps.count[o, l]
            maps.count[i, l] = count
            maps.vts[i, l, :count] = maps.vts[o, l, :count]


class PaperFastSlamOptions(BaseModel):
    """What a scenario may set under `estimator.paper-fastslam`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    particles: int = Field(100, ge=1, le=100_000, description="number of particles")
    constants: Literal["sampled", "marginalised"] = Field(
        "marginalised", description="clock offsets, yaw-rate bias and odometer scale: drawn at the start, or marginalised"
    )
    sharing: Literal["none", "site"] = Field(
        "none", description="whether what the ports and sectors of a site measure of a path is fused before"
    )
    noise: Literal["white", "persisting"] = Field(
        "white", description="whether variances are raised for errors that persist from snapshot to snapshot"
    )
    gate: float = Field(16.3, gt=0, le=1000, description="squared Mahalanobis distance beyond which a VT begins")
    offset_component_std_m: float = Field(20.0, gt=0, le=1000, description="deviation of a particle's clock offset at the start, m")
    vts_per_link: int = Field(12, ge=1, le=1000, description="VTs kept per link; the longest unseen makes room")
    effective_share: float = Field(
        0.5, ge=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )


class PaperFastSlam:
    """FastSLAM as the paper has it, see the module."""

    name: ClassVar[str] = "paper-fastslam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[PaperFastSlamOptions]] = PaperFastSlamOptions

    def __init__(self, options: PaperFastSlamOptions | None = None) -> None:
        self.options = options or PaperFastSlamOptions()

    def warm_up(self) -> None:
        """Compile the kernels on a drive of four snapshots."""
        warm_up.drive(type(self)(self.options.model_copy(update={"particles": 2, "vts_per_link": 2})))
        copy_maps(self._maps_of(2, 1), np.array([0]), np.array([1]))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw the particles."""
        o, self._rng, self._model = self.options, rng, setup.odometry_model
        self._grouping = Grouping(setup, FrontEndOptions(sharing=o.sharing))
        self._setup = self._grouping.setup
        self._site = np.array(self._setup.links.site, np.int64)
        theta, P = self._constants()
        r = setup.start_pose + setup.start_std * rng.standard_normal((o.particles, 6))
        self._x = Particles(r, np.zeros((o.particles, 2, 4)), theta, P, np.zeros(o.particles))
        self._maps = self._maps_of(o.particles, len(self._site))
        yaw, forward = np.eye(6)[3], np.eye(6)[0]
        self._bias = self._model.bias * (1.0 - yaw) * rng.standard_normal(r.shape)
        self._scale = self._model.scale * (1.0 - forward) * rng.standard_normal(r.shape)
        self._now = self._born = 0

    def _maps_of(self, count: int, links: int) -> Maps:
        places = self.options.vts_per_link
        return Maps(np.zeros((count, links, places, WIDTH)), np.zeros((count, links), np.int64))

    def _constants(self) -> tuple[Floats, Floats]:
        """Return theta^ (N, K) and P (N, K, K) at the start."""
        o, sites, model = self.options, self._setup.sites, self._model
        mean = np.append(sites.clock_offset_mean_m, [0.0, 0.0])
        prior = np.append(sites.clock_offset_std_m, [model.bias[3], model.scale[0]])
        within = prior.copy()
        within[:-2] = np.minimum(within[:-2], o.offset_component_std_m)
        if o.constants == "sampled":
            within = 0.0 * prior
        drawn = mean + np.sqrt(prior**2 - within**2) * self._rng.standard_normal((o.particles, len(mean)))
        return drawn, np.tile(np.diag(within**2), (o.particles, 1, 1))

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Predict, associate, update, weigh and resample.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        o, x = self.options, self._x
        looks = self._grouping.looks(snapshot)
        ports = ports_of(self._setup.links.site, self._setup.links.port)
        v = readings(looks, ports, self._grouping.options, odometry[3] * dt_s, odometry[0] * dt_s)
        whole = np.isfinite(v.z).all(axis=1)
        first = np.concatenate([[0], np.cumsum(whole)])[first_of_link(looks, len(self._site))]
        many, fresh = (v.single, v.single) if o.noise == "white" else (v.many, v.fresh)
        m = Measured(self._now, self._born, v.z[whole], v.single[whole], many[whole], fresh[whole], first, self._site)
        some = np.full((o.particles, len(m.z)), -1)
        use_snapshot(x, self._maps, m, self._velocities(dt_s, odometry), dt_s, o.gate, some)
        w = np.exp(x.log_w - x.log_w.max())
        w /= w.sum()
        best = int(np.argmax(w))
        association = np.full(len(looks), -1)
        association[whole] = some[best]
        answer = self._grouping.answer(self._estimate(w, best, association), looks)
        if 1.0 / np.sum(w**2) < o.effective_share * len(w):
            self._resample(w)
        self._now += 1
        self._born += len(looks)
        return answer

    def _velocities(self, dt_s: float, odometry: Floats) -> Floats:
        """Draw the velocities (N, 6) of the particles, beta and s aside (eq. 19)."""
        model, shape = self._model, self._x.r.shape
        if dt_s == 0.0:
            return np.zeros(shape)
        self._bias += model.bias_walk_density * np.sqrt(dt_s) * self._rng.standard_normal(shape)
        noise = model.noise_density / np.sqrt(dt_s) * self._rng.standard_normal(shape)
        return np.asarray((odometry - self._bias - noise) / (1.0 + self._scale))

    def _estimate(self, w: Floats, best: int, association: Ints) -> Estimate:
        x, sites = self._x, len(self._setup.sites)
        mean, covariance = pose_moments(x.r, w, x.r[best])
        moved, within = np.array([0, 1, 2, 3]), np.swapaxes(x.D, 1, 2) @ x.P[:, -2:, -2:] @ x.D
        covariance[np.ix_(moved, moved)] += np.tensordot(w, within, 1)
        offset = w @ x.theta[:, :sites]
        variance = np.einsum("nkk->nk", x.P)[:, :sites] + (x.theta[:, :sites] - offset) ** 2
        return Estimate(mean, covariance, association, offset, w @ variance, self._vts(best))

    def _vts(self, best: int) -> VtEstimate:
        """Return the map of the best particle."""
        maps, P = self._maps, self._x.P[best]
        link, j = np.nonzero(np.arange(self.options.vts_per_link) < maps.count[best][:, None])
        vts = maps.vts[best, link, j]
        Sigma = vts[:, SIGMA + np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])]
        gain = vts[:, G:IDENT].reshape(-1, 3, 3)
        own = np.column_stack([self._site[link], np.full(len(link), len(P) - 2), np.full(len(link), len(P) - 1)])
        spread = gain @ P[own[:, :, None], own[:, None, :]] @ np.swapaxes(gain, 1, 2)
        return VtEstimate(vts[:, IDENT].astype(np.int64), link.astype(np.int64), vts[:, :3], Sigma + spread)

    def _resample(self, w: Floats) -> None:
        """Copy likely particles over unlikely ones."""
        chosen = systematic(w, len(w), self._rng)
        kept, times = np.unique(chosen, return_counts=True)
        target, source = np.setdiff1d(np.arange(len(w)), kept), np.repeat(kept, times - 1)
        for of in (*self._x, self._bias, self._scale):
            of[target] = of[source]
        copy_maps(self._maps, target, source)
        self._x.log_w[:] = 0.0
