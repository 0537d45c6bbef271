"""EKF-SLAM: one Gaussian over pose, odometry errors, clock offsets and VTs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Links, OdometryModel
from cellslam.slam import warm_up
from cellslam.slam.api import Estimate, Setup, Snapshot, VtEstimate
from cellslam.slam.ekf_slam.ekf_slam_options import EkfSlamOptions
from cellslam.slam.ekf_slam.filter_bank import Bank, vt_estimate
from cellslam.slam.ekf_slam.start.offset_banks import Start, begin
from cellslam.slam.ekf_slam.state_layout import ENTRY, FREE, KNOWN_ASSOCIATION, Measured, Rules
from cellslam.slam.front_end.attitude import Attitude
from cellslam.slam.front_end.looks import Grouping, Looks
from cellslam.slam.front_end.measurement_noise import first_of_link, ports_of
from cellslam.slam.front_end.misfit import Misfit
from cellslam.slam.front_end.readings import Readings, readings
from cellslam.slam.front_end.visibility import existence

NOT_GIVEN = -2
GUESSING = 3  # times as many places where VTs have several guesses


class JointFilter:
    """What EKF-SLAM, its oracles and BP-SLAM share: one joint covariance after a Gaussian-sum start.

    State: pose, odometry biases and scales, clock offsets, and VTs in anchored spherical coordinates. Sources: Smith,
    Self and Cheeseman, "Estimating uncertain spatial relationships in robotics" (1990), for the joint covariance;
    Bar-Shalom, Li and Kirubarajan (2001), section 5, for the filter; measurement model and births are those of the
    extended FastSLAM (paper, section IV, corrected).
    """

    name: ClassVar[str]
    requires_truth: ClassVar[bool] = False
    mode: ClassVar[int] = FREE
    options: EkfSlamOptions

    def __init__(self, options: Any = None) -> None:
        self.options = options or EkfSlamOptions()

    def warm_up(self) -> None:
        """Compile every kernel on a made-up drive of four snapshots."""
        warm_up.drive(type(self)(self.options.model_copy(update={"start_limit_s": 0.1})))

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        """Take the prior; nothing is drawn."""
        del rng
        self._grouping = Grouping(setup, self.options)
        self._setup, self._time_s, self._now, self._born = _writable(self._grouping.setup), 0.0, 0, 0
        self._attitude, self._misfit = Attitude(self.options, setup), Misfit(self.options)
        self._ports = ports_of(self._setup.links.site, self._setup.links.port)
        self._start: Start | None = self._begin()
        self._joint: Bank | None = None
        self._archive = np.empty((0, ENTRY))
        self._tables: tuple[float, tuple[Floats, int, int]] | None = None

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        """Predict, associate, update.

        dt_s in s; odometry (6,): mean body velocities in m/s and rad/s.
        """
        self._time_s += dt_s
        odometry = np.array(odometry)
        looks = self._grouping.looks(snapshot)
        values = self._readings(dt_s, odometry, self._attitude.levelled(dt_s, looks))
        measured = self._measured(dt_s, values, looks)
        if self._start is not None:
            answer = self._step_start(self._start, dt_s, odometry, measured)
        else:
            answer = self._step_joint(dt_s, odometry, measured)
        self._now += 1
        self._born += len(looks)
        self._misfit.learn(answer, values)
        answer = self._attitude.concluded(answer, looks, values.many)
        return self._grouping.answer(answer, looks)

    def _given(self, looks: Looks) -> Ints:
        """Return the true VT of each look, for the oracle that knows it."""
        return np.full(len(looks), NOT_GIVEN, np.int64)

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

    def _rules(self, common: Rules, dt_s: float) -> Rules:
        """Return the common options of the kernels with what they need beside."""
        return common

    def _step_start(self, start: Start, dt_s: float, odometry: Floats, measured: Measured) -> Estimate:
        if dt_s > 0.0:
            start.move(self._setup, dt_s, odometry)
        association = start.use(self._setup, measured, self.options)
        mean, cov = start.shared()
        offset, variance = start.offsets()
        if (variance <= self.options.resolved_std_m**2).all() or self._time_s >= self.options.start_limit_s:
            self._joint, self._start = self._join(start), None
        return _estimate(mean, cov, association, offset, variance, self._map(start.likeliest()))

    def _step_joint(self, dt_s: float, odometry: Floats, measured: Measured) -> Estimate:
        bank = self._joint
        if bank is None:
            raise RuntimeError("step() was called before start()")
        if dt_s > 0.0:
            bank.move(self._setup, dt_s, odometry)
        association = bank.use(measured)
        best = int(np.argmax(bank.log_weight))
        if bank.losses[best] > 0:
            self._archive = np.concatenate([self._archive, bank.lost[best, : bank.losses[best]]])
        bank.losses[:] = 0
        mean, cov = bank.moments(0, bank.core.size)
        offsets = bank.core.offsets
        variance = np.maximum(np.diag(cov)[offsets], 0.0)
        return _estimate(mean, cov, association[best].copy(), mean[offsets], variance, self._map([(bank, best)]))

    def _readings(self, dt_s: float, odometry: Floats, looks: Looks) -> Readings:
        """Return the looks of a level array with their variances."""
        return self._misfit.widened(
            readings(looks, self._ports, self._grouping.options, odometry[3] * dt_s, odometry[0] * dt_s), dt_s
        )

    def _measured(self, dt_s: float, values: Readings, looks: Looks) -> Measured:
        if self._tables is None or (dt_s > 0.0 and abs(self._tables[0] - dt_s) > 1e-3 * dt_s):
            self._tables = (dt_s, existence(self._grouping.options, dt_s if dt_s > 0.0 else 0.075))
        tables, once, twice = self._tables[1]
        o, site = self._grouping.options, self._setup.links.site
        birth = float(-np.log1p(-o.birth_ratio))
        rules = Rules(self.mode, float(np.log(o.clutter_density)), o.gate, birth, o.confirm_hits, once, twice)
        begin, begin_q = values.z.copy(), values.fresh.copy()
        flat = np.isnan(begin[:, 2])
        begin[flat, 2], begin_q[flat, 2] = 0.0, np.radians(self.options.elevation_std_deg) ** 2
        if np.isnan(begin[:, :2]).any():
            self._make_room()
        begin[~looks.begins] = np.nan
        v, first = values, first_of_link(looks, len(site))
        return Measured(
            self._now, self._born, first, site, v.z, v.single, v.many, v.gap, v.lack, begin, begin_q,
            self._given(looks), tables, self._rules(rules, dt_s),
        )  # fmt: skip

    def _make_room(self) -> None:
        """Make places for the guesses of VTs whose direction or distance is not measured."""
        if self.mode not in (FREE, KNOWN_ASSOCIATION):
            return
        if self._start is not None:
            self._start.banks = [b.grown(GUESSING * self.options.start_vts) for b in self._start.banks]
        elif self._joint is not None:
            self._joint = self._joint.grown(GUESSING * self.options.vts)


class EkfSlam(JointFilter):
    """EKF-SLAM: hard association by the Hungarian algorithm.

    Pairs are scored against clutter, missed detections and births as in docs/estimators.md.
    """

    name: ClassVar[str] = "ekf-slam"
    Options: ClassVar[type[EkfSlamOptions]] = EkfSlamOptions


def _estimate(
    mean: Floats, cov: Floats, association: Ints, offset: Floats, variance: Floats, vts: VtEstimate | None
) -> Estimate:
    pose = mean[:6].copy()
    pose[3:] = wrap_angle(pose[3:])
    square = cov[:6, :6]
    return Estimate(pose, 0.5 * (square + square.T), association, offset.copy(), variance.copy(), vts)


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
