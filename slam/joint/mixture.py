"""A mixture of joint filters: the arrays, and what is done to them from Python.

Source: Sorenson and Alspach, "Recursive Bayesian estimation using Gaussian sums", Automatica 7, 1971.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import Setup, VtEstimate
from cellslam.slam.joint.influence import Influence
from cellslam.slam.joint.map_states import Remembered
from cellslam.slam.joint.snapshot.birth_kernel import map_of
from cellslam.slam.joint.snapshot.motion_kernel import Interval
from cellslam.slam.joint.snapshot.sizes_kernel import SIZES
from cellslam.slam.joint.snapshot.snapshot_kernel import advance_mixture
from cellslam.slam.joint.state.layout import (
    ANCHOR,
    BELIEF,
    ENTRY,
    EXISTS,
    FREE,
    HITS,
    IDENT,
    LAST,
    LINK,
    MERGED,
    NOBODY,
    POSE,
    POSITION,
    SHARE,
    SLOT,
    SPREAD,
    VT,
    VT_STATES,
    WORTH,
    ArrayErrors,
    Block,
    Core,
    Filter,
    Measured,
    block_of,
    one_of,
)
from cellslam.slam.joint.state.states_kernel import differing, owner_of
from cellslam.slam.model.pose_moments import mixture_moments
from cellslam.slam.model.threads import in_threads, threads

LONGEST = 16  # snapshots in a block at most
STATES, VTS = 256, 48  # room of a new filter
MOST_STATES = 2040  # that a filter of all sites has, as a rule: memory that is not used costs nothing
NEW_STATES, NEW_VTS = 160, 24  # that a snapshot may bring
LOST = 64  # confirmed VTs that one block can push out
ROOM = 4  # times as many VTs as are kept, where a VT may begin as several guesses
KNOWN = 1000  # detections of a VT known before the drive


def core_of(setup: Setup, errors: ArrayErrors, drawn: int = 0) -> Core:
    """Return the layout of the states that are always there; `drawn`: blocks of which the noise is a state."""
    common = 0 if setup.map is None else setup.map.common_m.shape[2]
    model = setup.odometry_model
    bias, scale, noise, sway = *(np.full(POSE, -1, np.int64) for _ in range(3)), np.full(3, -1, np.int64)
    biased, scaled = np.flatnonzero((model.bias > 0) | (model.bias_walk_density > 0)), np.flatnonzero(model.scale)
    noisy = np.flatnonzero(model.noise_density)
    at = POSE
    if errors.sway.any():
        sway, at = at + np.arange(3), at + 3
    ground = at if errors.ground > 0.0 else -1
    at += errors.ground > 0.0
    bias[biased] = at + np.arange(len(biased))
    scale[scaled] = at + len(biased) + np.arange(len(scaled))
    noise[noisy] = at + len(biased) + len(scaled) + np.arange(len(noisy))
    first = at + len(biased) + len(scaled) + len(noisy)
    wander = setup.sites.walk_densities
    drifts, after = (setup.sites.drift_std_m_s > 0.0) | (wander[1] > 0.0), first + len(setup.sites)
    rate = np.where(drifts, after + np.cumsum(drifts) - 1, -1).astype(np.int64)
    end = after + int(drifts.sum())
    step_m = np.array(setup.sites.step_std_m)  # one that can be written: for others the kernels would be compiled again
    sums = np.full((drawn, POSE), -1, np.int64)
    sums[:, noisy] = end + np.arange(drawn * len(noisy)).reshape(drawn, len(noisy))
    end += drawn * len(noisy)
    return Core(sway, ground, bias, scale, noise, first, rate, wander, step_m, sums, end, end + common)


Tables = TypeVar("Tables", Filter, Block)
OF_VTS, OF_BLOCKS = (
    ("vt_state", "anchor", "slots", "spread"),
    ("detections", "seen", "e", "q", "measured", "diffuse", "odds"),
)


Work = Callable[[int, int], object]  # done for every `step`-th filter, from the `first` on


def together(works: Sequence[Work], filters: Sequence[int]) -> None:
    """Do works, each for so many filters, in as many threads as may be; these take turns at all the filters."""
    shares = min(sum(filters), threads())

    def share(turn: int) -> None:
        before = 0
        for work, count in zip(works, filters, strict=True):
            first = (turn - before) % shares
            before += count
            if first < count:
                work(first, shares)

    in_threads(share, shares)


@dataclass
class Mixture:
    """K filters: `arrays`, each with a leading axis of at least K, their blocks, log-weights (K,), and the `influence`
    of VTs on these; the map that they `remember`, if any."""

    arrays: Filter
    blocks: Block
    log_weight: Floats
    influence: Influence
    remembered: Remembered | None = None

    def __len__(self) -> int:
        return len(self.log_weight)

    def use(self, errors: ArrayErrors, interval: Interval, measured: Measured, most_vts: int) -> Ints:
        """Move every filter by an interval and use a snapshot; return the associations (K, m).

        Of VTs each keeps so many at most; those that make room stay in `lost` until the next snapshot.
        """
        return side_by_side([self], errors, interval, measured, most_vts)[0]

    def weigh(self, association: Ints, measured: Measured) -> None:
        """Take a snapshot and its associations (K, m) into the weights."""
        if len(self) == 1:
            return
        if measured.rules.association.mode in (FREE, BELIEF):  # else identities are those of paths
            self.influence.meet(self.arrays, association, measured.born, self.log_weight)
        if self.blocks.snapshots[0, 0] == 0:  # a block has ended
            self.log_weight = self.influence.weigh(self.arrays)

    def make_room(self, measured: Measured, most_vts: int) -> None:
        """Make room for what a snapshot may bring, VTs of a remembered map among it."""
        if self.remembered is not None:
            self._meet(self.remembered, measured.now)
        guesses = measured.births.guesses
        room = most_vts * (ROOM if guesses else 1) - _most_of(self.arrays.count)
        self.reserve(NEW_STATES + 3 * guesses, min(NEW_VTS + guesses, max(room, 0)))
        self.arrays.losses[:] = 0

    def split(self, parents: Ints) -> None:
        """Add copies of some filters."""
        for double, parent in enumerate(parents.tolist(), len(self)):
            self._copy(parent, double)
        every = np.append(np.arange(len(self)), parents)
        self.log_weight, self.influence = self.log_weight[every], self.influence.of(every)

    def share_particles(self, count: int, resample: Callable[[Floats], Ints]) -> None:
        """Give each filter so many particles: of those that it has, `resample` of their weights chooses; the first ones
        are at its mean."""
        k, rooms, a, b = len(self), len(self.arrays.x), self.arrays, self.blocks
        deviation, weight = np.zeros((*a.x.shape, count)), np.full((rooms, count), 1.0 / count)
        poses = np.zeros((*b.pose.shape, count))
        for i in range(k if a.weight.shape[1] else 0):
            ancestors = resample(a.weight[i])
            deviation[i], poses[i] = a.deviation[i][:, ancestors], b.deviation[i][..., ancestors]
            centre = deviation[i].mean(axis=1)
            a.x[i] += centre
            deviation[i] -= centre[:, None]
        self.arrays = a._replace(deviation=deviation, weight=weight)
        self.blocks = b._replace(deviation=poses)

    def _copy(self, source: int, target: int) -> None:
        """Make one filter a copy of another."""
        if target == len(self.arrays.x):
            self._resize(2 * target)
        n = int(self.arrays.size[source, 0])
        for name, array in (*self.arrays._asdict().items(), *self.blocks._asdict().items()):
            if name == "p":
                array[target, :n, :n] = array[source, :n, :n]
            elif name != "core":
                array[target] = array[source]

    def _resize(self, filters: int) -> None:
        """Make room for so many filters, and no more."""
        old, more = self.arrays, filters - len(self.arrays.x)
        of_filters = tuple(name for name in Filter._fields if name not in ("core", "p"))
        self.arrays, self.blocks = _with_rows(old, of_filters, more, 0), _with_rows(self.blocks, Block._fields, more, 0)
        self.arrays = self.arrays._replace(p=_covariances(old, filters, len(old.x[0])))

    def keep(self, kept: Ints) -> None:
        """Keep the filters `kept` (k,), and no others, in the order in which they are."""
        kept = np.sort(kept)
        for place, k in enumerate(kept.tolist()):
            if place != k:
                self._copy(k, place)
        self.log_weight, self.influence = self.log_weight[kept], self.influence.of(kept)
        if 2 * len(kept) < len(self.arrays.x):
            self._resize(len(kept))

    def reserve(self, states: int, vts: int) -> None:
        """Grow the arrays to have room for so many more states and VTs."""
        arrays, blocks, width, places = self.arrays, self.blocks, len(self.arrays.x[0]), len(self.arrays.slots[0])
        if _most_of(arrays.size) + states > width:
            more = max(width // 2, states)
            p = _covariances(arrays, len(arrays.x), width + more)
            arrays = arrays._replace(
                x=_padded(arrays.x, more), owner=_padded(arrays.owner, more), p=p,
                deviation=_padded(arrays.deviation, more, 1),
            )  # fmt: skip
        if _most_of(arrays.count) + vts > places:
            more = max(places // 2, vts)
            arrays, blocks = _with_rows(arrays, OF_VTS, more), _with_rows(blocks, OF_BLOCKS, more)
        self.arrays, self.blocks = arrays, blocks

    def shares(self) -> Floats:
        """Return the weights (K,), which sum to one."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(weight / weight.sum())

    def know(self, link: Ints, ident: Ints, position_m: Floats, last: int) -> None:
        """Put VTs on links (v,) into filters that have none, at positions (v, 3) in the world, without uncertainty.

        `last`: snapshot in which they were last seen.
        """
        self.reserve(3 * len(link), len(link))
        f, first = self.arrays, self.core.size
        here = f.x[0, :3].copy()
        f.count[:], f.size[:] = len(link), first + 3 * len(link)
        for j, offset in enumerate(position_m - here):
            f.slots[:, j, [LINK, HITS, LAST, IDENT]] = link[j], KNOWN, last, ident[j]
            f.anchor[:, j, :3], f.anchor[:, j, [EXISTS, SHARE]], f.anchor[:, j, [MERGED, WORTH]] = here, 1.0, 0.0
            at = first + 3 * j + np.arange(3)
            f.vt_state[:, j], f.vt_state[:, j, VT : VT + 3] = -1, at
            f.owner[:, at] = [owner_of(j, VT + c, VT_STATES) for c in range(3)]
            f.x[:, at] = _spherical(offset)

    def _meet(self, remembered: Remembered, now: int) -> None:
        """Let VTs of a remembered map enter all filters as they come into reach of the likeliest one, and leave them,
        where they were not seen, as they go out of it."""
        place = self.arrays.x[int(np.argmax(self.log_weight)), :3]
        enter, leave = remembered.moved(place[:2], self.arrays.links[0])
        if not len(enter) and not len(leave):
            return
        self.reserve(3 * len(enter), len(enter))
        for k in range(len(self)):
            remembered.take_out(one_of(self.arrays, k), block_of(self.blocks, k), leave)
            remembered.put_in(one_of(self.arrays, k), block_of(self.blocks, k), enter, now)

    def moments(self) -> tuple[Floats, Floats]:
        """Return mean (c,) and covariance (c, c), in m and rad, of the states from the pose to the clock offsets, over
        all filters."""
        core, k = slice(0, self.core.offsets.stop), len(self)
        if k == 1:
            return self.arrays.x[0, core].copy(), self.covariances(core)[0].copy()
        return mixture_moments(self.shares(), self.arrays.x[:k, core], self.covariances(core))

    def covariances(self, of: slice) -> Floats:
        """Return the covariances (K, n, n) of some states in each filter, with those of its particles' means."""
        k = len(self)
        shared, d, w = self.arrays.p[:k, of, of], self.arrays.deviation[:k, of], self.arrays.weight[:k]
        return shared if not w.shape[1] else shared + (d * w[:, None]) @ np.swapaxes(d, 1, 2)

    def collapsed(self) -> Mixture:
        """Return the same belief without particles: what was in them is in the covariances."""
        k, a = len(self), self.arrays
        if not a.weight.shape[1]:
            return self
        p = np.zeros_like(a.p)
        for i, n in enumerate(a.size[:k, 0].tolist()):
            d = a.deviation[i, :n]
            p[i, :n, :n] = a.p[i, :n, :n] + (d * a.weight[i]) @ d.T
        none = a._replace(p=p, deviation=a.deviation[:, :, :0].copy(), weight=a.weight[:, :0].copy())
        return replace(self, arrays=none)

    @property
    def core(self) -> Core:
        """The layout of the states that are always there."""
        return self.arrays.core

    def apart(self, of: slice, ratio: float, more: bool = False) -> Ints:
        """Return the filters that are not less likely than the best by this ratio, and whose states `of` differ from
        those of all likelier ones, by `more` the less likely they are, the likeliest first."""
        likely = np.argsort(-self.log_weight, kind="stable")
        likely = likely[self.log_weight[likely] >= self.log_weight.max() + math.log(ratio)]
        log_odds = self.log_weight if more else np.zeros(len(self))
        return differing(self.arrays.x[:, of], self.covariances(of), log_odds, likely)

    def lost(self, index: int) -> Floats:
        """Return the confirmed VTs (v, 14) of one filter that made room in the last snapshot, as `vts` does."""
        return self.arrays.lost[index, : int(self.arrays.losses[index, 0])]

    def vts(self, index: int, hits: int) -> Floats:
        """Return identity, link, position (m), covariance (v, 14) of a filter's VTs with at least `hits` detections."""
        return map_of(self.arrays, index, hits)


def side_by_side(
    mixtures: Sequence[Mixture], errors: ArrayErrors, interval: Interval, measured: Measured, most_vts: int
) -> list[Ints]:
    """Use a snapshot in all filters of some mixtures, as `Mixture.use` does; return each mixture's associations (K,
    m)."""
    associations = [np.full((len(mixture), len(measured.z)), -1) for mixture in mixtures]
    works = []
    for mixture, association in zip(mixtures, associations, strict=True):
        mixture.make_room(measured, most_vts)
        at = mixture.arrays, errors, mixture.blocks, interval, measured, association, mixture.influence.rest
        works.append(partial(advance_mixture, *at))
    together(works, [len(mixture) for mixture in mixtures])
    for mixture, association in zip(mixtures, associations, strict=True):
        mixture.weigh(association, measured)
    return associations


def _most_of(counts: Ints) -> int:
    """Return the greatest of the counts (K, 1) of a few filters."""
    return int(max(counts[:, 0].tolist()))


def _spherical(vector: Floats) -> Floats:
    """Return length, azimuth and elevation (3,)."""
    flat = np.hypot(vector[0], vector[1])
    return np.array([np.hypot(flat, vector[2]), np.arctan2(vector[1], vector[0]), np.arctan2(vector[2], flat)])


def _with_rows(tables: Tables, names: tuple[str, ...], more: int, axis: int = 1) -> Tables:
    """Return a NamedTuple whose arrays (K, V, ...) of these names have so many filters or VTs more."""
    return tables._replace(**{name: _padded(getattr(tables, name), more, axis) for name in names})


def _covariances(old: Filter, filters: int, states: int) -> Floats:
    """Return the covariances with room for so many filters and states; memory that is not used is not touched."""
    p = np.zeros((filters, states, states))
    for k, n in enumerate(old.size[:filters, 0].tolist()):
        p[k, :n, :n] = old.p[k, :n, :n]
    return p


def _padded(array: Any, more: int, axis: int = -1) -> Any:
    """Return an array (K, ...) with so many zeros more along an axis, or with so many filters less."""
    if more < 0:
        return array[:more].copy()
    width = [(0, 0)] * array.ndim
    width[axis] = (0, more)
    return np.pad(array, width)


def vt_estimate(rows: Floats) -> VtEstimate:
    """Return rows (v, 14) of identity, link, position (m) and covariance (m^2) as VTs."""
    ids, link = rows[:, :POSITION].T.astype(np.int64)
    return VtEstimate(ids, link, rows[:, POSITION:SPREAD], rows[:, SPREAD:].reshape(-1, 3, 3))


def new_mixture(
    setup: Setup, core: Core, errors: ArrayErrors, offsets_m: Floats, offset_std_m: Floats, vts: int = VTS,
    states: int = STATES,
) -> Mixture:  # fmt: skip
    """Return K filters at the start, without VTs.

    offsets_m (K, S): clock offsets, offset_std_m (S,): their deviations. All links are in use.
    """
    k, model, whole, vts = len(offsets_m), setup.odometry_model, np.int64, min(vts, VTS)
    x, p, variance = np.zeros((k, states)), np.zeros((k, states, states)), np.zeros(core.size)
    variance[:POSE] = setup.start_std**2
    variance[4:POSE] = np.maximum(variance[4:POSE], errors.tilt**2)
    if core.sway[0] >= 0:
        variance[core.sway] = errors.sway**2
    if core.ground >= 0:
        variance[core.ground] = errors.ground**2
    for of, std in ((core.bias, model.bias), (core.scale, model.scale)):
        variance[of[of >= 0]] = std[of >= 0] ** 2
    variance[core.offsets] = offset_std_m**2
    variance[core.common] = 1.0
    variance[core.rate[core.rate >= 0]] = setup.sites.drift_std_m_s[core.rate >= 0] ** 2
    x[:, :POSE], x[:, core.offsets] = setup.start_pose, offsets_m
    p[:, np.arange(core.size), np.arange(core.size)] = variance
    weights = sum(
        int((std > 0.0).sum()) * grid.cells
        for std, grid in ((errors.calibration, errors.calibration_grid), (errors.roof, errors.roof_grid))
    )
    anchor = np.zeros((k, vts, ANCHOR))
    anchor[:, :, SHARE] = 1.0
    arrays = Filter(
        core=core, x=x, p=p, size=np.full((k, 1), core.size), owner=np.full((k, states), NOBODY),
        weight_state=np.full((k, weights), -1), weight_met=np.zeros((k, weights), whole),
        vt_state=np.full((k, vts, VT_STATES), -1), anchor=anchor, slots=np.zeros((k, vts, SLOT), whole),
        count=np.zeros((k, 1), whole), links=np.ones((k, len(setup.links)), whole), lost=np.zeros((k, LOST, ENTRY)),
        losses=np.zeros((k, 1), whole), sizes=np.zeros((k, 3, SIZES)), summed=np.zeros((k, 1)),
        surprise=np.zeros((k, 2)), deviation=np.zeros((k, states, 0)), weight=np.zeros((k, 0)),
        spread=np.zeros((k, vts, 6)),
    )  # fmt: skip
    blocks = Block(
        snapshots=np.zeros((k, 1), whole), pose=np.zeros((k, LONGEST, POSE)), at=np.zeros((k, LONGEST, 2)),
        total=np.zeros((k, 3)), detections=np.zeros((k, vts), whole), seen=np.zeros((k, vts, LONGEST), whole),
        e=np.zeros((k, vts, 3)), q=np.zeros((k, vts, 3)), measured=np.zeros((k, vts, 3)), diffuse=np.zeros((k, vts)),
        odds=np.zeros((k, vts)), shift=np.zeros((k, len(core.rate), 2)), deviation=np.zeros((k, LONGEST, POSE, 0)),
    )  # fmt: skip
    return Mixture(arrays, blocks, np.zeros(k), Influence(np.zeros(k)))
