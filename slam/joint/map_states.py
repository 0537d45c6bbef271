"""A remembered map in joint filters: what they begin with, and VTs that come into reach.

The errors u that the map's VTs have in common are states from the start; a VT enters as it comes into reach, as
position + common u + own, with the covariances that follow: the exact marginal of the joint prior, given all that was
learnt so far. What a drive learns of u holds for the VTs that it never met, too.

Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990 (states that stay).
"""

from __future__ import annotations

from copy import copy

import numpy as np

from cellslam.sim.recording import Floats, Ints, Links
from cellslam.slam.joint.snapshot.birth_kernel import clear, remove
from cellslam.slam.joint.state.layout import EXISTS, IDENT, MERGED, SHARE, UNSEEN, VT, VT_STATES, WORTH, Block, Filter
from cellslam.slam.joint.state.states_kernel import owner_of
from cellslam.slam.model.measurement_model import jacobians, predict
from cellslam.slam.model.vt_map import VtMap

REACH_M, PASSED_M = 20.0, 5.0  # from where a VT was seen: it is looked for; it should be seen
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
        room = max(MOST_NEAR - int(self._inside.sum()), 0)
        enter = enter[np.argsort(-self.known.hits[enter], kind="stable")][:room]
        self._inside[enter] = True
        return enter, leave

    def put_in(self, f: Filter, b: Block, which: Ints, now: int) -> None:
        """Let VTs (v,) of the map enter a filter that has room for them, as if they had been seen in the snapshot
        before `now`."""
        there = set(f.slots[: f.count[0], IDENT].tolist())
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
        f.deviation[at] = load @ f.deviation[common]
        f.p[at, :size] = load @ f.p[common, :size]
        f.p[:size, at] = f.p[at, :size].T
        f.p[at[:, None], at] = f.p[at, common] @ load.T
        for n, own in enumerate(by @ known.own_m2[which] @ np.swapaxes(by, 1, 2)):
            f.p[size + 3 * n : size + 3 * n + 3, size + 3 * n : size + 3 * n + 3] += own
        for n, vt in enumerate(which.tolist()):
            j, places = count + n, size + 3 * n + np.arange(3)
            f.slots[j] = self.link[vt], known.hits[vt], now - 1, self.first_ident + vt, 1, 0
            f.anchor[j, :3], f.anchor[j, [EXISTS, SHARE]], f.anchor[j, [MERGED, WORTH]] = known.anchor_m[vt], 1.0, 0.0
            f.vt_state[j], f.vt_state[j, VT : VT + 3] = -1, places
            f.owner[places] = [owner_of(j, VT + c, VT_STATES) for c in range(3)]
            f.spread[j] = 0.0
            clear(b, j)
        f.count[0], f.size[0] = count + len(which), size + 3 * len(which)

    def take_out(self, f: Filter, b: Block, which: Ints) -> None:
        """Let VTs (v,) leave a filter that were not seen: nothing was learnt of them but what u says."""
        for ident in (self.first_ident + which).tolist():
            j = np.flatnonzero((f.slots[: f.count[0], IDENT] == ident) & (f.slots[: f.count[0], UNSEEN] == 1))
            if len(j):
                remove(f, b, int(j[0]))


def keys_of(links: Links, sites: tuple[str, ...]) -> list[tuple[str, int, int]]:
    """Return what links are known by from drive to drive: site, cell and port."""
    names = [sites[site] for site in links.site.tolist()]
    return list(zip(names, links.cell_id.tolist(), links.port.tolist(), strict=True))


def standing(places: Floats) -> Floats:
    """Return poses (V, 6) at places (V, 3) in m, whose axes are those of the world."""
    return np.pad(places, ((0, 0), (0, 3)))
