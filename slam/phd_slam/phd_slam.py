"""PHD-SLAM: the map of each particle is the intensity of a random finite set, a mixture of Gaussians.

State
    A particle is a path. Given it: the map, an intensity v(m) = sum_j w_j N(m; m_j + g_j (b - b_j), Sigma_j) with
    weights of visible and hidden VTs; a clock offset b ~ N of each site; bias and scale of the odometry, Gaussian.
                                                        map_kernel.py: Map; snapshot_kernel.py: Particles
Recursion, for odometry u and the snapshot Z = {z_k}
    predict     w visible <- stay w visible + back w hidden, and the reverse        map_kernel.py: come_and_go
                velocity ~ N(mu, diag sigma^2) by odometry, bias and scale          motion_kernel.py: predict_velocity
    draw        from its density given Z, linearised at its mean: information I + sum_p share_p A^T S^-1 A, A = dh/d(x),
                x in deviations of the velocity; share_p of exclusive pairs         snapshot_kernel.py: _move, _inform
                bias and scale are conditioned on the draw                          motion_kernel.py: learn
    pair        odds_jk = p_D(m_j) w_j N(z_k - h(m_j); 0, S) / clutter              pairs_kernel.py: pair_up
    clocks      P <- P / (1 + I P),  b <- b + P y                                   snapshot_kernel.py: _learn_offsets
    update      detected: weight odds_jk / (1 + sum_i odds_ik), mean and covariance by Kalman's update
                missed:   weight (1 - p_D(m_j)) w_j;  born: birth / (1 + sum_i odds_ik)           _updated, give_birth
    merge       Gaussians that are near, and drop those of little weight            map_kernel.py: condense
Weight of a particle
    log w <- log w + log (prior / density of the draw) + new (sum_k log (1 + sum_j odds_jk) - sum_j p_D(m_j) w_j)
                                                                                    _move, _update
    with the cost of moving the clocks; new: share of the evidence that is not a repetition of the last snapshot's
    resampled if the effective sample size is small                                                 _conclude

Sources: Mullane, Vo, Adams and Vo, "A random-finite-set approach to Bayesian SLAM", IEEE Trans. Robotics 27(2), 2011;
Kaltiokallio et al., "A multihypotheses importance density for SLAM in cluttered scenarios", IEEE Trans. Robotics 40,
2024.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field
from scipy.special import ndtri

from cellslam.sim.randomness import quasi_random
from cellslam.sim.recording import Floats, Ints
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.measurements.attitude import Attitude
from cellslam.slam.measurements.fusion import FusedMeasurements, Fusion
from cellslam.slam.measurements.measurement_options import MeasurementOptions, transitions
from cellslam.slam.measurements.misfit import Misfit
from cellslam.slam.measurements.readings import Readings, novelty, ports_of, readings
from cellslam.slam.model.pose_moments import pose_moments
from cellslam.slam.model.resampling import systematic
from cellslam.slam.phd_slam import map_kernel as columns
from cellslam.slam.phd_slam.map_kernel import LINK, LOG_TURN, MISSING, NAME, Map, Measured
from cellslam.slam.phd_slam.motion_kernel import Interval
from cellslam.slam.phd_slam.pairs_kernel import Matching, Upkeep, Visibility
from cellslam.slam.phd_slam.snapshot_kernel import Particles, resample, use_snapshot

CAPACITY = 64  # Gaussians that there is room for at the start; doubled when needed
DRIFT_SCALE_S = 1.0  # an offset that drifts is taken to walk: so far in so long as its rate says
ANCHOR_STD_M = 1e-3
SURVEYED = 1000.0  # detections that a surveyed transmitter counts as
TRIANGLE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
UNKNOWN_M = 1e5  # reach of a front end that measures no distances


class PhdSlamOptions(MeasurementOptions):
    """What a scenario may set under `estimator.phd-slam`, beside what the front end is like."""

    particles: int = Field(100, ge=1, le=100_000, description="number of particles")
    effective_share: float = Field(
        0.5, ge=0, le=1, description="resample when the effective sample size falls below this share of the particles"
    )
    iterations: int = Field(2, ge=1, le=20, description="linearisations of the importance density of the motion")
    offset_component_std_m: float = Field(
        20.0, gt=0, le=1000, description="width of one particle's clock-offset component at the start, m"
    )
    drop_weight: float = Field(1e-4, gt=0, lt=1, description="a Gaussian of the map of less weight is dropped")
    merge_distance2: float = Field(
        10.0, gt=0, le=1000, description="squared Mahalanobis distance up to which Gaussians of the map are merged"
    )
    components: int = Field(4096, ge=16, le=65536, description="Gaussians kept in a particle's map at most")


class FieldOfView:
    """Of each link the farthest distance (m) and the largest azimuth to either side (rad) measured so far, and the
    variances of both: `limits` (L, 4). Nothing is missed where nothing is ever seen.

    Source: Mullane et al. (2011): probability of detection as a function of pose and place.
    """

    def __init__(self, links: int) -> None:
        self.limits: Floats = np.tile([0.0, 0.0, 1.0, 1e-4], (links, 1))

    def widen(self, link: Ints, values: Readings) -> None:
        """Take the measurements of a snapshot, their links (m,), into account, in m and rad; a component that is not
        measured has no limit."""
        reach, span = np.nan_to_num(values.z[:, 0], nan=UNKNOWN_M), np.nan_to_num(np.abs(values.z[:, 1]), nan=np.pi)
        np.maximum.at(self.limits[:, 0], link, reach)
        np.maximum.at(self.limits[:, 1], link, span)
        self.limits[link, 2:] = values.single[:, :2]


class PhdSlam:
    """Rao-Blackwellised PHD filter: particles of the vehicle's path, and in each a Gaussian-mixture PHD of the VTs."""

    name: ClassVar[str] = "phd-slam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[PhdSlamOptions]] = PhdSlamOptions

    def __init__(self, options: PhdSlamOptions | None = None) -> None:
        self.options = options or PhdSlamOptions()

    def warm_up(self) -> None:
        """Compile the kernels, on a drive of four snapshots."""
        warm_up.drive(type(self)(self.options.model_copy(update={"particles": 4, "effective_share": 1.0})))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw the prior: poses, and components of each clock offset's prior."""
        self._fusion = Fusion(setup, self.options)
        self._options, self._rng = self._fusion.options, rng
        links, sites = self._fusion.setup.links, setup.sites
        self._site_of = np.array(links.site, np.int64)
        self._port_of = ports_of(links.site, links.port)
        self._model, self._drift = setup.odometry_model, np.array(sites.drift_std_m_s, np.float64)
        self._view = FieldOfView(len(links))
        self._attitude, self._misfit = Attitude(self._options, self._fusion.setup), Misfit(self._options)
        self._particles = self._drawn(setup)
        self._born = len(links)  # anchors have the first identities

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Draw velocities, update maps, weigh, and resample if needed.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        o, p = self._options, self._particles
        measurements = self._fusion.fuse(snapshot)
        turned, moved = odometry[3] * dt_s, odometry[0] * dt_s
        level = self._attitude.levelled(dt_s, measurements)
        values = self._misfit.widened(readings(level, self._port_of, o, turned, moved), dt_s)
        self._view.widen(measurements.link, values)
        noise, walk = np.array(self._model.noise_density), np.array(self._model.bias_walk_density)
        interval = Interval(dt=float(dt_s), measured=np.array(odometry, np.float64), noise=noise, walk=walk)
        rules, clock_walk = self._rules(dt_s, novelty(o, turned, moved)), self._drift**2 * dt_s * DRIFT_SCALE_S
        association = np.empty((len(p.pose), len(measurements)), np.int64)
        measured = self._measured(measurements, values)
        use_snapshot(p, interval, measured, *rules, clock_walk, self._draws(), association)
        self._born += len(measurements)
        return self._fusion.answer(self._conclude(association, measurements, values), measurements)

    def _drawn(self, setup: Setup) -> Particles:
        o, model, sites = self._options, setup.odometry_model, setup.sites
        n = o.particles
        component = np.minimum(sites.clock_offset_std_m, o.offset_component_std_m)
        between = np.sqrt(sites.clock_offset_std_m**2 - component**2)
        offset = sites.clock_offset_mean_m + between * ndtri(quasi_random(n, len(sites), self._rng))
        empty = _empty_map(n, max(CAPACITY, 2 * len(self._site_of)))
        _put_anchors(empty, self._fusion.setup)
        error_variance = np.stack([model.bias**2, np.zeros(6), model.scale**2], axis=1)
        return Particles(
            pose=setup.start_pose + setup.start_std * self._rng.standard_normal((n, 6)),
            error=np.zeros((n, 6, 2)), error_variance=np.tile(error_variance, (n, 1, 1)), offset=offset,
            variance=np.tile(component**2, (n, 1)), log_weight=np.zeros((n, 1)), **empty._asdict(),
        )  # fmt: skip

    def _draws(self) -> Floats:
        """Draw normal numbers (N, 6) whose mean over the particles is zero: one particle goes by the mean."""
        drawn = self._rng.standard_normal((len(self._particles.pose), 6))
        drawn -= drawn.mean(axis=0)
        return drawn

    def _measured(self, measurements: FusedMeasurements, values: Readings) -> Measured:
        """Return a snapshot as the kernels take it."""
        known = np.isfinite(values.z)
        missing = 0.5 * (LOG_TURN + np.log(MISSING)) * np.sum(~known, axis=1)
        single, many, fresh = (np.where(known, q, MISSING) for q in (values.single, values.many, values.fresh))
        gain = missing - values.gap - np.log(self._options.clutter_density)
        link = np.array(measurements.link, np.int64)
        return Measured(
            z=np.where(known, values.z, 0.0), known=known.astype(np.float64), single=single, many=many, fresh=fresh,
            gain=gain, link=link, first=np.searchsorted(link, np.arange(len(self._site_of) + 1)),
            begins=np.array(measurements.begins), born=self._born,
        )  # fmt: skip

    def _rules(self, dt_s: float, new: float) -> tuple[Visibility, Upkeep, Matching]:
        o = self._options
        stay, back = transitions(o, dt_s)
        return (
            Visibility(detection=o.detection_probability, stay=stay, back=back, limits=self._view.limits),
            Upkeep(birth=o.birth_ratio, drop=o.drop_weight, merge=o.merge_distance2),
            Matching(gate=o.gate, iterations=o.iterations, new=new, site_of=self._site_of),
        )

    def _conclude(self, association: Ints, measurements: FusedMeasurements, values: Readings) -> Estimate:
        p = self._particles
        best = int(np.argmax(p.log_weight))
        weight = np.exp(p.log_weight[:, 0] - p.log_weight[best, 0])
        weight /= weight.sum()
        mean, covariance = pose_moments(p.pose, weight, p.pose[best])
        offset = weight @ p.offset
        variance = weight @ ((p.offset - offset) ** 2 + p.variance)
        vts = self._reported(best)
        own = np.where(np.isin(association[best], vts.id), association[best], -1)
        answer = Estimate(mean, covariance, own, offset, variance, vts)
        pose = p.pose[best].copy()
        self._misfit.learn(answer, values, pose)
        answer = self._attitude.concluded(answer, measurements, values.many, pose)
        if 1.0 / np.sum(weight**2) < self._options.effective_share * len(weight):
            resample(p, systematic(weight, len(weight), self._rng))
        self._reserve()
        return answer

    def _reported(self, particle: int) -> VtEstimate:
        """Return the Gaussians of a particle that are VTs rather than clutter."""
        p = self._particles
        count = int(p.size[particle, 0])
        rows, names = p.rows[particle, :count], p.names[particle, :count]
        weight = rows[:, columns.VISIBLE] + rows[:, columns.HIDDEN]
        sure = np.flatnonzero(rows[:, columns.HITS] >= self._options.confirm_hits)
        # Of Gaussians that have come of one, the weightiest is reported.
        sure = sure[np.argsort(-weight[sure], kind="stable")]
        sure = sure[np.unique(names[sure, NAME], return_index=True)[1]]
        rows, names = rows[sure], names[sure]
        gain, own = rows[:, columns.GAIN : columns.VISIBLE], rows[:, columns.COVARIANCE : columns.GAIN][:, TRIANGLE]
        clock = p.variance[particle, self._site_of[names[:, LINK]]]
        covariance = own + clock[:, None, None] * gain[:, :, None] * gain[:, None, :]
        position = rows[:, columns.MEAN : columns.COVARIANCE].copy()
        return VtEstimate(names[:, NAME].copy(), names[:, LINK].copy(), position, covariance)

    def _reserve(self) -> None:
        """Double the room for Gaussians where a map is half full."""
        p, (n, capacity) = self._particles, self._particles.names.shape[:2]
        if 2 * p.size.max() > capacity and capacity < self._options.components:
            new = _empty_map(n, min(2 * capacity, self._options.components))
            new.rows[:, :capacity], new.names[:, :capacity], new.size[:] = p.rows, p.names, p.size
            self._particles = p._replace(rows=new.rows, names=new.names, size=new.size)


def _put_anchors(empty: Map, setup: Setup) -> None:
    """Begin every map with the transmitters that are known before the drive."""
    known, position_m, std_m = setup.surveyed
    rows, names = empty.rows[:, : len(known)], empty.names[:, : len(known)]
    rows[:, :, columns.MEAN : columns.COVARIANCE] = position_m
    rows[:, :, columns.COVARIANCE + np.diag(TRIANGLE)] = std_m**2 + ANCHOR_STD_M**2
    rows[:, :, columns.VISIBLE], rows[:, :, columns.HITS] = 1.0, SURVEYED
    names[:, :, LINK] = names[:, :, NAME] = known
    empty.size[:] = len(known)


def _empty_map(particles: int, capacity: int) -> Map:
    """Return empty maps."""
    shape = particles, capacity
    return Map(
        rows=np.zeros((*shape, columns.WIDTH)), names=np.zeros((*shape, columns.NAMES), np.int64),
        size=np.zeros((particles, 1), np.int64),
    )  # fmt: skip
