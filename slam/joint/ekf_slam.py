"""EKF-SLAM: one Gaussian over pose, odometry errors, clock offsets, VTs, and errors of measurements that persist.

State
    x ~ N(x, P): pose (6), sway of the array, ground, odometry biases b and scales s, sum of the odometry's noise, clock
    offsets and their rates, errors of a remembered map; then, as they are met, weights of the fields of direction, and
    of each VT range, azimuth, elevation about the pose of its birth, and its diffuse errors   state/layout.py: Core,
    Filter (`x`, `p`), Vts, FieldWeights; what enters and leaves: state/states_kernel.py

Recursion, for odometry u over dt with white noise of density q, and measurements z = h(x) + v, v ~ N(0, R)
    predict     pose <- pose + (u - b) / (1 + s) dt in the frame of the middle heading
                                                                          snapshot/motion_kernel.py: move
                P <- F P F^T + Q,  Q = B diag(q^2 / dt) B^T               _spread; clock offsets: _drift
    pair        e = z - h(x),  S = H P H^T + R,  score log N(e; 0, S) p / ((1 - p) clutter),  p: of being detected
                the best sum of scores of one-to-one pairs                snapshot/association_kernel.py: associate
                in place of it: marginals of all associations (BP-SLAM)   snapshot/association_kernel.py: believe
    average     e of each VT over a block of at most 0.6 s                snapshot/snapshot_kernel.py: take_in
    update      S = L L^T,  G = L^-1 H P,  x <- x + G^T L^-1 e,  P <- P - G^T G
                                                                          snapshot/update_kernel.py: correct, add_up
    slip, step  of wheels and clocks, as a block shows them   snapshot/steps_kernel.py: take_slip, take_steps
    carry over  P to the new estimate, in directions that nothing measured shows
                                                                          snapshot/gauge_kernel.py: carry_over
    begin, drop VTs: augmented by the inverse of h, marginalised          snapshot/birth_kernel.py

Weight of filter i of a mixture (wide clock offsets: start.py)
    log w_i = rest_i + sum over paths of max(a_i - max_k a_k, -MOST),  a_i = max(l_i - BIRTH, 0)
                                                                          influence.py: bounded
    l: log-ratio of the likelihood of a path's measurements to that of clutter; rest: the prior, steps of clocks

Sources: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics" (1990), for the joint
covariance; Bar-Shalom, Li and Kirubarajan (2001), section 5, for the filter; Higdon, "A process-convolution approach to
modelling temperatures in the North Atlantic Ocean" (1998), for fields of direction as states; measurement model and
births are those of the extended FastSLAM (paper, section IV, corrected).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from cellslam.sim.compiling import is_compiled
from cellslam.sim.frames.frames_kernel import wrap
from cellslam.sim.recording import Floats, Ints, Links
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.joint.calibration_states import begin_with, found
from cellslam.slam.joint.ekf_slam_options import EkfSlamOptions
from cellslam.slam.joint.map_check import MapCheck
from cellslam.slam.joint.map_states import Box, Observed, Remembered, map_after
from cellslam.slam.joint.mixture import KNOWN, Mixture, vt_estimate
from cellslam.slam.joint.new_filters import LONGEST, MOST_STATES, array_errors, core_of, new_mixture
from cellslam.slam.joint.sizes import Sizes, growth, sizes_of
from cellslam.slam.joint.snapshot import snapshot_kernel
from cellslam.slam.joint.snapshot.birth_kernel import births
from cellslam.slam.joint.snapshot.motion_kernel import Interval
from cellslam.slam.joint.start import START_STATES, Start, begin, width_of_components
from cellslam.slam.joint.state.layout import (
    ENTRY,
    FREE,
    HITS,
    IDENT,
    KIND,
    POSITION,
    SPREAD,
    ArrayErrors,
    Association,
    BlockLimits,
    Lifetime,
    Measured,
    Noise,
    Rules,
)
from cellslam.slam.measurements.fusion import FusedMeasurements, Fusion
from cellslam.slam.measurements.measurement_options import existence
from cellslam.slam.measurements.readings import Readings, novelty, white_readings
from cellslam.slam.model.calibration import Calibration
from cellslam.slam.model.vt_map import VtMap

NOT_GIVEN, NO_VTS = -2, np.empty((0, ENTRY))
# Accelerations of a vehicle whose odometry is silent, in m/s^2 and rad/s^2; it neither climbs nor tilts.
HELD = np.array([0.6, 0.0, 0.0, 0.1, 0.0, 0.0])
BLOCK_M, TURN = 0.6, np.radians(2.0)  # a block of snapshots ends after so long a distance or turn
AWAY_S = 3.0  # a VT that was not seen for so long returns, if it is seen again
AGAIN = 1.25  # filters of all sites that did not agree with the start are tried again after so many times as long
GROW_EVERY, MOST_GROWN = 64, 5.0  # snapshots; times as large as assumed
FULL = (
    "the state is full: measurements began no more VTs and errors; lower vts or hold_s, or raise calibration_scale_deg "
    "or roof_scale_deg"
)
REFUTED = 5.0  # deviations by which measurements move a site off its survey, so that the survey is called wrong
NEXT_TO_M = 10.0  # a VT so near to a site that is seldom measured itself is this site: no wall is half as near
LEAST_SHOWN = 0.01  # of its variance, that is expected to be shown at least: a share too small is rounding
EVIDENCE = 0.0125  # least share of detections and misses that is news: what hides a VT lasts for seconds


class JointFilter:
    """What EKF-SLAM, its oracles, BP-SLAM, WALL-SLAM and FastSLAM share: one joint covariance, after a Gaussian sum."""

    name: ClassVar[str]
    requires_truth: ClassVar[bool] = False
    mode: ClassVar[int] = FREE
    grows: bool = True  # diffuse errors that are surely larger than assumed are taken for as large as they are
    options: EkfSlamOptions

    def __init__(self, options: Any = None) -> None:
        self.options = options or EkfSlamOptions()

    @staticmethod
    def compiled() -> bool:
        """Return whether the kernels have been compiled before, and are in Numba's cache."""
        return is_compiled(snapshot_kernel.__name__, Path(snapshot_kernel.__file__))

    def warm_up(self) -> None:
        """Compile every kernel on a made-up drive of four snapshots."""
        warm_up.drive(self._alike(start_limit_s=0.1))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior; nothing is drawn. With a map a filter without it runs beside, until it is sure that it
        fits."""
        self._fusion = Fusion(setup, self.options)
        self._setup, self._time_s, self._now = _writable(self._fusion.setup), 0.0, 0
        known, links = self._setup.map, self._setup.links
        self._remembered = None if known is None else Remembered(known, links, self._setup.sites.name, len(links))
        self._seen: dict[int, Box] = {}
        self._archive, self._again_s, self._grown = NO_VTS, 0.0, 1.0
        self._born = len(links) + (0 if known is None else len(known))
        self._errors = array_errors(self.options, setup)
        self._scatterers = setup.scatterers if self.options.scatterers is None else self.options.scatterers
        self._core = core_of(self._setup, self._errors, self._drawn_blocks)
        self._past: list[tuple[Interval, Measured]] = []
        self._beside: tuple[JointFilter, MapCheck] | None = None
        self._instead: JointFilter | None = None  # the filter without the map, once the map is rejected
        self._misfit: list[str] = []
        if known is not None:
            without = self._alike()
            without.start(replace(setup, map=None), rng)
            without._born = self._born  # so that new VTs have one identity in both
            self._beside = without, MapCheck(range(len(links), self._born))
        self._by_step: dict[int, tuple[Floats, Rules]] = {}
        self._elevation_variance = math.radians(self.options.elevation_std_deg) ** 2
        sites = self._setup.sites
        wide, given = width_of_components(sites.clock_offset_std_m, self.options), self.options.component_std_m
        if wide > given:
            share = wide / self.options.typical_range_m
            self.options = self.options.model_copy(update={"component_share": share})
            self._misfit.append(
                f"clock offsets so uncertain take components of {wide:.0f} m, not {given:g} m, to fit into memory: "
                "give smaller clock_offset_std_m where the offsets are known better"
            )
        self._start: Start | None = None
        self._vts: VtEstimate | None = None
        self._joint: Mixture | None = None
        if (sites.clock_offset_std_m > wide).any():
            self._start = begin(self._setup, self._core, self._errors, self.options)
            for mixture in self._start.mixtures:
                self._install(mixture)
        else:
            self._join(np.array(sites.clock_offset_mean_m, float)[None])

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Predict, associate, update.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        if self._instead is not None:
            return self._instead.step(dt_s, odometry, snapshot)
        answer = self._step(dt_s, odometry, snapshot)
        if self._beside is None:
            return answer
        without, check = self._beside
        other = without.step(dt_s, odometry, snapshot)
        check.take(answer, other, self._nis, resolved=self.resolved, resolved_without=without.resolved)
        if check.rejected:
            without._misfit = [check.rejected]
            self._instead, self._beside, self._start, self._joint = without, None, None, None
        elif check.over:
            self._beside = None
        return answer if check.accepted else other

    @property
    def _valid(self) -> JointFilter:
        """The filter that answers: this one, or that without the map, once the map is rejected."""
        return self if self._instead is None else self._instead

    @property
    def resolved(self) -> bool:
        """Whether the clock offsets are known well enough for one filter of all sites."""
        return self._valid._joint is not None

    @property
    def _nis(self) -> Floats:
        """The sums of `learnt.nis` (2,) of the likeliest filters."""
        mixtures = self._start.mixtures if self._start is not None else [self._joint] if self._joint is not None else []
        return np.asarray(np.sum([mixture.likeliest.learnt.nis for mixture in mixtures], axis=0))

    def _step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        self._time_s += dt_s
        odometry, measurements, model = np.array(odometry), self._fusion.fuse(snapshot), self._setup.odometry_model
        measured = self._measured(dt_s, odometry, self._readings(dt_s, odometry, measurements), measurements)
        noise = model.noise_density
        if snapshot.odometry_held_s is not None:
            noise = np.hypot(noise, held_noise(np.array(snapshot.odometry_held_s)))
        interval = Interval(dt_s, odometry, noise, model.bias_walk_density)
        if self._start is not None:
            answer = self._step_start(self._start, interval, measured)
        else:
            answer = self._step_joint(interval, measured)
        self._now += 1
        self._born += len(measurements)
        return self._fusion.answer(answer, measurements)

    def sizes(self) -> Sizes:
        """Return what the drive so far says of the sizes of errors: noise, array, odometry.

        Raises RuntimeError while the clock offsets are wide.
        """
        own = self._valid
        if own._joint is None:
            raise RuntimeError("sizes are learnt once the clock offsets are resolved")
        return sizes_of(own._joint.collapsed(), own._errors, own._setup.odometry_model.noise_density, own._grown)

    def remarks(self) -> list[str]:
        """Return what the drive says against the sizes of errors that the filter assumes, its map and surveys."""
        own = self._valid
        if own._joint is None:
            return own._misfit
        full = [FULL] if own._joint.full else []
        return own._misfit + full + self.sizes().remarks() + own._refuted_surveys()

    def calibration(self) -> Calibration | None:
        """Return the array's calibration as the drive has shown it; None where it is no state.

        While the clock offsets are wide the drive has shown nothing: what the filter began with.
        """
        mixture = self._valid._joint
        if mixture is None or not self._errors.calibration.any():
            return self.options.known_calibration
        return found(mixture.collapsed(), self._errors)

    def vt_map(self) -> VtMap | None:
        """Return the map that the drive leaves; while the clock offsets are wide the one that it began with."""
        own = self._valid
        mixture = own._joint
        if mixture is None:
            return own._setup.map
        observed = Observed(links=own._setup.links, sites=own._setup.sites.name, seen=own._seen)
        return map_after(
            mixture.collapsed().likeliest, own._archive, observed, mixture.remembered, self.options.confirm_hits
        )

    def _given(self, measurements: FusedMeasurements) -> Ints:
        """Return the true VT of each measurement, for the oracle that knows it."""
        return np.full(len(measurements), NOT_GIVEN, np.int64)

    def _install(self, mixture: Mixture) -> None:
        """Put into new filters what is known of the map: transmitters that were surveyed; VTs of a remembered map will
        come."""
        mixture.remembered = None if self._remembered is None else self._remembered.afresh()
        link, position_m, std_m = self._setup.surveyed
        if len(link):
            mixture.know(link, self._surveyed_idents(link), position_m, std_m, 0)

    def _surveyed_idents(self, link: Ints) -> Ints:
        """Return the identities that the surveyed transmitters of some links (n,) have as VTs."""
        return link

    def _refuted_surveys(self) -> list[str]:
        """Return which surveys the measurements contradict, in a line for each site.

        From the covariance P_0 of a survey to the P that is left, an estimate moves by N(0, P_0 - P). A transmitter
        that is measured more often beside its survey than there, stands beside.
        """
        assert self._joint is not None
        mixture, sites = self._joint.collapsed(), self._setup.sites
        out: dict[str, tuple[float, float]] = {}
        rows, f = mixture.vts(mixture.best, self.options.confirm_hits), mixture.likeliest
        slots = f.vts.slots[: f.count[0]]
        hits = dict(zip(slots[:, IDENT].tolist(), slots[:, HITS].tolist(), strict=True))
        for link, place, std in zip(*self._setup.surveyed, strict=True):
            (ident,), on_link = self._surveyed_idents(np.array([link])), rows[rows[:, 1] == link]
            own = on_link[on_link[:, 0] == ident]
            if not len(own):  # it is not confirmed: its measurements do not fit any place
                continue
            beside = [row[POSITION:SPREAD] for row in on_link if row[0] != ident and hits[row[0]] > hits[ident] - KNOWN]
            moved, left2 = own[0, POSITION:SPREAD] - place, np.diag(own[0, SPREAD:KIND].reshape(3, 3))
            expected = np.sqrt(np.maximum(std**2 - left2, LEAST_SHOWN * std**2))
            refuted = bool((np.abs(moved) > REFUTED * expected)[std > 0.0].any())
            off = float(np.linalg.norm(moved))
            if beside and (apart := float(np.linalg.norm(np.array(beside) - place, axis=1).min())) < NEXT_TO_M:
                off, refuted = apart, True
            if refuted:
                out[sites.name[self._setup.links.site[link]]] = off, float(std.max())
        return [
            f"the survey of site {name}, with deviations of {std:g} m, is off by {off:.1f} m or more, as measurements "
            "have it: state larger deviations (position_std_m), or leave the survey out"
            for name, (off, std) in out.items()
        ]

    def _alike(self, **changes: Any) -> Self:
        """Return another filter of the same kind, with some options changed."""
        return type(self)(self.options.model_copy(update=changes))

    @property
    def _drawn_blocks(self) -> int:
        """Of how many blocks the odometry's noise is a part of the state, since it will be drawn."""
        return 0

    def _jumps(self, rules: Rules) -> Rules:
        """Return rules by which clocks may step, and wheels slip: while offsets are wide, both would explain what a
        wrong offset is off by."""
        step, slip = self.options.step_probability, self.options.slip_probability
        if self._start is None:
            rules = rules._replace(
                step=math.log(step) if step > 0.0 else -math.inf,
                slip=math.log(slip / (1.0 - slip)) if slip > 0.0 else -math.inf,
            )
        return rules

    def _map(self, filters: Sequence[tuple[Mixture, int]]) -> VtEstimate | None:
        """Return the confirmed VTs of some filters of mixtures, with those that were displaced."""
        rows = np.concatenate([*(mixture.vts(i, self.options.confirm_hits) for mixture, i in filters), self._archive])
        known = self._setup.map
        if known is not None:
            unseen = np.setdiff1d(len(self._setup.links) + np.arange(len(known)), list(self._seen))
            rows = rows[~np.isin(rows[:, 0], unseen)]
        return vt_estimate(rows)

    def _rules(self, common: Rules, dt_s: float) -> Rules:
        """Return the common options of the kernels with what they need beside."""
        return common

    def _step_start(self, start: Start, interval: Interval, measured: Measured) -> Estimate:
        """Use a snapshot in the mixtures of the start; once it is over, go through all snapshots again."""
        self._past.append((interval, measured))
        association = start.use(interval, measured)
        moments = start.moments()
        mean, covariance = start.pose(*moments)
        offset, variance = start.offsets(*moments)
        late = self._time_s >= self.options.start_limit_s
        if late or (start.over(variance) and self._time_s >= self._again_s):
            self._take_over(start, late)
        return _estimate(mean, covariance, association, offset, variance, self._map(start.likeliest()))

    def _take_over(self, start: Start, late: bool) -> None:
        """End the start with filters of all sites, that have gone through the drive so far, if they agree with it; or
        late, whether they do or not. If they do not, they have gone wrong, and will be tried again."""
        self._start, grown, offsets = None, 0.0, start.combinations()
        while grown < self._grown:  # with diffuse errors as large from the beginning as they are found to be at the end
            grown = self._grown
            self._join(offsets)
            for past in self._past:
                self._use(*past)
        if late or (self._joint is not None and start.agrees(self._joint.moments()[0])):
            self._past = []
        else:
            self._start, self._joint, self._again_s, self._grown = start, None, AGAIN * self._time_s, 1.0

    def _step_joint(self, interval: Interval, measured: Measured) -> Estimate:
        association = self._use(interval, measured)
        mixture = self._joint
        if mixture is None:
            raise RuntimeError("step() was called before start()")
        best, offsets = mixture.best, self._core.offsets
        mean, cov = mixture.moments()
        if self._vts is None or not mixture.blocks.track.snapshots[0, 0]:  # VTs move as a block ends
            self._vts = self._map([(mixture, best)])
        variance = np.maximum(np.diag(cov)[offsets], 0.0)
        return _estimate(mean, cov, association[best].copy(), mean[offsets], variance, self._vts)

    def _join(self, offsets_m: Floats) -> None:
        """Begin the filters of all sites with these combinations of clock offsets (K, S), as likely as each other: what
        has shown one to be likelier they go through again."""
        self._seen, self._archive, self._vts = {}, NO_VTS, None
        std = np.minimum(self._setup.sites.clock_offset_std_m, self.options.component_std_m)
        states = MOST_STATES if len(offsets_m) == 1 else START_STATES
        self._joint = new_mixture(self._setup, self._core, self._errors, offsets_m, std, self.options.vts, states)
        self._install(self._joint)
        if self.options.known_calibration is not None:
            begin_with(self._joint, self._errors, self.options.known_calibration)

    def _use(self, interval: Interval, measured: Measured) -> Ints:
        """Use a snapshot in the filters of all sites; return the associations (K, m)."""
        mixture = self._joint
        if mixture is None:
            raise RuntimeError("step() was called before start()")
        if self.options.merge_rate == 0.0:
            measured = measured._replace(noise=measured.noise._replace(merged=np.zeros(3)))
        errors = self._errors._replace(diffuse=self._grown * self._errors.diffuse)
        association = self._go_on(mixture, errors, interval, measured)
        if self.grows and measured.now % GROW_EVERY == GROW_EVERY - 1:
            self._grown = min(self._grown * growth(mixture), MOST_GROWN)
        best = mixture.best
        lost = mixture.lost(best)
        if len(lost):
            self._archive = np.concatenate([self._archive, lost])
        self._see(association[best], mixture.arrays.x[best, :2])
        if len(mixture) > 1 and not mixture.blocks.track.snapshots[0, 0]:
            kept = np.sort(mixture.apart(slice(0, self._core.size), self.options.prune_ratio, more=True))
            if len(kept) < len(mixture):
                mixture.keep(kept)
                association = association[kept]
        return association

    def _go_on(self, mixture: Mixture, errors: ArrayErrors, interval: Interval, measured: Measured) -> Ints:
        """Move all filters of a mixture by an interval, and use a snapshot; return the associations (K, m)."""
        return mixture.use(errors, interval, measured, self.options.vts)

    def _see(self, association: Ints, place: Floats) -> None:
        """Note from where the VTs of some measurements are seen."""
        x, y = place.tolist()
        for ident in association[association >= 0].tolist():
            least, greatest = self._seen.setdefault(ident, ([x, y], [x, y]))
            least[:] = min(least[0], x), min(least[1], y)
            greatest[:] = max(greatest[0], x), max(greatest[1], y)

    def _readings(self, dt_s: float, odometry: Floats, measurements: FusedMeasurements) -> Readings:
        """Return the measurements with their variances."""
        return white_readings(measurements, self._fusion.options, odometry[3] * dt_s, odometry[0] * dt_s)

    def _measured(self, dt_s: float, odometry: Floats, v: Readings, measurements: FusedMeasurements) -> Measured:
        step_s = self._step_s = dt_s if dt_s > 0.0 else 0.075
        key = round(100.0 * math.log(step_s))
        if key not in self._by_step:
            self._by_step[key] = self._tables(step_s)
        (tables, rules), site = self._by_step[key], self._setup.links.site
        first = np.searchsorted(measurements.link, np.arange(len(site) + 1))  # of each link, and behind the last
        news = novelty(self._fusion.options, odometry[3] * dt_s, odometry[0] * dt_s)
        rules = self._jumps(rules._replace(evidence=max(EVIDENCE, news)))
        return Measured(
            now=self._now, born=self._born, first=first, site_of=site,
            given=self._given(measurements), z=v.z, gap=v.gap, tables=tables,
            noise=Noise(single=v.single, many=v.many, merged=v.merged, diffuse=1.0 / np.sqrt(measurements.ports)),
            births=births(v.z, v.fresh, measurements.begins, self._elevation_variance, rules.scatterers), rules=rules,
        )  # fmt: skip

    def _tables(self, step_s: float) -> tuple[Floats, Rules]:
        """Return what depends on the length of a step alone: the tables of existence, and the rules."""
        o = self._fusion.options
        tables, once, twice = existence(o, step_s)
        rules = Rules(
            association=Association(
                mode=self.mode, log_clutter=float(np.log(o.clutter_density)), gate=o.gate,
                return_log_odds=math.log(o.return_odds), away=max(round(AWAY_S / step_s), 1),
            ),
            lifetime=Lifetime(
                confirm=o.confirm_hits, age_once=once, age_twice=twice, hold=int(o.hold_s / step_s)
            ),
            blocks=BlockLimits(
                snapshots=min(max(round(o.block_s / step_s), 1), LONGEST), distance=BLOCK_M, turn=TURN
            ),
            evidence=EVIDENCE, merge_rate=o.merge_rate, scatterers=self._scatterers,
        )  # fmt: skip
        return tables, self._rules(rules, step_s)


def held_noise(held_s: Floats) -> Floats:
    """Return the noise densities (6,) of velocities that have been held so long (6,) in s.

    A constant unknown acceleration a moves the vehicle by a t^2 / 2 in t: white noise of density a t^1.5 has the same
    variance at any time. Source: own derivation.
    """
    return np.asarray(HELD * held_s**1.5)


class EkfSlam(JointFilter):
    """EKF-SLAM: hard association by the Hungarian algorithm.

    Pairs are scored against clutter, missed detections and births as in docs/explanation/estimators.md.
    """

    name: ClassVar[str] = "ekf-slam"
    Options: ClassVar[type[EkfSlamOptions]] = EkfSlamOptions


def _estimate(
    mean: Floats, cov: Floats, association: Ints, offset: Floats, variance: Floats, vts: VtEstimate | None
) -> Estimate:
    square, pose = cov[:6, :6], mean[:6].copy()
    pose[3:] = [wrap(angle) for angle in pose[3:].tolist()]
    return Estimate(pose, 0.5 * (square + square.T), association, offset.copy(), variance.copy(), vts)


def _writable(setup: Setup) -> Setup:
    """Return a setup whose arrays can be written: kernels are compiled for such arrays alone."""
    links, model = setup.links, setup.odometry_model
    site, cell, port = (np.array(c, np.int64) for c in (links.site, links.cell_id, links.port))
    noise, bias = np.array(model.noise_density, float), np.array(model.bias, float)
    walk, scale = np.array(model.bias_walk_density, float), np.array(model.scale, float)
    sheet = replace(model, noise_density=noise, bias=bias, bias_walk_density=walk, scale=scale)
    return replace(setup, links=Links(site, cell, port), odometry_model=sheet)
