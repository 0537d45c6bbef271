"""FastSLAM with errors that are counted: particles of the path, clock offsets and odometer errors marginalised."""

from __future__ import annotations

from typing import Any, ClassVar

import numba
import numpy as np
from numpy.typing import NDArray

from cellslam.sim.recording import Floats
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.fastslam.best_map import map_of
from cellslam.slam.fastslam.fastslam_options import FastSlamOptions
from cellslam.slam.fastslam.parts.choice import Choice, chosen
from cellslam.slam.fastslam.running.threads import over_blocks
from cellslam.slam.fastslam.snapshot.block_kernel import advance_blocks
from cellslam.slam.fastslam.snapshot.measurement_kernel import census, pack
from cellslam.slam.fastslam.state.layout import LANES, OUT, POSE, W_ROWS, Measured, Rules, Scratch, Step, sums_of
from cellslam.slam.fastslam.state.moments_kernel import moments, normalised
from cellslam.slam.fastslam.state.particles import Particles, draw, draw_velocities, select, widened
from cellslam.slam.front_end import attitude, misfit
from cellslam.slam.front_end.attitude import Attitude
from cellslam.slam.front_end.looks import Grouping, Looks
from cellslam.slam.front_end.measurement_noise import ports_of
from cellslam.slam.front_end.misfit import Misfit
from cellslam.slam.front_end.readings import Readings, novelty, readings
from cellslam.slam.front_end.visibility import existence

SLACK_M = 0.3  # of the test that passes over tracks: what its bounds are not told of
CAPACITY = 24  # tracks a map that there is room for at the start; doubled when needed


class PathParticles:
    """Rao-Blackwellised particle filter over the vehicle's path; VTs and nuisances are Gaussian in each particle.

    Source: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
    information", sections III and IV; the corrections are in docs/explanation/fastslam.md.
    """

    requires_truth: ClassVar[bool] = False

    def __init__(self, options: FastSlamOptions | None = None, **parts: Any) -> None:
        """Take options, and parts as objects where they are not those that the options name.

        parts: association, criterion, clock, resampling; see `part_types`, `resampling`.
        """
        self.options = options or FastSlamOptions()
        self.choice: Choice = chosen(self.options, **parts)

    def warm_up(self) -> None:
        """Compile every kernel on a drive of four snapshots."""
        attitude.warm_up()
        misfit.warm_up()
        small = {
            "particles": 8, "particles_start": 12, "start_phase_s": 0.2, "effective_share": 1.0, "vts_per_link": 4,
        }  # fmt: skip
        one = type(self)(self.options.model_copy(update=small))
        one.choice = self.choice
        setup = warm_up.drive(one)
        for blocks, ancestor in ((1, 0), (2, 40)):
            two = draw(setup, blocks * LANES, 20.0, 4, np.random.default_rng(0), record=self.choice.record)
            select(two, np.full(len(two), ancestor))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw the prior."""
        self._grouping = Grouping(setup, self.options)
        self._setup = setup = self._grouping.setup
        self._options = o = self._grouping.options
        self._rng, self._site_of = rng, setup.links.site
        self._port_of = ports_of(self._site_of, setup.links.port)
        self._shares = 1.0 / np.bincount(self._site_of)[self._site_of] ** o.link_correlation
        given = self.choice.prior(setup)
        self._choice = self.choice.for_clocks(given.sites)
        self._particles: Particles = draw(
            given, o.particles_start or o.particles, self._choice.component_m,
            min(o.vts_per_link, CAPACITY), rng, len(self._site_of), self._choice.record, o.motion == "sampled",
        )  # fmt: skip
        self._origin = np.array(setup.start_pose[:3], float)
        self._particles.rows(POSE, 3)[:] -= self._origin[:, None]
        self._attitude, self._misfit = Attitude(o, setup), Misfit(o)
        self._time_s = 0.0
        self._now = 0
        self._born = 0
        self._scratch: tuple[Scratch, ...] = ()
        self._association = np.empty((0, 0, LANES), np.int32)
        self._rules: tuple[float, Rules] | None = None

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Move, weigh, update and, if needed, resample (paper, section IV).

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        looks = self._grouping.looks(snapshot)
        values = self._misfit.widened(self._read(dt_s, odometry, self._attitude.levelled(dt_s, looks)), dt_s)
        association = self._update(dt_s, odometry, looks, values)
        self._born += len(looks)
        self._now += 1
        self._time_s += dt_s
        return self._grouping.answer(self._conclude(association[:, : len(looks)], looks, values), looks)

    def _read(self, dt_s: float, odometry: Floats, looks: Looks) -> Readings:
        turned, moved = odometry[3] * dt_s, odometry[0] * dt_s
        return readings(looks, self._port_of, self._options, turned, moved)

    def _update(self, dt_s: float, odometry: Floats, looks: Looks, values: Readings) -> NDArray[np.int32]:
        first, most, needed = census(looks.link, self._particles.counts)
        self._reserve(len(looks), most, needed)
        p, association = self._particles, self._association
        association[:, : len(looks)] = -1
        z, many, fresh = pack(values.z, values.single, values.many, values.fresh, values.gap, values.lack, looks.begins)
        shares = self._shares * self._novelty(odometry[3] * dt_s, odometry[0] * dt_s)
        measured = Measured(first, self._site_of, shares, z, many, fresh, self._born)
        self._parts, rules = self._choice.parts_for(looks, self._born, self._time_s + dt_s), self._rules_for(dt_s)
        velocity = draw_velocities(p, self._setup.odometry_model, dt_s, odometry, self._rng)
        step = Step(self._now, float(dt_s), velocity, measured, rules)
        kernel = advance_blocks(self._parts)
        over_blocks(kernel, len(p.state), self._scratch, self._parts, step, p.held, association)
        return association

    def _novelty(self, turn_rad: float, moved_m: float) -> float:
        return novelty(self._options, turn_rad, moved_m) if self.options.evidence_lasts else 1.0

    def _rules_for(self, dt_s: float) -> Rules:
        o = self._options
        if self._rules is None or (dt_s > 0.0 and abs(self._rules[0] - dt_s) > 1e-3 * dt_s):
            tables, age_once, age_twice = existence(o, dt_s if dt_s > 0.0 else 0.075)
            self._rules = (dt_s, Rules(
                log_clutter=float(np.log(o.clutter_density)), gate=o.gate, log_birth=float(-np.log1p(-o.birth_ratio)),
                slack_m=SLACK_M, hits=float(o.confirm_hits), age_once=age_once, age_twice=age_twice,
                exponent=o.likelihood_exponent, merging=o.merging, tables=tables,
            ))  # fmt: skip
        return self._rules[1]

    def _reserve(self, total: int, most: int, needed: int) -> None:
        """Make room for a snapshot of `total` measurements, `most` in one link: for births, with `needed` tracks in one
        map, and scratch a thread."""
        o, p = self.options, self._particles
        capacity = p.order.shape[2]
        if capacity < o.vts_per_link and needed > capacity:
            capacity = min(2 * capacity, o.vts_per_link)
            self._particles = widened(p, capacity)
            self._scratch = ()
        if self._association.shape[0] != len(p.state) or self._association.shape[1] < total:
            self._association = np.empty((len(p.state), 2 * total, LANES), np.int32)
        if not self._scratch or self._scratch[0].scores.shape[1] < most:
            threads = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
            self._scratch = tuple(self._new_scratch(capacity, max(2 * most, 16)) for _ in range(threads))

    def _new_scratch(self, c: int, m: int) -> Scratch:
        """Return a thread's scratch for maps of `c` tracks and links of `m` measurements."""
        w, work = np.zeros(W_ROWS * LANES, np.float32), 4 * (c + m + 2)
        return Scratch(
            w=w, bits=w.view(np.int32), v=np.zeros(sums_of(self._particles.nuisances).rows * LANES),
            near=np.empty(c, np.int64), reached=np.empty(c, np.bool_), rows=np.empty((c, OUT * LANES), np.float32),
            scores=np.empty((c, m, LANES), np.float32), claims=np.empty((c, m), np.bool_),
            row_of=np.empty((m, LANES), np.int32), table=np.empty((c, m)), column=np.empty(m, np.int64),
            floats=np.empty(work), ints=np.empty(work, np.int64),
        )  # fmt: skip

    def _conclude(self, association: NDArray[np.int32], looks: Looks, values: Readings) -> Estimate:
        p, o = self._particles, self.options
        weights, best, effective = normalised(p.log_weight)
        mean, covariance, offset, variance = moments(p.state, weights, p.nuisances)
        mean[:3] += self._origin
        block, lane = divmod(int(best), LANES)
        vts = map_of(p, best, self._parts, self._site_of, self._origin)
        sites = len(self._setup.sites)
        estimate = Estimate(
            mean, covariance, association[block, :, lane].astype(np.int64), offset[:sites], variance[:sites], vts
        )
        pose = p.rows(POSE, 6)[block, :, lane].copy()
        pose[:3] += self._origin
        self._misfit.learn(estimate, values, pose)
        estimate = self._attitude.concluded(estimate, looks, values.many, pose)
        wanted = -(-o.particles // LANES) * LANES if self._time_s >= o.start_phase_s else len(p)
        if wanted != len(p) or effective < o.effective_share * len(p):
            self._particles = select(p, self._choice.resampling(weights.ravel(), wanted, self._rng))
        return estimate
