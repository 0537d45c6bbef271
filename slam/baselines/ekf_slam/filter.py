"""EKF-SLAM: one Gaussian over pose, odometry errors, clock offsets and VTs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Links, OdometryModel
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.baselines.ekf_slam.bank import Bank, Measured, vt_estimate
from cellslam.slam.baselines.ekf_slam.layout import (
    AGE_ONCE,
    AGE_TWICE,
    BIRTH,
    CFG,
    CLUTTER,
    CONFIRM,
    FREE,
    GATE,
)
from cellslam.slam.baselines.ekf_slam.options import EkfSlamOptions
from cellslam.slam.baselines.ekf_slam.start import Start, begin
from cellslam.slam.baselines.front_end import columns, existence, first_of_link

NOT_GIVEN = -2


class EkfSlam:
    """Joint EKF over pose, odometry biases and scales, clock offsets and VTs in anchored spherical coordinates.

    Sources: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics" (1990), for the joint
    covariance; Bar-Shalom, Li and Kirubarajan (2001), section 5, for the filter; the measurement model and births are
    those of the extended FastSLAM (paper, section IV, corrected); association by the Hungarian algorithm within a
    gate, scored against clutter, missed detections and births as in docs/estimators.md.
    """

    name: ClassVar[str] = "ekf-slam"
    requires_truth: ClassVar[bool] = False
    Options: ClassVar[type[EkfSlamOptions]] = EkfSlamOptions
    mode: ClassVar[int] = FREE

    def __init__(self, options: EkfSlamOptions | None = None) -> None:
        self.options = options or EkfSlamOptions()

    def warm_up(self) -> None:
        """Compile every kernel on a made-up drive of four snapshots."""
        from cellslam.slam.baselines.ekf_slam.warm_up import warm_up

        warm_up(type(self), self.options)

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior; nothing is drawn."""
        del rng
        self._setup, self._time_s, self._now, self._born = _writable(setup), 0.0, 0, 0
        self._start: Start | None = self._begin()
        self._joint: Bank | None = None
        self._archive = np.empty((0, 14))
        self._tables: tuple[float, tuple[Floats, int, int]] | None = None

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Predict, associate, update."""
        self._time_s += dt_s
        odometry = np.array(odometry)
        measured = self._measured(dt_s, snapshot)
        if self._start is not None:
            answer = self._step_start(self._start, dt_s, odometry, measured)
        else:
            answer = self._step_joint(dt_s, odometry, measured)
        self._now += 1
        self._born += len(snapshot)
        return answer

    def _given(self, snapshot: Snapshot) -> Ints:
        """Return the true VT of each measurement, for the oracle that knows it."""
        return np.full(len(snapshot), NOT_GIVEN, np.int64)

    def _begin(self) -> Start:
        """Return the banks of the start."""
        return begin(self._setup, self.options, self.mode, self.options.start_vts)

    def _join(self, start: Start) -> Bank:
        """Return the joint filter."""
        return start.joint(self._setup, self.mode, self.options.vts)

    def _map(self, filters: Sequence[tuple[Bank, int]]) -> VtEstimate | None:
        """Return the confirmed VTs of some filters of banks, with those that had to make room."""
        rows = [bank.vts(index, self.options.confirm_hits) for bank, index in filters]
        return vt_estimate(np.concatenate([*rows, self._archive]))

    def _step_start(self, start: Start, dt_s: float, odometry: Floats, measured: Measured) -> Estimate:
        if dt_s > 0.0:
            start.move(self._setup, dt_s, odometry)
        association = start.use(self._setup, measured, self.options)
        mean, cov = start.shared()
        offset, variance = start.offsets()
        if start.resolved(self.options.resolved_std_m) or self._time_s >= self.options.start_limit_s:
            self._joint, self._start = self._join(start), None
        pose = mean[:6].copy()
        pose[3:] = wrap_angle(pose[3:])
        return Estimate(pose, cov[:6, :6].copy(), association, offset, variance, self._map(start.likeliest()))

    def _step_joint(self, dt_s: float, odometry: Floats, measured: Measured) -> Estimate:
        bank = self._joint
        if bank is None:
            raise RuntimeError("step() was called before start()")
        if dt_s > 0.0:
            bank.move(self._setup, dt_s, odometry)
        association = bank.use(self._setup, measured)[0]
        if bank.losses[0] > 0:
            self._archive = np.concatenate([self._archive, bank.lost[0, : bank.losses[0]]])
            bank.losses[:] = 0
        first, size = bank.core.first_offset, bank.core.size
        pose = bank.x[0, :6].copy()
        pose[3:] = wrap_angle(pose[3:])
        cov = bank.p[0, :6, :6]
        variance = np.maximum(np.diag(bank.p[0])[first:size], 0.0)
        offset = bank.x[0, first:size].copy()
        return Estimate(pose, 0.5 * (cov + cov.T), association, offset, variance, self._map([(bank, 0)]))

    def _measured(self, dt_s: float, snapshot: Snapshot) -> Measured:
        if self._tables is None or (dt_s > 0.0 and abs(self._tables[0] - dt_s) > 1e-3 * dt_s):
            self._tables = (dt_s, existence(self.options, dt_s if dt_s > 0.0 else 0.075))
        tables, once, twice = self._tables[1]
        o, cfg = self.options, np.zeros(CFG)
        cfg[CLUTTER], cfg[GATE], cfg[BIRTH] = np.log(o.clutter_density), o.gate, -np.log1p(-o.birth_ratio)
        cfg[CONFIRM], cfg[AGE_ONCE], cfg[AGE_TWICE] = o.confirm_hits, once, twice
        z, q, gap = columns(snapshot, o)
        first = first_of_link(snapshot, len(self._setup.links))
        return Measured(self._now, self._born, first, z, q, gap, self._given(snapshot), tables, cfg)


def _writable(setup: Setup) -> Setup:
    """Return a setup whose arrays can be written: kernels are compiled for such arrays alone."""
    links, model = setup.links, setup.odometry_model
    return replace(
        setup,
        links=Links(*(np.array(c, np.int64) for c in (links.site, links.cell_id, links.port))),
        odometry_model=OdometryModel(
            *(np.array(c, float) for c in (model.noise_density, model.bias, model.bias_walk_density, model.scale))
        ),
    )
