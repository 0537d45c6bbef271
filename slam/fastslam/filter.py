"""The extended FastSLAM: the paper's filter with clock offsets and odometer errors marginalised."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.fastslam import resampling
from cellslam.slam.fastslam.existence import tables
from cellslam.slam.fastslam.layout import PREDICTION
from cellslam.slam.fastslam.noise import variances
from cellslam.slam.fastslam.options import FastSlamOptions
from cellslam.slam.fastslam.particles import Particles, draw, select
from cellslam.slam.fastslam.summary import map_of, offset_moments, pose_moments
from cellslam.slam.fastslam.update_kernel import move, update

CHUNKS = 32  # particles are worked on in this many parts, whatever the number of threads


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

    def warm_up(self) -> None:
        """Compile every kernel on a drive of three snapshots."""
        from cellslam.slam.fastslam.warm_up import warm_up

        warm_up(self.options)

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Draw the prior."""
        o = self.options
        self._setup, self._rng = setup, rng
        self._site_of = np.asarray(setup.links.site, np.int64)
        count = o.particles_start or o.particles
        self._particles: Particles = draw(setup, count, o.offset_component_std_m, o.vts_per_link, rng)
        self._time_s = 0.0
        self._now = 0
        self._born = 0
        self._scratch_for = 0
        self._tables: tuple[float, Any] | None = None

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Move, weigh, update and, if needed, resample (paper, section IV)."""
        if dt_s > 0.0:
            self._move(dt_s, odometry)
        association = self._update(dt_s, snapshot)
        self._born += len(snapshot)
        self._now += 1
        self._time_s += dt_s
        return self._finish_step(association)

    def _move(self, dt_s: float, odometry: Floats) -> None:
        p, model = self._particles, self._setup.odometry_model
        white = np.flatnonzero(model.noise_density)
        walking = np.flatnonzero(model.bias_walk_density)
        if len(walking):
            p.bias[:, walking] += (
                model.bias_walk_density[walking] * np.sqrt(dt_s) * self._rng.standard_normal((len(p), len(walking)))
            )
        velocity = (odometry - p.bias) / (1.0 + p.scale)
        if len(white):
            velocity[:, white] += (
                model.noise_density[white] / np.sqrt(dt_s) * self._rng.standard_normal((len(p), len(white)))
            )
        move(p.pose, p.pose_g, p.theta, velocity, dt_s, CHUNKS)

    def _update(self, dt_s: float, snapshot: Snapshot) -> Ints:
        p, o = self._particles, self.options
        z = np.stack([snapshot.distance_m, snapshot.azimuth_rad, snapshot.elevation_rad], axis=1)
        q = variances(snapshot, o)
        first = np.searchsorted(snapshot.link, np.arange(len(self._setup.links) + 1))
        log_tables, age_once, age_twice = self._existence(dt_s)
        config = np.array([
            np.log(o.clutter_density), o.gate, -np.log1p(-o.birth_ratio), 3.0, o.confirm_hits, age_once, age_twice,
            o.likelihood_exponent
        ])  # fmt: skip
        association = np.full((len(p), len(snapshot)), -1, np.int64)
        self._reserve(len(snapshot))
        update(
            float(self._now), p.pose, p.pose_g, p.theta, p.cov, p.records, p.counts, first, self._site_of, z, q,
            self._born,
            log_tables, config, p.log_weight, association, *self._scratch,
        )  # fmt: skip
        return association

    def _existence(self, dt_s: float) -> tuple[Floats, int, int]:
        if self._tables is None or (dt_s > 0.0 and abs(self._tables[0] - dt_s) > 1e-3 * dt_s):
            self._tables = (dt_s, tables(self.options, dt_s if dt_s > 0.0 else 0.075))
        result: tuple[Floats, int, int] = self._tables[1]
        return result

    def _reserve(self, measurements: int) -> None:
        """Keep scratch for one chunk each: predictions, scores, small matrices, indices."""
        if self._scratch_for >= max(measurements, 1):
            return
        m, c, k = max(2 * measurements, 64), self.options.vts_per_link, self._particles.theta.shape[1]
        self._scratch_for = m
        self._scratch = (
            np.empty((CHUNKS, c, PREDICTION)),
            np.empty((CHUNKS, c, m)),
            np.empty((CHUNKS, 24 + 2 * k + 3 * k * k + 4 * (c + m + 2))),
            np.empty((CHUNKS, 2 * m + 4 * (c + m + 2)), np.int64),
        )

    def _finish_step(self, association: Ints) -> Estimate:
        p, o = self._particles, self.options
        weights = np.exp(p.log_weight - p.log_weight.max())
        weights /= weights.sum()
        best = int(np.argmax(weights))
        mean, covariance = pose_moments(p, weights)
        offset, variance = offset_moments(p, weights, len(self._setup.sites))
        mean[3:] = wrap_angle(mean[3:])
        vts = map_of(p, best, self._site_of, o.confirm_hits)
        estimate = Estimate(mean, covariance, association[best].copy(), offset, variance, vts)
        wanted = o.particles if self._time_s >= o.start_phase_s else len(p)
        if wanted != len(p) or resampling.effective_size(weights) < o.effective_share * len(p):
            ancestors = resampling.SCHEMES[o.resampling](weights, wanted, self._rng)
            self._particles = select(p, ancestors)
        return estimate
