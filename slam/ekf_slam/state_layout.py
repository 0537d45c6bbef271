"""What travels together through the compiled filters, and where things stand in their arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup

# Integers of a VT slot: link, detections, snapshot of the last one, identity.
LINK, HITS, LAST, IDENT, SLOT = range(5)
# Behind the three coordinates of an anchor: the probability that the VT exists and is visible (belief propagation);
# and what share a guess has in its VT (1: the only one, 0: given up).
EXISTS, SHARE, ANCHOR = range(3, 6)
# What the measurements may do to the map.
FREE, KNOWN_ASSOCIATION, KNOWN_MAP, BELIEF = range(4)
# States of the pose: place, and yaw, pitch, roll. Columns of H, which are those of the states that one measurement
# touches: the pose, the clock offset of its site, the VT.
POSE = 6
OFFSET, VT, TOUCHED = POSE, POSE + 1, POSE + 4
# A VT of the map: identity, link, position (3), covariance (9).
POSITION, SPREAD, ENTRY = 2, 5, 14


class Core(NamedTuple):
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
        bias, scale = np.full(POSE, -1, np.int64), np.full(POSE, -1, np.int64)
        biased, scaled = np.flatnonzero((model.bias > 0) | (model.bias_walk_density > 0)), np.flatnonzero(model.scale)
        bias[biased] = POSE + np.arange(len(biased))
        scale[scaled] = POSE + len(biased) + np.arange(len(scaled))
        first = POSE + len(biased) + len(scaled)
        drifts, after = setup.sites.drift_std_m_s > 0.0, first + len(setup.sites)
        rate = np.where(drifts, after + np.cumsum(drifts) - 1, -1).astype(np.int64)
        return Core(bias, scale, first, rate, after + int(drifts.sum()))


class Filter(NamedTuple):
    """One filter, with places for V VTs; or a bank of them, all arrays with a leading axis.

    mean `x` (N,), covariance `p` (N, N), N = core + 3 V: VTs are range, azimuth, elevation (m, rad, world) about their
    `anchor` (V, 5); `slots` (V, 4); `count` (1,): VTs; `links` (L,): 1 where it uses a link; confirmed VTs that were
    given up are in `lost` (E, 14), `losses` (1,) of them. Without `mapped` the VTs are exact, and N = core in p.
    """

    core: Core
    mapped: bool
    x: Floats
    p: Floats
    anchor: Floats
    slots: Ints
    count: Ints  # type: ignore[assignment]  # hides tuple.count
    links: Ints
    lost: Floats
    losses: Ints


class Rules(NamedTuple):
    """Options of the compiled filters.

    `mode`: what the measurements may do to the map; `log_clutter`: log of the clutter density; `gate`: squared
    Mahalanobis distance; `birth`: what a birth adds to the log-likelihood (belief propagation: the odds of a new VT
    against clutter); `confirm`: detections that confirm a VT; `age_once`, `age_twice`: snapshots after which one that
    was seen once, or a few times, is dropped. Belief propagation: probabilities that a visible VT stays so, that a
    hidden one comes `back`, of `detection`, and below which a VT is given up, `drop`.
    """

    mode: int
    log_clutter: float
    gate: float
    birth: float
    confirm: int
    age_once: int
    age_twice: int
    stay: float = 1.0
    back: float = 0.0
    detection: float = 1.0
    drop: float = 0.0


class Measured(NamedTuple):
    """One snapshot of m measurements as the kernels take it, snapshot number `now`.

    `born`: identity of measurement 0 as a VT; `first` (L + 1,): first measurement of each link; `site_of` (L,); `z`,
    `single`, `many` (m, 3), `gap`, `lack` (m,): see `front_end.readings`; `begin`, `begin_q` (m, 3): measurements as
    births take them, with a prior where there is no elevation; `given` (m,): true VT of each measurement in mode
    KNOWN_ASSOCIATION; `tables` (2, 2, H): see `front_end.visibility.existence`.
    """

    now: int
    born: int
    first: Ints
    site_of: Ints
    z: Floats
    single: Floats
    many: Floats
    gap: Floats
    lack: Floats
    begin: Floats
    begin_q: Floats
    given: Ints
    tables: Floats
    rules: Rules


class Scratch(NamedTuple):
    """Room for one filter at a time: Jacobian `h` (3, 10), `t` = H P (3, N) and, where H touches, `narrow` (3, 10);
    `score` (C, m), VTs `chosen` (C,) of its rows; of m measurements `row_of`, `gated`, `slot_of`; the assignment's
    `work_f` and `work_i`; `pending`: rows of what a snapshot takes off the covariance.
    """

    h: Floats
    t: Floats
    narrow: Floats
    score: Floats
    chosen: Ints
    row_of: Ints
    gated: Ints
    slot_of: Ints
    work_f: Floats
    work_i: Ints
    pending: Floats


class BeliefScratch(NamedTuple):
    """Room for belief propagation in one filter: `h`, `t`, `narrow`, `chosen` as in Scratch; messages `beta`, `zeta`,
    `nu` and `marginal` (C, m), `xi` (m,): see `belief_kernel.pass_messages`."""

    h: Floats
    t: Floats
    narrow: Floats
    chosen: Ints
    beta: Floats
    zeta: Floats
    nu: Floats
    marginal: Floats
    xi: Floats


@njit(cache=True)
def one_of(bank: Filter, k: int) -> Filter:
    """Return filter k of a bank."""
    return Filter(
        bank.core, bank.mapped, bank.x[k], bank.p[k], bank.anchor[k], bank.slots[k], bank.count[k : k + 1],
        bank.links[k], bank.lost[k], bank.losses[k : k + 1],
    )  # fmt: skip


@njit(cache=True)
def states(f: Filter) -> int:
    """Return how many states of a filter are in use."""
    return f.core.size + 3 * f.count[0] if f.mapped else f.core.size


@njit(cache=True)
def same_vt(f: Filter, i: int, link: int, ident: int) -> bool:
    """Return whether slot i holds a VT, or a guess of it, of this identity on a link."""
    return bool(f.slots[i, IDENT] == ident and f.slots[i, LINK] == link)
