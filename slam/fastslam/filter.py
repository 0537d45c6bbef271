"""The extended FastSLAM: the paper's filter with clock offsets and odometer errors marginalised."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numba
import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.attitude import Attitude
from cellslam.slam.fastslam import resampling
from cellslam.slam.fastslam.block_kernel import update
from cellslam.slam.fastslam.layout import BIAS, LANES, OUT, POSE, SCALE, W_ROWS, scratch_rows
from cellslam.slam.fastslam.measurement_kernel import pack
from cellslam.slam.fastslam.options import FastSlamOptions
from cellslam.slam.fastslam.particles import Particles, draw, select, widened
from cellslam.slam.fastslam.summary import belief, map_of
from cellslam.slam.front_end import Readings, existence, first_of_link, ports_of, readings

CAPACITY = 24  # tracks a link that there is room for at the start; doubled when needed


class FastSlam:
    """Rao-Blackwellised particle filter over the vehicle's path; VTs and nuisances are Gaussian in each particle.

    Source: Chen, Whiton and Tufvesson, "Extended FastSLAM using cellular multipath component delays and angular
    information", sections III and IV; the corrections are in docs/fastslam.md.
    """

    name: ClassVar[str] = "fastslam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[FastSlamOptions]] = FastSlamOptions

    def __init__(self, options: FastSlamOptions | None = None) -> None:
        self.options = options or FastSlamOptions()

    @staticmethod
    def compiled() -> bool:
        """Return whether the kernels have been compiled before, and are in Numba's cache."""
        kernel: Any = update
        return any(Path(kernel.stats.cache_path or "").glob("block_kernel.update-*.nbi"))

    def warm_up(self) -> None:
        """Compile every kernel on a drive of three snapshots."""
        from cellslam.slam.fastslam.warm_up import warm_up

        warm_up(self.options)

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw the prior."""
        o = self.options
        self._setup, self._rng = setup, rng
        self._site_of = np.array(setup.links.site, np.int64)  # a writable copy: compiled code is typed by that
        self._port_of = ports_of(self._site_of, setup.links.port)
        self._shares = 1.0 / np.bincount(self._site_of)[self._site_of] ** o.link_correlation
        count = o.particles_start or o.particles
        self._particles: Particles = draw(setup, count, o.offset_component_std_m, min(o.vts_per_link, CAPACITY), rng)
        self._origin = np.array(setup.start_pose[:3], float)
        self._particles.rows(POSE, 3)[:] -= self._origin[:, None]
        self._attitude = Attitude(o, setup)
        self._time_s = 0.0
        self._now = 0
        self._born = 0
        self._scratch: tuple[Any, ...] = ()
        self._association = np.empty((0, 0, LANES), np.int64)
        self._tables: tuple[float, Any] | None = None

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Move, weigh, update and, if needed, resample (paper, section IV)."""
        values = self._read(dt_s, odometry, self._attitude.levelled(dt_s, snapshot))
        association = self._update(dt_s, odometry, snapshot, values)
        self._born += len(snapshot)
        self._now += 1
        self._time_s += dt_s
        return self._conclude(association[:, : len(snapshot)], snapshot, values.many)

    def _velocity(self, dt_s: float, odometry: Floats) -> Floats:
        """Return body velocities (G, 6, 32), one sample a particle of what was driven."""
        p, model = self._particles, self._setup.odometry_model
        blocks = len(p.state)
        bias = p.rows(BIAS, 6)
        if dt_s > 0.0:
            for c in np.flatnonzero(model.bias_walk_density):
                bias[:, c] += model.bias_walk_density[c] * np.sqrt(dt_s) * self._rng.standard_normal((blocks, LANES))
        velocity = odometry[:, None] - bias
        if dt_s > 0.0:
            for c in np.flatnonzero(model.noise_density):
                velocity[:, c] += model.noise_density[c] / np.sqrt(dt_s) * self._rng.standard_normal((blocks, LANES))
        velocity /= 1.0 + p.rows(SCALE, 6)
        return velocity

    def _read(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Readings:
        turned, moved = odometry[3] * dt_s, odometry[0] * dt_s
        return readings(snapshot, self._site_of, self._port_of, self.options, turned, moved)

    def _update(self, dt_s: float, odometry: Floats, snapshot: Snapshot, values: Readings) -> Ints:
        o = self.options
        first = first_of_link(snapshot, len(self._setup.links))
        log_tables, age_once, age_twice = self._existence(dt_s)
        parameters = np.array([
            np.log(o.clutter_density), o.gate, -np.log1p(-o.birth_ratio), 3.0, o.confirm_hits, age_once, age_twice,
            o.likelihood_exponent,
        ])  # fmt: skip
        self._reserve(np.diff(first))
        p, association = self._particles, self._association
        association[:, : len(snapshot)] = -1
        tables = pack(values.z, values.single, values.many, values.fresh, values.gap, values.lack)
        velocity = self._velocity(dt_s, odometry)
        run: Any = update
        run(
            self._now, float(dt_s), velocity, p.state, p.status, p.alike, p.records, p.ident, p.order, p.counts,
            p.bounds, p.travelled, first, self._site_of, self._shares, *tables, self._born, log_tables, parameters,
            p.log_weight, association, self._scratch[0], self._scratch[0].view(np.int32), *self._scratch[1:],
        )  # fmt: skip
        return association

    def _existence(self, dt_s: float) -> tuple[Floats, int, int]:
        if self._tables is None or (dt_s > 0.0 and abs(self._tables[0] - dt_s) > 1e-3 * dt_s):
            self._tables = (dt_s, existence(self.options, dt_s if dt_s > 0.0 else 0.075))
        result: tuple[Floats, int, int] = self._tables[1]
        return result

    def _reserve(self, measured: Ints) -> None:
        """Make room for a snapshot with so many measurements in each link (L,): for births, and scratch a thread."""
        o, p = self.options, self._particles
        most, total, capacity = int(measured.max()), int(measured.sum()), p.order.shape[2]
        if capacity < o.vts_per_link and int((p.counts + measured).max()) > capacity:
            capacity = min(2 * capacity, o.vts_per_link)
            self._particles = widened(p, capacity)
            self._scratch = ()
        if self._association.shape[0] != len(p.state) or self._association.shape[1] < total:
            self._association = np.empty((len(p.state), 2 * total, LANES), np.int64)
        if not self._scratch or self._scratch[4].shape[2] < most:
            self._scratch = self._new_scratch(capacity, max(2 * most, 16))

    def _new_scratch(self, c: int, m: int) -> tuple[Any, ...]:
        """Return scratch for each thread, for links of `c` tracks and `m` measurements."""
        threads = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
        w = np.zeros((threads, W_ROWS * LANES), np.float32)
        v = np.zeros((threads, scratch_rows(self._particles.nuisances) * LANES))
        near, rows = np.empty((threads, c), np.int64), np.empty((threads, c, OUT * LANES), np.float32)
        scores = np.empty((threads, c, m, LANES), np.float32)
        claims, row_of = np.empty((threads, c, m), np.bool_), np.empty((threads, m, LANES), np.int32)
        table, column, work = np.empty((threads, c, m)), np.empty((threads, m), np.int64), (threads, 4 * (c + m + 2))
        return w, v, near, rows, scores, claims, row_of, table, column, np.empty(work), np.empty(work, np.int64)

    def _conclude(self, association: Ints, snapshot: Snapshot, many: Floats) -> Estimate:
        p, o = self._particles, self.options
        log_weight = p.log_weight.ravel()
        weights = np.exp(log_weight - log_weight.max())
        weights /= weights.sum()
        best = int(np.argmax(weights))
        mean, covariance, offset, variance = belief(p, weights)
        mean[:3] += self._origin
        mean[3:] = wrap_angle(mean[3:])
        mine = association[best // LANES, :, best % LANES].copy()
        estimate = Estimate(mean, covariance, mine, offset, variance, map_of(p, best, self._site_of, self._origin))
        pose = p.rows(POSE, 6)[best // LANES, :, best % LANES].copy()
        pose[:3] += self._origin
        estimate = self._attitude.concluded(estimate, snapshot, many, pose)
        wanted = -(-o.particles // LANES) * LANES if self._time_s >= o.start_phase_s else len(p)
        if wanted != len(p) or resampling.effective_size(weights) < o.effective_share * len(p):
            self._particles = select(p, resampling.SCHEMES[o.resampling](weights, wanted, self._rng))
        return estimate
