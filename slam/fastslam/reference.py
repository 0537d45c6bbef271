"""The extended FastSLAM in plain NumPy: one particle after the other, equation by equation, in double precision.

The place to begin reading, and to begin a variant from. It is the filter as it is by default: motion drawn from the
odometry, VTs in range, azimuth and elevation about their place of birth, clock offsets, yaw-rate bias and odometer
scale marginalised, Hungarian association by likelihood. `fastslam.FastSlam` gives the same answers a thousand times as
fast; `tests/slam/fastslam/test_reference.py` holds it to this file.

Source: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
information". Equations are the paper's, by number, and those of docs/explanation/fastslam.md, by the name of the step,
which says what was added and why.

Left out: the other parts and clocks that drift (refused); VTs begun by measurements without distance or azimuth; the
limit `vts_per_link`. What makes the compiled filter's numbers others than these:

    single precision       of VTs, measurements and all that is made of both; poses, theta and weights are double
    blocks of 32           the number of particles is rounded up to; at resampling survivors keep their places, copies
                           take those of the dead, of their own block first, and that decides which draws of the noise a
                           particle gets (here particles come in the order of their ancestors)
    VTs passed over        what distance or azimuth alone, as last predicted, puts outside the gate; and of doubles,
                           those that differed by more than 2 m in distance when last predicted
    innovations of angles  end at 66.8 deg
    existence              is tabulated anew only where the interval changes by 0.1 %
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import ndtri

from cellslam.sim.errors import InputError
from cellslam.sim.frames import azimuth_elevation, integrate_pose, rotation, unit_vector, wrap_angle
from cellslam.sim.randomness import quasi_random
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.front_end.attitude import Attitude
from cellslam.slam.front_end.looks import Grouping, Looks
from cellslam.slam.front_end.measurement_noise import ports_of
from cellslam.slam.front_end.misfit import Misfit
from cellslam.slam.front_end.readings import Readings, novelty, readings
from cellslam.slam.front_end.visibility import existence
from cellslam.slam.model.measurement_model import jacobians, predict
from cellslam.slam.model.pose_moments import pose_moments
from cellslam.slam.model.resampling import SCHEMES

PLANE = [0, 1, 3]  # x, y, psi: what of a pose depends on yaw-rate bias and odometer scale
SPEED, YAW_RATE = 0, 3  # components of the odometry whose scale, and whose bias, are marginalised
LEAST_RANGE_M = 1.0  # a distance that leaves less, once the offset is taken off, begins no VT
UNKNOWN_ELEVATION_RAD = 0.2  # deviation of a VT that begins without elevation
MERGE_EVERY = 64  # snapshots from one search for doubles to the next
MERGE_DISTANCE2, MERGE_STD = 2.0, np.array([2.0, math.radians(2.5), math.radians(3.5)])
DEFAULTS = ("motion", "criterion", "clock")


@dataclass
class Vt:
    """A virtual transmitter of one particle: s | theta ~ N(mean + gain (theta - theta0), covariance) (docs, "State").

    s = (range, azimuth, elevation) (m, rad, rad) about `anchor` (3,), in axes of the world; gain (3, K), theta0 (K,).
    `id`: number of the measurement it was born from; `seen`: snapshot of the last of `hits` detections.
    """

    id: int
    site: int
    anchor: Floats
    mean: Floats
    covariance: Floats
    gain: Floats
    theta0: Floats
    seen: int
    hits: int = 1


@dataclass
class Particle:
    """A sampled path's last pose (6,), and what is known given that path: theta ~ N(theta, covariance), (K,) and
    (K, K), that is the clock offset of each site, yaw-rate bias, odometer scale; and the VTs of each link.

    `slope` (3, 2): d(x, y, psi)/d(bias, scale); `bias`, `scale` (6,): sampled errors of the other odometry components.
    """

    pose: Floats
    bias: Floats
    scale: Floats
    theta: Floats
    covariance: Floats
    maps: list[list[Vt]]
    slope: Floats = field(default_factory=lambda: np.zeros((3, 2)))
    log_weight: float = 0.0


class Prediction(NamedTuple):
    """A VT as a particle expects to measure it: s at the present theta, z (3,), H = dz/ds (3, 3), A = dz/dtheta (3, K),
    H Sigma H^T and A P A^T (3, 3)."""

    s: Floats
    z: Floats
    by_vt: Floats
    by_theta: Floats
    spread: Floats
    shared: Floats


class Existence(NamedTuple):
    """Whether VTs are there (docs, "Associate"; `front_end.visibility`): logs (2, 2, ages) of visible and detected and
    of missed, for VTs seen once and others; ages at which VTs seen once, and others not confirmed, are dropped."""

    log_chance: Floats
    age_once: int
    age_twice: int
    confirm_hits: int

    def kind(self, vt: Vt) -> int:
        """Return 0 for a VT seen once, 2 for a confirmed one, 1 for others."""
        return 2 if vt.hits >= self.confirm_hits else min(vt.hits - 1, 1)

    def oldest(self, vt: Vt) -> float:
        """Return for how many snapshots a VT is kept unseen."""
        return (self.age_once, self.age_twice, math.inf)[self.kind(vt)]

    def log_chances(self, vt: Vt, now: int) -> Floats:
        """Return log(r p_D) and log(1 - r p_D), (2,), r the probability that a VT is visible."""
        table = self.log_chance[min(self.kind(vt), 1)]
        chances: Floats = table[:, min(now - vt.seen, table.shape[1] - 1)]
        return chances


class ReferenceFastSlam:
    """The extended FastSLAM, to be read; parts that are not the default are refused with an InputError."""

    name: ClassVar[str] = "reference-fastslam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[FastSlamOptions]] = FastSlamOptions

    def __init__(self, options: FastSlamOptions | None = None) -> None:
        self.options = options or FastSlamOptions()
        for part in DEFAULTS:
            given, default = getattr(self.options, part), FastSlamOptions.model_fields[part].default
            if given != default:
                raise InputError(f"the reference has {part} = {default} alone, not {given}; use fastslam")
        self.resampling = SCHEMES[self.options.resampling]

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw the prior."""
        if (setup.sites.drift_std_m_s > 0.0).any():
            raise InputError("the reference takes clocks for constant, but these drift; use fastslam")
        self._grouping, self._rng = Grouping(setup, self.options), rng
        self._setup, self._options = self._grouping.setup, self._grouping.options
        self._attitude, self._misfit = Attitude(self._options, self._setup), Misfit(self._options)
        self._now, self._born, self._time_s = 0, 0, 0.0
        self.particles = drawn(self._setup, self._options, rng)

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Move, use the snapshot in every particle, answer, resample if needed (paper, section IV).

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        o, links = self._options, self._setup.links
        turned, moved = odometry[YAW_RATE] * dt_s, odometry[SPEED] * dt_s
        looks = self._grouping.looks(snapshot)
        level = self._attitude.levelled(dt_s, looks)
        values = self._misfit.widened(readings(level, ports_of(links.site, links.port), o, turned, moved), dt_s)
        if dt_s > 0.0:
            self._move(dt_s, odometry)
        new = novelty(o, turned, moved) if o.evidence_lasts else 1.0
        shares = new / np.bincount(links.site)[links.site].astype(np.float64) ** o.link_correlation
        existing = Existence(*existence(o, dt_s or 0.075), o.confirm_hits)
        association = [self._use(p, looks, values, shares, existing) for p in self.particles]
        self._now, self._born, self._time_s = self._now + 1, self._born + len(looks), self._time_s + dt_s
        return self._grouping.answer(self._conclude(association, looks, values, existing), looks)

    def _move(self, dt_s: float, odometry: Floats) -> None:
        """Sample the motion: biases walk, and the odometry has white noise (paper, eq. 19)."""
        model = self._setup.odometry_model
        walk = self._white(model.bias_walk_density * math.sqrt(dt_s))
        noise = self._white(model.noise_density / math.sqrt(dt_s))
        for p, step, error in zip(self.particles, walk, noise, strict=True):
            p.bias += step
            move(p, (odometry - p.bias + error) / (1.0 + p.scale), dt_s)

    def _white(self, std: Floats) -> Floats:
        """Draw independent normal numbers (N, 6) of such deviations (6,)."""
        out = np.zeros((len(self.particles), 6))
        for c in np.flatnonzero(std):
            out[:, c] = std[c] * self._rng.standard_normal(len(out))
        return out

    def _use(self, p: Particle, looks: Looks, values: Readings, shares: Floats, existing: Existence) -> Ints:
        """Use a snapshot in one particle; return the confirmed VT of each measurement (m,), -1 for none."""
        o, now, answer = self._options, self._now, np.full(len(looks), -1)
        y, information, log_weight = np.zeros(len(p.theta)), np.zeros_like(p.covariance), 0.0
        for link, site in enumerate(self._setup.links.site):
            vts = [vt for vt in p.maps[link] if now - vt.seen <= existing.oldest(vt)]
            log_weight += shares[link] * sum(existing.log_chances(vt, now)[1] for vt in vts)
            if o.merging and (now + link) % MERGE_EVERY == 0:
                vts = merged(p, vts, existing)
            seen, rows = [predicted(p, vt) for vt in vts], np.flatnonzero(looks.link == link).tolist()
            odds = [np.subtract(*existing.log_chances(vt, now)) - math.log(o.clutter_density) for vt in vts]
            scores = [[score(*pair, values, k, o.gate) for k in rows] for pair in zip(seen, odds, strict=True)]
            for k, q in zip(rows, associated(np.reshape(scores, (len(vts), len(rows)))), strict=True):
                if q >= 0:
                    log_weight += updated(vts[q], seen[q], odds[q], values, k, shares[link], p.theta, y, information)
                    vts[q].seen, vts[q].hits = now, vts[q].hits + 1
                    answer[k] = vts[q].id if existing.kind(vts[q]) == 2 else -1
                elif looks.begins[k] and can_begin(values.z[k], p.theta[site]):
                    vts.append(begun(p, site, values.z[k], values.fresh[k], self._born + k, now))
                    log_weight -= shares[link] * math.log1p(-o.birth_ratio)
            p.maps[link] = vts
        p.log_weight += o.likelihood_exponent * (log_weight + conditioned(p, y, information))
        return answer

    def _conclude(self, association: list[Ints], looks: Looks, values: Readings, existing: Existence) -> Estimate:
        """Answer with the mean over particles and the map of the heaviest one; resample (paper, eq. 18, 31)."""
        o, particles = self.options, self.particles
        log_weights = np.array([p.log_weight for p in particles])
        best, weights = int(np.argmax(log_weights)), np.exp(log_weights - log_weights.max())
        weights /= weights.sum()
        beliefs = moments(particles, weights, best, len(self._setup.sites))
        answer = Estimate(*beliefs[:2], association[best], *beliefs[2:], mapped(particles[best], existing))
        pose = particles[best].pose
        self._misfit.learn(answer, values, pose)
        answer = self._attitude.concluded(answer, looks, values.many, pose)
        wanted = o.particles if self._time_s >= o.start_phase_s else len(particles)
        if wanted != len(particles) or 1.0 / np.sum(weights**2) < o.effective_share * len(particles):
            self.particles = [copy.deepcopy(particles[a]) for a in self.resampling(weights, wanted, self._rng)]
            for p in self.particles:
                p.log_weight = 0.0
        return answer


def drawn(setup: Setup, o: FastSlamOptions, rng: np.random.Generator) -> list[Particle]:
    """Draw the prior: pose, sampled odometry errors, and a component of each clock offset's prior (docs, "Start")."""
    sites, model, n = setup.sites, setup.odometry_model, o.particles_start or o.particles
    pose = setup.start_pose + setup.start_std * rng.standard_normal((n, 6))
    bias, scale = model.bias * rng.standard_normal((n, 6)), model.scale * rng.standard_normal((n, 6))
    bias[:, YAW_RATE], scale[:, SPEED] = 0.0, 0.0
    component = np.minimum(sites.clock_offset_std_m, o.offset_component_std_m)
    between = np.sqrt(sites.clock_offset_std_m**2 - component**2)
    offset = sites.clock_offset_mean_m + between * ndtri(quasi_random(n, len(sites), rng))
    theta = np.concatenate([offset, np.zeros((n, 2))], axis=1)
    spread = np.diag(np.square([*component, model.bias[YAW_RATE], model.scale[SPEED]]))
    return [
        Particle(*row, spread, [[] for _ in setup.links.site]) for row in zip(pose, bias, scale, theta, strict=True)
    ]


def move(p: Particle, velocity: Floats, dt_s: float) -> None:
    """Advance the pose at body velocities (6,) in m/s and rad/s, corrected by the mean of bias and scale (paper, eq.
    14, 17; docs, "Move"), and d(x, y, psi)/d(bias, scale): through the heading at mid-interval, and through the
    speed."""
    (bias, scale), before, u = p.theta[-2:], p.pose, velocity.copy()
    u[YAW_RATE] -= bias
    u[SPEED] /= 1.0 + scale
    p.pose = integrate_pose(before, u, dt_s)
    east, north, _ = p.pose[:3] - before[:3]
    ahead = rotation(*(before[3:] + 0.5 * dt_s * u[3:]))[:2, 0]
    p.slope[:2] += np.outer([-north, east], p.slope[2] - [0.5 * dt_s, 0.0])
    p.slope[:2, 1] -= ahead * u[SPEED] * dt_s / (1.0 + scale)
    p.slope[2, 0] -= dt_s


def slopes(s: Floats) -> Floats:
    """Return d(position)/ds (3, 3) of s (3,) = range (m), azimuth and elevation (rad)."""
    rho, (ca, sa, ce, se) = s[0], (math.cos(s[1]), math.sin(s[1]), math.cos(s[2]), math.sin(s[2]))
    return np.array([
        [ce * ca, -rho * ce * sa, -rho * se * ca],
        [ce * sa, rho * ce * ca, -rho * se * sa],
        [se, 0.0, rho * ce],
    ])  # fmt: skip


def at_present(p: Particle, vt: Vt) -> tuple[Floats, Floats]:
    """Return s (3,) of a VT at the present theta, in m and rad, and its place in the world (3,) in m."""
    s = vt.mean + vt.gain @ (p.theta - vt.theta0)
    return s, vt.anchor + s[0] * unit_vector(s[1], s[2])


def predicted(p: Particle, vt: Vt) -> Prediction:
    """Return h and its Jacobians (paper, eq. 22-27), A = H G + H_pose G_pose + e_d e_b^T, and the spread of both (docs,
    "Predict")."""
    s, place = at_present(p, vt)
    by_place, by_pose = jacobians(p.pose, place)
    by_vt = by_place @ slopes(s)
    by_theta = by_vt @ vt.gain
    by_theta[:, -2:] += by_pose[:, PLANE] @ p.slope
    by_theta[0, vt.site] += 1.0
    z = predict(p.pose, place)
    z[0] += p.theta[vt.site]
    return Prediction(s, z, by_vt, by_theta, by_vt @ vt.covariance @ by_vt.T, by_theta @ p.covariance @ by_theta.T)


def innovation(z: Floats, expected: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Return which components were measured (3,), and by how much those differ from what is expected, in m and rad."""
    e, known = z - expected, ~np.isnan(z)
    e[1:] = wrap_angle(e[1:])
    return known, e[known]


def score(seen: Prediction, odds: float, values: Readings, k: int, gate: float) -> float:
    """Return log(r p_D N(e; 0, S + C + Q) / (lambda_c (1 - r p_D))) of a VT and measurement k, minus infinity outside
    the gate (docs, "Associate"; paper, eq. 33 and 35 with all terms). `odds`: log(r p_D / (lambda_c (1 - r p_D)))."""
    known, e = innovation(values.z[k], seen.z)
    s = (seen.spread + seen.shared + np.diag(values.single[k]))[np.ix_(known, known)]
    distance2 = e @ np.linalg.solve(s, e)
    if distance2 >= gate:
        return -math.inf
    return float(odds - 0.5 * (distance2 + np.linalg.slogdet(2.0 * np.pi * s)[1]) - values.gap[k])


def associated(scores: Floats) -> Ints:
    """Return the VT of each measurement (M,), -1 for none: the greatest sum of scores, of which none is taken that is
    not positive (paper, eq. 35 and the Hungarian algorithm).

    scores (V, M): log-likelihood ratios.
    """
    out = np.full(scores.shape[1], -1)
    vt, measurement = linear_sum_assignment(np.maximum(scores, 0.0), maximize=True)
    gains = scores[vt, measurement] > 0.0
    out[measurement[gains]] = vt[gains]
    return out


def updated(
    vt: Vt, seen: Prediction, odds: float, values: Readings, k: int, share: float, theta: Floats, y: Floats,
    information: Floats,
) -> float:  # fmt: skip
    """Update a VT by measurement k, add A^T S^-1 e to y and A^T S^-1 A to the information; return the log-weight: the
    fit in full, `share` of the evidence that the VT is there (docs, "Update", "Evidence lasts as errors do").

    Given theta: K = Sigma H^T S^-1, mu += K e, G -= K A, Sigma -= K H Sigma (paper, eq. 28-30, 32). theta and y (K,),
    information (K, K).
    """
    known, e = innovation(values.z[k], seen.z)
    h, a = seen.by_vt[known], seen.by_theta[known]
    s = (seen.spread + np.diag(values.many[k]))[np.ix_(known, known)]
    inverse = np.linalg.inv(s)
    gain = vt.covariance @ h.T @ inverse
    vt.mean, vt.gain, vt.theta0 = seen.s + gain @ e, vt.gain - gain @ a, theta
    vt.covariance = vt.covariance - gain @ h @ vt.covariance
    y += a.T @ inverse @ e
    information += a.T @ inverse @ a
    evidence = odds - 0.5 * np.linalg.slogdet(2.0 * np.pi * s)[1] - values.gap[k] + values.lack[k]
    return float(share * evidence - 0.5 * e @ inverse @ e)


def conditioned(p: Particle, y: Floats, information: Floats) -> float:
    """Condition theta on a snapshot, P_new = (P^-1 + I)^-1, theta += P_new y, move the pose along; return the evidence
    -log det(1 + I P) / 2 + y^T P_new y / 2, a log-weight (docs, "Nuisances").

    y (K,), information (K, K).
    """
    m = np.eye(len(y)) + information @ p.covariance
    p.covariance = p.covariance @ np.linalg.inv(m)
    change = p.covariance @ y
    p.theta = p.theta + change
    p.pose[PLANE] += p.slope @ change[-2:]
    return float(0.5 * (y @ change - np.linalg.slogdet(m)[1]))


def can_begin(z: Floats, offset: float) -> bool:
    """Say whether a measurement z (3,) shows where a VT would be; `offset` in m."""
    return bool(z[0] - offset > LEAST_RANGE_M and not np.isnan(z[1]))


def begun(p: Particle, site: int, z: Floats, variance: Floats, identity: int, now: int) -> Vt:
    """Return a VT born from a measurement: s is the direction turned to the world, Sigma = J Q J^T with J = ds/dz, G =
    ds/dtheta through the offset, -1 in range, and through what the pose owes to bias and scale (docs, "Births").

    z, variance (3,): in m and rad, and their squares.
    """
    body, variance = z.copy(), variance.copy()
    body[0] -= p.theta[site]
    if np.isnan(z[2]):
        body[2], variance[2] = 0.0, UNKNOWN_ELEVATION_RAD**2
    r = rotation(*p.pose[3:])
    s = np.array([body[0], *azimuth_elevation(r @ unit_vector(body[1], body[2]))])
    by_place = np.linalg.inv(slopes(s))
    j = by_place @ r @ slopes(body)
    gain = np.zeros((3, len(p.theta)))
    gain[0, site] = -1.0
    gain[:, -2:] = by_place[:, :2] @ p.slope[:2]
    gain[1, -2:] += p.slope[2]
    return Vt(identity, site, p.pose[:3].copy(), s, j * variance @ j.T, gain, p.theta, now)


def merged(p: Particle, vts: list[Vt], existing: Existence) -> list[Vt]:
    """Give up, of two confirmed VTs that are one, that which was seen less often (docs, "Merge").

    They are compared as they would be measured: e over S_1 + S_2 + (A_1 - A_2) P (A_1 - A_2)^T.
    """
    sure, dropped = [(vt, predicted(p, vt)) for vt in vts if existing.kind(vt) == 2], set[int]()
    for i, (one, seen) in enumerate(sure):
        for other, expected in sure[:i]:
            e, a = seen.z - expected.z, seen.by_theta - expected.by_theta
            s = seen.spread + expected.spread + a @ p.covariance @ a.T
            ahead, sine = math.cos(e[1]) > 0.0, np.array([e[0], *np.sin(e[1:])])
            alike = sine @ np.linalg.solve(s, sine) < MERGE_DISTANCE2 and (np.diag(s) < MERGE_STD**2).all()
            if ahead and alike and not dropped & {one.id, other.id}:
                dropped.add(other.id if one.hits > other.hits else one.id)
    return [vt for vt in vts if vt.id not in dropped]


def moments(particles: list[Particle], weights: Floats, best: int, sites: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return mean (6,) and covariance (6, 6) of the pose, mean and variance (S,) of the clock offsets: over particles,
    and within each, where the pose is r + G_pose (theta - theta_hat) (docs, "State").

    weights (N,) sum to 1. In m, rad and their squares.
    """
    mean, covariance = pose_moments(np.array([p.pose for p in particles]), weights, particles[best].pose)
    within = [p.slope @ p.covariance[-2:, -2:] @ p.slope.T for p in particles]
    covariance[np.ix_(PLANE, PLANE)] += np.tensordot(weights, within, 1)
    offsets = np.array([p.theta[:sites] for p in particles])
    own = np.array([np.diag(p.covariance)[:sites] for p in particles])
    offset = weights @ offsets
    return mean, covariance, offset, weights @ ((offsets - offset) ** 2 + own)


def mapped(p: Particle, existing: Existence) -> VtEstimate:
    """Return the confirmed VTs of a particle: x = x(mu), cov = J (Sigma + G P G^T) J^T."""
    sure = [(link, vt) for link, vts in enumerate(p.maps) for vt in vts if existing.kind(vt) == 2]
    known, covariance = [at_present(p, vt) for _, vt in sure], np.empty((len(sure), 3, 3))
    for i, (_, vt) in enumerate(sure):
        j = slopes(known[i][0])
        covariance[i] = j @ (vt.covariance + vt.gain @ p.covariance @ vt.gain.T) @ j.T
    ids, links = np.array([vt.id for _, vt in sure], np.int64), np.array([link for link, _ in sure], np.int64)
    return VtEstimate(ids, links, np.reshape([place for _, place in known], (-1, 3)), covariance)
