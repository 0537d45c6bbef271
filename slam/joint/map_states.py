"""A remembered map in joint filters: what they begin with, VTs that come into reach, and the map that a drive leaves.

The errors u that the map's VTs have in common are states from the start; a VT enters as it comes into reach, as
position + common u + own, with the covariances that follow: the exact marginal of the joint prior, given all that was
learnt so far. What a drive learns of u holds for the VTs that it never met, too.

With x the VTs in the state, the drive leaves one Gaussian of (x, u): its root gives what is common to the VTs that were
seen; a VT that was not seen is position + common u + own as before (`map_after`).

Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990 (states that stay).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import unit_vector
from cellslam.sim.recording import Floats, Ints, Links
from cellslam.slam.joint.snapshot.birth_kernel import clear, remove
from cellslam.slam.joint.state.layout import (
    EXISTS,
    HITS,
    IDENT,
    KIND,
    LINK,
    LOG_RATIO,
    MERGED,
    MOST_SCORE,
    POSITION,
    SCATTERER,
    SCORE,
    SPREAD,
    SURVEYED,
    UNSEEN,
    VT,
    VT_STATES,
    WEIGHT,
    Block,
    Filter,
)
from cellslam.slam.joint.state.states_kernel import owner_of
from cellslam.slam.model.measurement_model import jacobians, predict
from cellslam.slam.model.vt_map import VtMap, joined

REACH_M, PASSED_M = 20.0, 5.0  # from where a VT was seen: it is looked for; it should be seen
WIDENED = 1.1  # covariances after each drive: what no filter models, as paths that merge, recurs at the same places
FORGOTTEN = 2  # drives past a VT without a detection after which it is no longer there
MOST_NEAR = 60  # VTs that enter at most; those with most detections


class Remembered:
    """A map as the filters of a mixture take it in; its VTs have the identities from `first_ident` on."""

    def __init__(self, known: VtMap, links: Links, sites: tuple[str, ...], first_ident: int) -> None:
        """Take a map and, of the filters, their links and the names of their sites."""
        number = {key: link for link, key in enumerate(keys_of(links, sites))}
        keys = zip(known.site.tolist(), known.cell_id.tolist(), known.port.tolist(), strict=True)
        self.known, self.first_ident = known, first_ident
        self.link = np.array([number.get(key, -1) for key in keys], np.int64)
        self._inside = np.zeros(len(known), np.bool_)
        self.passed = np.zeros(len(known), np.bool_)

    def afresh(self) -> Remembered:
        """Return the map for another mixture, into which none of its VTs has come yet."""
        out = copy(self)
        out._inside, out.passed = np.zeros_like(self._inside), np.zeros_like(self.passed)
        return out

    def moved(self, place: Floats, used: Ints) -> tuple[Ints, Ints]:
        """Return the VTs on links in use (L,) that come into reach of a place (2,) in m, and those that leave it."""
        low, high = np.swapaxes(self.known.seen_m, 0, 1)
        away = np.maximum(np.maximum(low - place, place - high), 0.0).max(axis=1, initial=0.0)
        here = (self.link >= 0) & (used[self.link] == 1)
        self.passed |= here & (away <= PASSED_M)
        enter = np.flatnonzero(here & (away <= REACH_M) & ~self._inside)
        leave = np.flatnonzero((away > 2.0 * REACH_M) & self._inside)
        self._inside[leave] = False
        most = max(MOST_NEAR - int(self._inside.sum()), 0)
        enter = enter[np.argsort(-self.known.hits[enter], kind="stable")][:most]
        self._inside[enter] = True
        return enter, leave

    def put_in(self, f: Filter, b: Block, which: Ints, now: int) -> None:
        """Let VTs (v,) of the map enter a filter whose arrays can hold them, as if they had been seen in the snapshot
        before `now`."""
        there = set(f.vts.slots[: f.count[0], IDENT].tolist())
        which = which[[self.first_ident + j not in there for j in which.tolist()]]
        if not len(which):
            return
        known, common, count, size = self.known, f.core.common, int(f.count[0]), int(f.size[0])
        position = known.position_m[which] + known.common_m[which] @ f.x[common]
        anchor = standing(known.anchor_m[which])
        by = jacobians(anchor, position)[0]
        load = (by @ known.common_m[which]).reshape(3 * len(which), -1)
        at = size + np.arange(3 * len(which))
        f.x[at] = predict(anchor, position).ravel()
        f.particles.deviation[at] = load @ f.particles.deviation[common]
        f.p[at, :size] = load @ f.p[common, :size]
        f.p[:size, at] = f.p[at, :size].T
        f.p[at[:, None], at] = f.p[at, common] @ load.T
        for n, own in enumerate(by @ known.own_m2[which] @ np.swapaxes(by, 1, 2)):
            f.p[size + 3 * n : size + 3 * n + 3, size + 3 * n : size + 3 * n + 3] += own
        for n, vt in enumerate(which.tolist()):
            j, at = count + n, size + 3 * n + np.arange(3)
            f.vts.slots[j] = self.link[vt], known.hits[vt], now - 1, self.first_ident + vt, 1, 0, 0, 0, -1
            f.vts.anchor[j, :3] = known.anchor_m[vt]
            f.vts.anchor[j, [EXISTS, WEIGHT]], f.vts.anchor[j, [MERGED, LOG_RATIO]] = 1.0, 0.0
            f.vts.anchor[j, SCORE] = MOST_SCORE
            f.vts.state[j], f.vts.state[j, VT : VT + 3] = -1, at
            f.owner[at] = [owner_of(j, VT + c, VT_STATES) for c in range(3)]
            f.vts.spread[j] = 0.0
            clear(b, j)
        f.count[0], f.size[0] = count + len(which), size + 3 * len(which)

    def take_out(self, f: Filter, b: Block, which: Ints) -> None:
        """Let VTs (v,) leave a filter that were not seen: nothing was learnt of them but what u says."""
        for ident in (self.first_ident + which).tolist():
            j = np.flatnonzero((f.vts.slots[: f.count[0], IDENT] == ident) & (f.vts.slots[: f.count[0], UNSEEN] == 1))
            if len(j):
                remove(f, b, int(j[0]))


def keys_of(links: Links, sites: tuple[str, ...]) -> list[tuple[str, int, int]]:
    """Return what links are known by from drive to drive: site, cell and port."""
    names = [sites[site] for site in links.site.tolist()]
    return list(zip(names, links.cell_id.tolist(), links.port.tolist(), strict=True))


def standing(places: Floats) -> Floats:
    """Return poses (V, 6) at places (V, 3) in m, whose axes are those of the world."""
    return np.pad(places, ((0, 0), (0, 3)))


Box = tuple[list[float], list[float]]  # least and greatest x and y, in m


class Observed(NamedTuple):
    """What a drive has beside a filter: the filter's `links` and the names of its `sites`; of each VT that was detected
    the box of the vehicle's places that it was `seen` from, by identity."""

    links: Links
    sites: tuple[str, ...]
    seen: Mapping[int, Box]


def confirmed_images(f: Filter, hits: int) -> NDArray[np.bool_]:
    """Return which VTs (V,) of a filter are confirmed, with at least so many detections, and mirror images."""
    slots, anchor = f.vts.slots[: f.count[0]], f.vts.anchor[: f.count[0]]
    confirmed = (slots[:, HITS] >= hits) & (anchor[:, SCORE] > 0.0)
    return np.asarray(confirmed & (anchor[:, WEIGHT] > 0.5) & (slots[:, SCATTERER] == 0))


def map_after(f: Filter, lost: Floats, observed: Observed, before: Remembered | None, confirm: int) -> VtMap:
    """Return the map after a drive: VTs that were seen, with `confirm` detections, those that were displaced,
    `lost` (E, 15), and those of the map before that were not seen; what was missed too often is left out, and what was
    surveyed, which the next drive knows without the map, and scatterers, which the map has no place for."""
    slots = f.vts.slots[: f.count[0]]
    new = confirmed_images(f, confirm) & (slots[:, SURVEYED] == 0)
    mine = np.flatnonzero(new & np.isin(slots[:, IDENT], list(observed.seen)))
    states = f.vts.state[mine, VT : VT + 3]
    joint = np.concatenate([states.ravel(), np.arange(f.core.first_common, f.core.size)])
    root = _root(f.p[np.ix_(joint, joint)])
    anchor, spherical = f.vts.anchor[mine, :3], f.x[states]
    position = anchor + spherical[:, :1] * unit_vector(spherical[:, 1], spherical[:, 2])
    by = jacobians(standing(anchor), position)[0]
    common = np.asarray(np.linalg.solve(by, root[: states.size].reshape(len(mine), 3, len(joint))), np.float64)
    seen = _listed(observed, slots[mine, IDENT], slots[mine, LINK], position, anchor, slots[mine, HITS])
    parts = [replace(seen, common_m=common)]
    parts.append(_displaced(observed, lost, set(slots[mine, IDENT].tolist()), before, confirm, len(joint)))
    if before is not None:
        ident = before.first_ident + np.arange(len(before.known))
        parts[0] = _continued(parts[0], slots[mine, IDENT] - before.first_ident, before.known)
        unseen = before.known.part(~np.isin(ident, slots[mine, IDENT]))
        passed = before.passed[~np.isin(ident, slots[mine, IDENT])]
        unseen = replace(
            unseen, missed=unseen.missed + passed, position_m=unseen.position_m + unseen.common_m @ f.x[f.core.common],
            common_m=unseen.common_m @ root[states.size :],
        )  # fmt: skip
        parts.append(unseen.part(unseen.missed < FORGOTTEN))
    return joined(parts).compressed().widened(WIDENED)


def _listed(observed: Observed, ident: Ints, link: Ints, position: Floats, anchor: Floats, hits: Ints) -> VtMap:
    """Return VTs (V,) on links as a map, whose covariances are zero."""
    count, keys = len(ident), keys_of(observed.links, observed.sites)
    site, cell, port = ([keys[n][i] for n in link.tolist()] for i in range(3))
    return VtMap(
        site=np.array(site, np.str_), cell_id=np.array(cell, np.int64), port=np.array(port, np.int64),
        position_m=position, anchor_m=anchor, own_m2=np.zeros((count, 3, 3)), common_m=np.zeros((count, 3, 0)),
        seen_m=np.array([observed.seen[i] for i in ident.tolist()]).reshape(count, 2, 2), hits=hits.copy(),
        missed=np.zeros(count, np.int64),
    )  # fmt: skip


def _displaced(
    observed: Observed, lost: Floats, there: set[int], before: Remembered | None, confirm: int, common: int
) -> VtMap:
    """Return new VTs that others displaced: of their covariances with the others nothing is left."""
    ours = range(0) if before is None else range(before.first_ident, before.first_ident + len(before.known))
    ident = lost[:, 0].astype(np.int64)
    new = np.array([i in observed.seen and i not in there and i not in ours for i in ident.tolist()], np.bool_)
    new &= lost[:, KIND] == 0.0
    lost, ident = lost[new], ident[new]
    middle = np.array([[*np.mean(observed.seen[i], axis=0), 0.0] for i in ident.tolist()]).reshape(-1, 3)
    hits, at = np.full(len(lost), confirm), lost[:, POSITION:SPREAD]
    out = _listed(observed, ident, lost[:, 1].astype(np.int64), at, middle, hits)
    own = lost[:, SPREAD:KIND].reshape(-1, 3, 3)
    return replace(out, own_m2=own, common_m=np.zeros((len(lost), 3, common)))


def _continued(seen: VtMap, number: Ints, known: VtMap) -> VtMap:
    """Return the VTs that were seen with where those were seen before that are VTs `number` (V,) of a map."""
    boxes = seen.seen_m.copy()
    old = (number >= 0) & (number < len(known))
    boxes[old, 0] = np.minimum(boxes[old, 0], known.seen_m[number[old], 0])
    boxes[old, 1] = np.maximum(boxes[old, 1], known.seen_m[number[old], 1])
    return replace(seen, seen_m=boxes)


def _root(covariance: Floats) -> Floats:
    """Return a root of a covariance that may be singular."""
    size, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(axes * np.sqrt(np.maximum(size, 0.0)))
