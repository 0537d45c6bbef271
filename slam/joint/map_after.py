"""The map that a drive leaves: what it saw, and what it did not see, moved by what was learnt of the common errors.

With x the VTs in the state and u the common errors of the map before, the drive leaves one Gaussian of (x, u): its root
gives what is common to the VTs that were seen; a VT that was not seen is position + common u + own as before.

Source: Smith, Self and Cheeseman, "Estimating uncertain spatial relationships in robotics", 1990.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellslam.sim.frames import unit_vector
from cellslam.sim.recording import Floats, Ints, Links
from cellslam.slam.joint.map_states import Remembered, keys_of, standing
from cellslam.slam.joint.state.layout import HITS, IDENT, LINK, POSITION, SHARE, SPREAD, VT, Filter
from cellslam.slam.model.measurement_model import jacobians
from cellslam.slam.model.vt_map import VtMap, joined

WIDENED = 1.1  # covariances after each drive: what no filter models, as paths that merge, recurs at the same places
FORGOTTEN = 2  # drives past a VT without a detection after which it is no longer there


Box = tuple[list[float], list[float]]  # least and greatest x and y, in m


class Observed(NamedTuple):
    """What a drive has beside a filter: the filter's `links` and the names of its `sites`; of each VT that was detected
    the box of the vehicle's places that it was `seen` from, by identity."""

    links: Links
    sites: tuple[str, ...]
    seen: Mapping[int, Box]


def map_after(f: Filter, lost: Floats, observed: Observed, before: Remembered | None, confirm: int) -> VtMap:
    """Return the map after a drive: VTs that were seen, with `confirm` detections, those that made room, `lost`
    (E, 14), and those of the map before that were not seen; what was missed too often is left out."""
    slots = f.slots[: f.count[0]]
    places = f.vt_state[: len(slots), VT]
    fit = (slots[:, HITS] >= confirm) & (f.anchor[: len(slots), SHARE] > 0.5) & (f.p[places, places] > 0.0)
    mine = np.flatnonzero(fit & np.isin(slots[:, IDENT], list(observed.seen)))
    states = f.vt_state[mine, VT : VT + 3]
    joint = np.concatenate([states.ravel(), np.arange(f.core.first_common, f.core.size)])
    root = _root(f.p[np.ix_(joint, joint)])
    anchor, spherical = f.anchor[mine, :3], f.x[states]
    position = anchor + spherical[:, :1] * unit_vector(spherical[:, 1], spherical[:, 2])
    by = jacobians(standing(anchor), position)[0]
    common = np.asarray(np.linalg.solve(by, root[: states.size].reshape(len(mine), 3, len(joint))), np.float64)
    seen = _listed(observed, slots[mine, IDENT], slots[mine, LINK], position, anchor, slots[mine, HITS])
    parts = [replace(seen, common_m=common)]
    parts.append(_made_room(observed, lost, set(slots[mine, IDENT].tolist()), before, confirm, len(joint)))
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
        np.array(site, np.str_), np.array(cell, np.int64), np.array(port, np.int64), position, anchor,
        np.zeros((count, 3, 3)), np.zeros((count, 3, 0)),
        np.array([observed.seen[i] for i in ident.tolist()]).reshape(count, 2, 2), hits.copy(),
        np.zeros(count, np.int64),
    )  # fmt: skip


def _made_room(
    observed: Observed, lost: Floats, there: set[int], before: Remembered | None, confirm: int, common: int
) -> VtMap:
    """Return new VTs that made room for others: of their covariances with the others nothing is left."""
    ours = range(0) if before is None else range(before.first_ident, before.first_ident + len(before.known))
    ident = lost[:, 0].astype(np.int64)
    new = np.array([i in observed.seen and i not in there and i not in ours for i in ident.tolist()], np.bool_)
    lost, ident = lost[new], ident[new]
    middle = np.array([[*np.mean(observed.seen[i], axis=0), 0.0] for i in ident.tolist()]).reshape(-1, 3)
    hits, at = np.full(len(lost), confirm), lost[:, POSITION:SPREAD]
    out = _listed(observed, ident, lost[:, 1].astype(np.int64), at, middle, hits)
    own = lost[:, SPREAD:].reshape(-1, 3, 3)
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
