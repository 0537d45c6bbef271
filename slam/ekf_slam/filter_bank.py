"""A bank of joint EKFs: their arrays, the prior, one step of motion and of measurement."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup, VtEstimate
from cellslam.slam.bp_slam.belief_kernel import believe_snapshot
from cellslam.slam.ekf_slam.map_kernel import map_into
from cellslam.slam.ekf_slam.motion_kernel import move
from cellslam.slam.ekf_slam.snapshot_kernel import find_rivals, use_snapshot
from cellslam.slam.ekf_slam.start.fusion_kernel import moments
from cellslam.slam.ekf_slam.state_layout import (
    ANCHOR,
    BELIEF,
    GATE,
    GEOMETRY,
    JOINT,
    JOINT_MEASUREMENTS,
    JOINT_VTS,
    KNOWN_MAP,
    SHARE,
    SLOT,
)
from cellslam.slam.front_end.readings import Readings

PENDING = 99  # rows of what a snapshot takes off the covariance that may wait
LOST = 64  # confirmed VTs that one snapshot can push out


@dataclass(frozen=True)
class Core:
    """States before the VTs: pose (0-5), odometry biases and scales that the data sheet has, clock offsets (S), rates
    of those that drift.

    `bias`, `scale` (6,), `rate` (S,): state of each component's error and of each offset's rate, -1 where there is
    none.
    """

    bias: Ints
    scale: Ints
    first_offset: int
    rate: Ints
    size: int

    @property
    def offsets(self) -> slice:
        """The clock offsets."""
        return slice(self.first_offset, self.first_offset + len(self.rate))

    @staticmethod
    def of(setup: Setup) -> Core:
        """Return the layout for a setup."""
        model = setup.odometry_model
        bias, scale = np.full(6, -1, np.int64), np.full(6, -1, np.int64)
        biased, scaled = np.flatnonzero((model.bias > 0) | (model.bias_walk_density > 0)), np.flatnonzero(model.scale)
        bias[biased] = 6 + np.arange(len(biased))
        scale[scaled] = 6 + len(biased) + np.arange(len(scaled))
        first = 6 + len(biased) + len(scaled)
        drifts, after = setup.sites.drift_std_m_s > 0.0, first + len(setup.sites)
        rate = np.where(drifts, after + np.cumsum(drifts) - 1, -1).astype(np.int64)
        return Core(bias, scale, first, rate, after + int(drifts.sum()))


@dataclass
class Measured:
    """One snapshot as the kernels take it; see `filter_kernel.use_snapshot`.

    `begin` (m, 3) and `begin_q` (m, 3): measurements as births take them, with a prior where there is no elevation.
    """

    now: int
    born: int
    first: Ints
    readings: Readings
    begin: Floats
    begin_q: Floats
    given: Ints
    tables: Floats
    cfg: Floats

    def __len__(self) -> int:
        return len(self.readings.z)

    @property
    def columns(self) -> tuple[Floats, ...]:
        """What the kernels read of the measurements."""
        r = self.readings
        return r.z, r.single, r.many, r.gap, r.lack, self.begin, self.begin_q


@dataclass
class Bank:
    """K filters with V places for VTs each: mean x (K, N), covariance p (K, N, N), N = core + 3 V; links used (K, L).

    With `mode` KNOWN_MAP the VTs are exact, and N = core in p.
    """

    core: Core
    mode: int
    x: Floats
    p: Floats
    anchor: Floats
    slots: Ints
    count: Ints
    links: Ints
    log_weight: Floats
    lost: Floats
    losses: Ints
    _scratch: tuple[int, tuple[Any, ...]] = field(default=(-1, ()), repr=False)

    def __len__(self) -> int:
        return len(self.x)

    def move(self, setup: Setup, dt_s: float, odometry: Floats) -> None:
        """Advance every filter by an interval."""
        filters, size, model = len(self), self.p.shape[1], setup.odometry_model
        mapped = self.count if size > self.core.size else np.zeros(filters, np.int64)
        scratch = np.empty((filters, 36)), np.empty((filters, 6, self.core.size + 6)), np.empty((filters, 6, 3 + size))
        move(
            self.x, self.p, mapped, odometry, dt_s, model.noise_density, model.bias_walk_density, self.core.bias,
            self.core.scale, self.core.first_offset, self.core.rate, self.core.size, *scratch,
        )  # fmt: skip

    def use(self, setup: Setup, measured: Measured, forbidden: Ints | None = None) -> Ints:
        """Use a snapshot in every filter; return the associations (K, M).

        forbidden (K, 2): measurement and identity of a VT that a filter must not pair, -1 for none.
        """
        m, association = measured, np.full((len(self), len(measured)), -1, np.int64)
        scratch, joint = self._work(m)
        if self.mode == BELIEF:
            believe_snapshot(
                m.now, self.x, self.p, self.core.size, self.core.first_offset, self.anchor, self.slots, self.count,
                self.links, m.first, setup.links.site, m.columns, m.born, m.cfg, self.log_weight, association,
                self.lost, self.losses, scratch,
            )  # fmt: skip
            return association
        nothing = np.full((len(self), 2), -1, np.int64) if forbidden is None else forbidden
        use_snapshot(
            self.mode, m.now, self.x, self.p, self.core.size, self.core.first_offset, self.anchor, self.slots,
            self.count, self.links, m.first, setup.links.site, m.columns, m.given, m.born, m.tables, m.cfg, nothing,
            self.log_weight, association, self.lost, self.losses, scratch, joint,
        )  # fmt: skip
        return association

    def rivals(self, setup: Setup, measured: Measured) -> Floats:
        """Return loss (nats), measurement and VT (K, 3) of each filter's second-best association."""
        m, out = measured, np.empty((len(self), 3))
        find_rivals(
            m.now, self.x, self.p, self.core.size, self.core.first_offset, self.anchor, self.slots, self.count, m.first,
            setup.links.site, m.columns, m.tables, m.cfg, np.full(2, -1, np.int64), out, *self._work(m),
        )  # fmt: skip
        return out

    def moments(self, first: int, count: int) -> tuple[Floats, Floats]:
        """Return mean (n,) and covariance (n, n) of `count` states of the core over all filters."""
        found: tuple[Floats, Floats] = moments(self.log_weight, self.x, self.p, first, count)
        return found

    def vts(self, index: int, hits: int) -> Floats:
        """Return identity, link, position, covariance (v, 14) of one filter's VTs with at least `hits` detections."""
        out = np.empty((int(self.count[index]), 14))
        size = self.core.size
        found = map_into(
            self.x[index], self.p[index], size, self.anchor[index], self.slots[index], self.count[index], hits, out
        )
        return out[:found]

    def take(self, kept: Ints) -> Bank:
        """Return the filters `kept`."""
        return Bank(
            self.core, self.mode, self.x[kept], self.p[kept], self.anchor[kept], self.slots[kept], self.count[kept],
            self.links[kept], self.log_weight[kept], self.lost[kept], self.losses[kept],
        )  # fmt: skip

    def grown(self, vts: int) -> Bank:
        """Return the same filters with places for at least `vts` VTs."""
        more = max(vts - self.anchor.shape[1], 0)
        if more == 0:
            return self
        far = ((0, 0), (0, more), (0, 0))
        p = self.p if self.mode == KNOWN_MAP else np.pad(self.p, ((0, 0), (0, 3 * more), (0, 3 * more)))
        return replace(
            self, x=np.pad(self.x, ((0, 0), (0, 3 * more))), p=p, anchor=np.pad(self.anchor, far),
            slots=np.pad(self.slots, far), _scratch=(-1, ()),
        )  # fmt: skip

    def _work(self, measured: Measured) -> tuple[Any, ...]:
        """Return scratch for every filter, made anew when a snapshot needs more."""
        if self._scratch[0] < len(measured) or self._scratch[0] < 0:
            k, c, m = len(self), self.anchor.shape[1], max(2 * len(measured), 32)
            wide, joint = 4 * (c + m + 2), measured.cfg[JOINT] > 0.0
            rows, columns = (JOINT_VTS, JOINT_MEASUREMENTS) if joint else (1, 1)
            common = (
                np.empty((k, GEOMETRY)), np.empty((k, 3, self.x.shape[1])), np.empty((k, c, m)),
                np.empty((k, c), np.int64),
            )  # fmt: skip
            small = np.empty((k, 3, 10)), np.empty((k, 4, 3))
            if self.mode == BELIEF:
                pairs = np.empty((k, c, m)), np.empty((k, c, m)), np.empty((k, c, m))
                self._scratch = m, ((*common, *small, *pairs, np.empty((k, m)), np.empty((k, 4, 4))), ())
                return self._scratch[1]
            work = np.empty((k, 3, m), np.int64), np.empty((k, wide)), np.empty((k, wide), np.int64)
            scratch = (*common, *work, *small, np.empty((PENDING, self.x.shape[1])))
            parts = (
                np.empty((k, rows, 3, self.x.shape[1])), np.empty((k, rows, rows, 3, 3)),
                np.empty((k, rows, columns, 3)), np.empty((k, 3 * columns, 3 * columns + 1)),
                np.empty((k, columns, 2), np.int64), np.empty((k, columns + 1), np.int64), joint_gates(measured.cfg),
            )  # fmt: skip
            self._scratch = m, (scratch, parts)
        return self._scratch[1]


def new_bank(setup: Setup, core: Core, mode: int, vts: int, offsets_m: Floats, offset_std_m: Floats) -> Bank:
    """Return K filters at the start without VTs, with clock offsets (K, S) of deviations (S,); all links in use."""
    filters, model = len(offsets_m), setup.odometry_model
    size = core.size + 3 * vts
    x, p = np.zeros((filters, size)), np.zeros((filters, *((core.size if mode == KNOWN_MAP else size,) * 2)))
    variance = np.zeros(core.size)
    variance[:6] = setup.start_std**2
    for of, std in ((core.bias, model.bias), (core.scale, model.scale)):
        variance[of[of >= 0]] = std[of >= 0] ** 2
    variance[core.offsets] = offset_std_m**2
    variance[core.rate[core.rate >= 0]] = setup.sites.drift_std_m_s[core.rate >= 0] ** 2
    x[:, :6], x[:, core.offsets] = setup.start_pose, offsets_m
    p[:, np.arange(core.size), np.arange(core.size)] = variance
    anchor = np.zeros((filters, vts, ANCHOR))
    anchor[:, :, SHARE] = 1.0
    return Bank(
        core, mode, x, p, anchor, np.zeros((filters, vts, SLOT), np.int64),
        np.zeros(filters, np.int64), np.ones((filters, len(setup.links)), np.int64), np.zeros(filters),
        np.empty((filters, LOST, 14)), np.zeros(filters, np.int64),
    )  # fmt: skip


def vt_estimate(rows: Floats) -> VtEstimate:
    """Return rows (v, 14) of identity, link, position and covariance as VTs."""
    covariance = rows[:, 5:].reshape(-1, 3, 3)
    ids, link = rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64)
    return VtEstimate(ids, link, rows[:, 2:5].copy(), 0.5 * (covariance + np.swapaxes(covariance, 1, 2)))


def joint_gates(cfg: Floats) -> Floats:
    """Return the chi-square gates by number of components, with the tail probability of the gate of three."""
    from scipy.stats import chi2

    degrees = np.arange(1, 3 * JOINT_MEASUREMENTS + 1)
    return np.concatenate([[0.0], chi2.isf(chi2.sf(cfg[GATE], 3), degrees)])
