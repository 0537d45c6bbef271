"""A bank of joint EKFs: their arrays, the prior, one step of motion and of measurement.

Sources: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990 (one covariance of
pose and map); Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", IEEE Trans.
Automatic Control 17(4), 1972 (several filters).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup, VtEstimate
from cellslam.slam.ekf_slam.belief_kernel import believe_snapshot
from cellslam.slam.ekf_slam.map_kernel import map_into
from cellslam.slam.ekf_slam.motion_kernel import Interval, move
from cellslam.slam.ekf_slam.snapshot_kernel import use_snapshot
from cellslam.slam.ekf_slam.start.fusion_kernel import moments
from cellslam.slam.ekf_slam.state_layout import (
    ANCHOR,
    BELIEF,
    ENTRY,
    KNOWN_MAP,
    POSE,
    POSITION,
    SHARE,
    SLOT,
    SPREAD,
    TOUCHED,
    BeliefScratch,
    Core,
    Filter,
    Measured,
    Rules,
    Scratch,
    one_of,
)

PENDING = 99  # rows of what a snapshot takes off the covariance that may wait
LOST = 64  # confirmed VTs that one snapshot can push out


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
    _scratch: Any = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.x)

    @property
    def arrays(self) -> Filter:
        """The bank as the kernels take it."""
        return Filter(
            self.core, self.mode != KNOWN_MAP, self.x, self.p, self.anchor, self.slots, self.count, self.links,
            self.lost, self.losses,
        )  # fmt: skip

    def move(self, setup: Setup, dt_s: float, odometry: Floats) -> None:
        """Advance every filter by an interval: dt_s in s, mean body velocities `odometry` (6,) in m/s and rad/s."""
        model = setup.odometry_model
        move(self.arrays, Interval(dt_s, odometry, model.noise_density, model.bias_walk_density))

    def use(self, measured: Measured) -> Ints:
        """Use a snapshot in every filter; return the associations (K, M)."""
        association = np.full((len(self), len(measured.z)), -1, np.int64)
        if self.mode == BELIEF:
            believe_snapshot(self.arrays, measured, self.log_weight, association, self._room(measured))
        else:
            use_snapshot(self.arrays, measured, self.log_weight, association, self._room(measured))
        return association

    def moments(self, first: int, count: int) -> tuple[Floats, Floats]:
        """Return mean (n,) and covariance (n, n) of `count` states of the core over all filters, in the units of the
        states."""
        found: tuple[Floats, Floats] = moments(self.log_weight, self.x, self.p, first, count)
        return found

    def vts(self, index: int, hits: int) -> Floats:
        """Return rows (v, 14) of one filter's VTs with at least `hits` detections.

        Identity, link, position in m (3), its covariance in m^2 (9).
        """
        out = np.empty((int(self.count[index]), ENTRY))
        return out[: map_into(one_of(self.arrays, index), hits, out)]

    def take(self, kept: Ints) -> Bank:
        """Return the filters `kept` (n,), in that order."""
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
            slots=np.pad(self.slots, far), _scratch=None,
        )  # fmt: skip

    def _room(self, measured: Measured) -> Any:
        """Return scratch of the mode, made anew when a snapshot needs more."""
        had = self._scratch
        if had is None or len(had[-1] if self.mode == BELIEF else had.row_of) < len(measured.z):
            places, columns = self.anchor.shape[1], max(2 * len(measured.z), 32)
            self._scratch = scratch_of(self.x.shape[1], places, columns, measured.rules)
        return self._scratch


def scratch_of(size: int, places: int, columns: int, rules: Rules) -> Scratch | BeliefScratch:
    """Return room for filters of `size` states and so many VTs, and for so many measurements."""
    pairs, whole = (places, columns), np.int64
    h, t, narrow = np.empty((3, TOUCHED)), np.empty((3, size)), np.empty((3, TOUCHED))
    if rules.mode == BELIEF:
        beta, zeta, nu, marginal = (np.empty(pairs) for _ in range(4))
        return BeliefScratch(h, t, narrow, np.empty(places, whole), beta, zeta, nu, marginal, np.empty(columns))
    work = 4 * (places + columns + 2)
    return Scratch(
        h, t, narrow, np.empty(pairs), np.empty(places, whole), np.empty(columns, whole), np.empty(columns, whole),
        np.empty(columns, whole), np.empty(work), np.empty(work, whole), np.empty((PENDING, size)),
    )  # fmt: skip


def new_bank(setup: Setup, core: Core, mode: int, vts: int, offsets_m: Floats, offset_std_m: Floats) -> Bank:
    """Return K filters at the start without VTs, all links in use.

    Clock offsets (K, S) and their deviations (S,) in m.
    """
    filters, model = len(offsets_m), setup.odometry_model
    size = core.size + 3 * vts
    x, p = np.zeros((filters, size)), np.zeros((filters, *((core.size if mode == KNOWN_MAP else size,) * 2)))
    variance = np.zeros(core.size)
    variance[:POSE] = setup.start_std**2
    for of, std in ((core.bias, model.bias), (core.scale, model.scale)):
        variance[of[of >= 0]] = std[of >= 0] ** 2
    variance[core.offsets] = offset_std_m**2
    variance[core.rate[core.rate >= 0]] = setup.sites.drift_std_m_s[core.rate >= 0] ** 2
    x[:, :POSE], x[:, core.offsets] = setup.start_pose, offsets_m
    p[:, np.arange(core.size), np.arange(core.size)] = variance
    anchor = np.zeros((filters, vts, ANCHOR))
    anchor[:, :, SHARE] = 1.0
    return Bank(
        core, mode, x, p, anchor, np.zeros((filters, vts, SLOT), np.int64),
        np.zeros(filters, np.int64), np.ones((filters, len(setup.links)), np.int64), np.zeros(filters),
        np.empty((filters, LOST, ENTRY)), np.zeros(filters, np.int64),
    )  # fmt: skip


def vt_estimate(rows: Floats) -> VtEstimate:
    """Return rows (v, 14) of identity, link, position (m) and covariance (m^2) as VTs."""
    covariance = rows[:, SPREAD:].reshape(-1, 3, 3)
    ids, link = rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64)
    return VtEstimate(ids, link, rows[:, POSITION:SPREAD].copy(), 0.5 * (covariance + np.swapaxes(covariance, 1, 2)))
