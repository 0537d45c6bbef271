"""A mixture of joint filters: the arrays, and what is done to them from Python.

Source: Sorenson and Alspach, "Recursive Bayesian estimation using Gaussian sums", Automatica 7, 1971.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numba
import numpy as np

from cellslam.sim.recording import Floats, Ints
from cellslam.slam.api import VtEstimate
from cellslam.slam.joint.influence import Influence
from cellslam.slam.joint.map_states import Remembered
from cellslam.slam.joint.snapshot.birth_kernel import map_of
from cellslam.slam.joint.snapshot.gauge_kernel import carry_over
from cellslam.slam.joint.snapshot.motion_kernel import Interval
from cellslam.slam.joint.snapshot.snapshot_kernel import advance_mixture
from cellslam.slam.joint.state.layout import (
    BELIEF,
    EXISTS,
    FREE,
    HITS,
    IDENT,
    ILLUMINATOR,
    KIND,
    LAST,
    LINK,
    LOG_RATIO,
    MERGED,
    MOST_SCORE,
    POSITION,
    SCORE,
    SPREAD,
    SURVEYED,
    VT,
    VT_STATES,
    WEIGHT,
    ArrayErrors,
    Block,
    Core,
    Filter,
    Measured,
    Particles,
    block_of,
    one_of,
)
from cellslam.slam.joint.state.states_kernel import differing, owner_of
from cellslam.slam.model.measurement_model import jacobians
from cellslam.slam.model.pose_moments import mixture_moments

NEW_STATES, NEW_VTS = 160, 24  # that a snapshot may bring
# Bytes of all covariances. While a mixture grows there are two of its own; work space and what the process had before
# come to as much again: below 2 GB.
MOST_BYTES = 5e8
HYPOTHESES = 4  # times as many VTs as are kept, where a VT may begin as several hypotheses
KNOWN = 1000  # detections of a VT known before the drive
NO_ARRAY = np.empty(0)

Work = Callable[[int, int], object]  # done for every `step`-th filter, from the `first` on


def together(works: Sequence[Work], filters: Sequence[int]) -> None:
    """Do works, each for so many filters, in as many threads as may be; these take turns at all the filters."""
    shares = min(sum(filters), numba.get_num_threads())

    def share(turn: int) -> None:
        before = 0
        for work, count in zip(works, filters, strict=True):
            first = (turn - before) % shares
            before += count
            if first < count:
                work(first, shares)

    others = [_threads(os.getpid()).submit(share, turn) for turn in range(1, shares)]
    try:
        share(0)
    finally:
        wait(others)
    for other in others:
        other.result()


@cache
def _threads(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process that has this number: one that was forked has none of its parent's."""
    del process
    return ThreadPoolExecutor(thread_name_prefix="cellslam")


@dataclass
class Mixture:
    """K filters: `arrays`, each with a leading axis of at least K, their blocks, log-weights (K,), and the `influence`
    of VTs on these; the map that is `remembered`, if any; whether they are `full`: no state may enter any more; and how
    many mixtures there are `beside`, which share the memory."""

    arrays: Filter
    blocks: Block
    log_weight: Floats
    influence: Influence
    remembered: Remembered | None = None
    full: bool = False
    beside: int = 0

    def __len__(self) -> int:
        return len(self.log_weight)

    @property
    def best(self) -> int:
        """Which filter is the likeliest."""
        return int(np.argmax(self.log_weight))

    @property
    def likeliest(self) -> Filter:
        """The likeliest filter."""
        return one_of(self.arrays, self.best)

    def use(self, errors: ArrayErrors, interval: Interval, measured: Measured, most_vts: int) -> Ints:
        """Move every filter by an interval and use a snapshot; return the associations (K, m).

        Of VTs each keeps so many at most; those that were displaced stay in `lost` until the next snapshot.
        """
        return side_by_side([self], errors, interval, measured, most_vts)[0]

    def weigh(self, association: Ints, measured: Measured) -> None:
        """Take a snapshot and its associations (K, m) into the weights."""
        if len(self) == 1:
            return
        if measured.rules.association.mode in (FREE, BELIEF):  # else identities are those of paths
            self.influence.meet(self.arrays, association, measured.born, self.log_weight)
        if self.blocks.track.snapshots[0, 0] == 0:  # a block has ended
            self.log_weight = self.influence.weigh(self.arrays)

    def reserve_for(self, measured: Measured, most_vts: int) -> None:
        """Grow the arrays for what a snapshot may bring, VTs of a remembered map among it, as far as memory allows."""
        if self.remembered is not None:
            self._meet(self.remembered, measured.now)
        hypotheses = measured.births.hypotheses
        vts = most_vts * (HYPOTHESES if hypotheses else 1) - _most_of(self.arrays.count)
        new, free = NEW_STATES + 3 * hypotheses, max(self._most_states - _most_of(self.arrays.size), 0)
        self.full = self.full or free < new
        self.reserve(min(new, free), min(NEW_VTS + hypotheses, max(vts, 0)))
        self.arrays.lost.used[:] = 0

    def split(self, parents: Ints) -> None:
        """Add copies of some filters."""
        for double, parent in enumerate(parents.tolist(), len(self)):
            self._copy(parent, double)
        every = np.append(np.arange(len(self)), parents)
        self.log_weight, self.influence = self.log_weight[every], self.influence.of(every)

    def share_particles(self, count: int, resample: Callable[[Floats], Ints]) -> None:
        """Give each filter so many particles: of those that it has, `resample` of their weights chooses; the first ones
        are at its mean."""
        k, capacity, old, b = len(self), len(self.arrays.x), self.arrays.particles, self.blocks
        deviation, weight = np.zeros((*self.arrays.x.shape, count)), np.full((capacity, count), 1.0 / count)
        poses = np.zeros((*b.track.pose.shape, count))
        for i in range(k if old.weight.shape[1] else 0):
            ancestors = resample(old.weight[i])
            deviation[i], poses[i] = old.deviation[i][:, ancestors], b.track.deviation[i][..., ancestors]
            centre, before = deviation[i].mean(axis=1), self.arrays.x[i].copy()
            self.arrays.x[i] += centre
            deviation[i] -= centre[:, None]
            carry_over(one_of(self.arrays, i), before, np.empty((4, len(before))))
        self.arrays = self.arrays._replace(particles=Particles(deviation=deviation, weight=weight))
        self.blocks = b._replace(track=b.track._replace(deviation=poses))

    def _copy(self, source: int, target: int) -> None:
        """Make one filter a copy of another."""
        if target == len(self.arrays.x):
            self._resize(2 * target)
        n = int(self.arrays.size[source, 0])
        for array in (*_arrays(self.arrays), *_arrays(self.blocks)):
            if array is self.arrays.p:  # memory that is not used is not touched
                array[target, :n, :n] = array[source, :n, :n]
            else:
                array[target] = array[source]

    def _resize(self, filters: int) -> None:
        """Let the arrays hold so many filters, and no more."""
        old, more = self.arrays, filters - len(self.arrays.x)
        p = _covariances(old, filters, len(old.x[0]))
        self.arrays = _padded(old._replace(p=NO_ARRAY), more, 0)._replace(p=p)
        self.blocks = _padded(self.blocks, more, 0)

    def keep(self, kept: Ints) -> None:
        """Keep the filters `kept` (k,), and no others, in the order in which they are."""
        kept = np.sort(kept)
        for to, k in enumerate(kept.tolist()):
            if to != k:
                self._copy(k, to)
        self.log_weight, self.influence = self.log_weight[kept], self.influence.of(kept)
        if 2 * len(kept) < len(self.arrays.x):
            self._resize(len(kept))

    @property
    def _most_states(self) -> int:
        """How many states each filter can hold."""
        return int(math.sqrt(MOST_BYTES / (1 + self.beside) / 8.0 / len(self.arrays.x)))

    def reserve(self, states: int, vts: int) -> None:
        """Grow the arrays to hold so many more states and VTs."""
        arrays, width, vts_at_most = self.arrays, len(self.arrays.x[0]), len(self.arrays.vts.slots[0])
        if _most_of(arrays.size) + states > width:
            more = max(min(width // 2, self._most_states - width), states)
            arrays = arrays._replace(
                x=_padded(arrays.x, more, 1), owner=_padded(arrays.owner, more, 1),
                p=_covariances(arrays, len(arrays.x), width + more),
                particles=arrays.particles._replace(deviation=_padded(arrays.particles.deviation, more, 1)),
            )  # fmt: skip
        if _most_of(arrays.count) + vts > vts_at_most:
            more = max(vts_at_most // 2, vts)
            arrays = arrays._replace(vts=_padded(arrays.vts, more, 1))
            self.blocks = self.blocks._replace(sums=_padded(self.blocks.sums, more, 1))
        self.arrays = arrays

    def weights(self) -> Floats:
        """Return the weights (K,), which sum to one."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(weight / weight.sum())

    def know(self, link: Ints, ident: Ints, position_m: Floats, std_m: Floats, last: int) -> None:
        """Put VTs on links (v,) into filters that have none, at positions (v, 3) in the world, whose errors have
        deviations (v, 3) in x, y and z; those that stand at one position err alike.

        `last`: snapshot in which they were last seen.
        """
        self.reserve(3 * len(link), len(link))
        f, first = self.arrays, self.core.size
        here = f.x[0, :3].copy()
        f.count[:], f.size[:], f.illuminators[:, link] = len(link), first + 3 * len(link), np.arange(len(link))
        for j, offset in enumerate(position_m - here):
            f.vts.slots[:, j, [LINK, HITS, LAST, IDENT, SURVEYED, ILLUMINATOR]] = link[j], KNOWN, last, ident[j], 1, -1
            f.vts.anchor[:, j, :3] = here
            f.vts.anchor[:, j, [EXISTS, WEIGHT]], f.vts.anchor[:, j, [MERGED, LOG_RATIO]] = 1.0, 0.0
            f.vts.anchor[:, j, SCORE] = MOST_SCORE
            at = first + 3 * j + np.arange(3)
            f.vts.state[:, j], f.vts.state[:, j, VT : VT + 3] = -1, at
            f.owner[:, at] = [owner_of(j, VT + c, VT_STATES) for c in range(3)]
            f.x[:, at] = _spherical(offset)
        if std_m.any():
            load = jacobians(np.append(here, np.zeros(3)), position_m)[0] * std_m[:, None]
            alike = (position_m[:, None] == position_m).all(axis=2)
            at = first + np.arange(3 * len(link))
            f.p[:, at[:, None], at] = np.einsum("jk,jac,kbc->jakb", alike, load, load).reshape(len(at), -1)

    def _meet(self, remembered: Remembered, now: int) -> None:
        """Let VTs of a remembered map enter all filters as they come into reach of the likeliest one, and leave them,
        where they were not seen, as they go out of it."""
        place = self.likeliest.x[:3]
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
        return mixture_moments(self.weights(), self.arrays.x[:k, core], self.covariances(core))

    def covariances(self, of: slice) -> Floats:
        """Return the covariances (K, n, n) of some states in each filter, with those of its particles' means."""
        k = len(self)
        shared, particles = self.arrays.p[:k, of, of], self.arrays.particles
        d, w = particles.deviation[:k, of], particles.weight[:k]
        return shared if not w.shape[1] else shared + (d * w[:, None]) @ np.swapaxes(d, 1, 2)

    def collapsed(self) -> Mixture:
        """Return the same belief without particles: what was in them is in the covariances."""
        k, a = len(self), self.arrays
        deviation, weight = a.particles
        if not weight.shape[1]:
            return self
        p = np.zeros_like(a.p)
        for i, n in enumerate(a.size[:k, 0].tolist()):
            d = deviation[i, :n]
            p[i, :n, :n] = a.p[i, :n, :n] + (d * weight[i]) @ d.T
        none = a._replace(p=p, particles=Particles(deviation[:, :, :0].copy(), weight[:, :0].copy()))
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
        """Return the confirmed VTs (v, 15) of one filter that were displaced in the last snapshot, as `vts` does."""
        return self.arrays.lost.rows[index, : int(self.arrays.lost.used[index, 0])]

    def vts(self, index: int, hits: int) -> Floats:
        """Return the confirmed VTs (v, 15) of a filter, with at least `hits` detections, as `map_of` does."""
        return map_of(self.arrays, index, hits)


def side_by_side(
    mixtures: Sequence[Mixture], errors: ArrayErrors, interval: Interval, measured: Measured, most_vts: int
) -> list[Ints]:
    """Use a snapshot in all filters of some mixtures, as `Mixture.use` does; return each mixture's associations (K,
    m)."""
    associations = [np.full((len(mixture), len(measured.z)), -1) for mixture in mixtures]
    works = []
    for mixture, association in zip(mixtures, associations, strict=True):
        mixture.reserve_for(measured, most_vts)
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


def _arrays(tables: Any) -> Iterator[Any]:
    """Yield the arrays of a filter or a block, those of the layout aside."""
    for one in tables:
        if isinstance(one, np.ndarray):
            yield one
        elif not isinstance(one, Core):
            yield from _arrays(one)


def _covariances(old: Filter, filters: int, states: int) -> Floats:
    """Return the covariances in arrays for so many filters and states; memory that is not used is not touched."""
    p = np.zeros((filters, states, states))
    for k, n in enumerate(old.size[:filters, 0].tolist()):
        p[k, :n, :n] = old.p[k, :n, :n]
    return p


def _padded(tables: Any, more: int, axis: int) -> Any:
    """Return an array, or all arrays of a filter or a block, with so many zeros more along an axis, or so many less."""
    if isinstance(tables, Core):
        return tables
    if not isinstance(tables, np.ndarray):
        return type(tables)(*(_padded(one, more, axis) for one in tables))
    if more < 0:
        return tables[:more].copy()
    width = [(0, 0)] * tables.ndim
    width[axis] = (0, more)
    return np.pad(tables, width)


def vt_estimate(rows: Floats) -> VtEstimate:
    """Return rows (v, 15) of identity, link, position (m), covariance (m^2) and kind as VTs."""
    ids, link = rows[:, :POSITION].T.astype(np.int64)
    position, covariance = rows[:, POSITION:SPREAD], rows[:, SPREAD:KIND].reshape(-1, 3, 3)
    scatterer = rows[:, KIND].astype(np.int64)
    return VtEstimate(ids, link, position, covariance, scatterer if scatterer.any() else None)
