"""Maps of several cars as one: what two of them have found is fused by covariance intersection.

Two maps share errors that nobody knows: arrays of one make, a map that both began with, paths that merge at the same
places. With covariances P_a and P_b, P_a / w and P_b / (1 - w) beside each other bound the joint covariance, whatever
they share, for each 0 < w < 1. Under that bound VTs that are the same differ by nothing: a linear measurement of both
maps. Of the VTs that both have that leaves (w P_a^-1 + (1 - w) P_b^-1)^-1; those that one map alone has keep its
covariance over its weight, less what is learnt of their neighbours. w is the one that leaves least.

The common errors u of both maps stand beside each other; given them all pairs are independent, so that maps of
thousands of VTs are joined by one covariance of 2 x 64 states.

Sources: Julier and Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations", American
Control Conference, 1997, and "Using covariance intersection for SLAM", Robotics and Autonomous Systems 55, 2007.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize_scalar

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints
from cellslam.slam.model.vt_map import VtMap, joined

SAME = 16.3  # squared deviations by which VTs that are the same differ: in three dimensions 0.1 % are farther apart
NEAR_M = 10.0  # VTs of one link that are so near each other, and are not taken for one, are worth a word
MOST_APART = 3.0  # mean squared deviation of all that both have, each coordinate, beyond which maps do not fit
LEAST_SAME = 0.5  # of the VTs that both could have seen
EXACT_M2 = 1e-6  # what is exact is so to a millimetre
LEAST_WEIGHT = 0.02


class Joining(NamedTuple):
    """Two maps as one, `map`; how many VTs both had, `same`; how many VTs of one link are near each other and do not
    fit, `apart`; the `weight` of the first map."""

    map: VtMap
    same: int
    apart: int
    weight: float


class Pairs(NamedTuple):
    """Which VTs of two maps are the same: places `one` (n,) in the first, `other` (n,) in the second; `apart`: how many
    are near each other and do not fit; `both`: how many could be the same at most, by where they were seen from."""

    one: Ints
    other: Ints
    apart: int
    both: int


def join_maps(maps: Sequence[VtMap]) -> VtMap:
    """Return the maps of several drives through one place as one.

    Raises InputError where there is no map, or where they do not fit.
    """
    if not maps:
        raise InputError("no maps to join: give one or more")
    first, *others = maps
    for other in others:
        first = join(first, other).map
    return first


def join(a: VtMap, b: VtMap) -> Joining:
    """Return two maps as one, which is no surer than they allow. Raises InputError where they do not fit."""
    pairs = pairs_of(a, b)
    _check_fit(a, b, pairs)

    def left(weight: float) -> float:
        return float(np.linalg.slogdet(fused(a, b, pairs, weight).covariance_m2)[1].sum())

    weight = float(minimize_scalar(left, bounds=(LEAST_WEIGHT, 1.0 - LEAST_WEIGHT), method="bounded").x)
    about = {"joined": [*_origins(a), *_origins(b)]}
    whole = replace(fused(a, b, pairs, weight).compressed(), provenance=about)
    return Joining(whole, len(pairs.one), pairs.apart, weight)


def pairs_of(a: VtMap, b: VtMap) -> Pairs:
    """Return which VTs of two maps are the same: each one of at most one, of its link, as near as both covariances
    say."""
    one, other, apart, both = list[int](), list[int](), 0, 0
    of_a, of_b = _by_link(a), _by_link(b)
    for link in sorted(of_a.keys() & of_b.keys()):
        i, j = of_a[link], of_b[link]
        off = a.position_m[i][:, None] - b.position_m[j]
        spread = a.covariance_m2[i][:, None] + b.covariance_m2[j] + EXACT_M2 * np.eye(3)
        distance2 = np.einsum("ijk,ijk->ij", off, np.linalg.solve(spread, off[..., None])[..., 0])
        row, column = linear_sum_assignment(np.minimum(distance2, SAME))
        fit = distance2[row, column] < SAME
        one += i[row[fit]].tolist()
        other += j[column[fit]].tolist()
        near = np.linalg.norm(off, axis=-1) < NEAR_M
        near[row[fit]], near[:, column[fit]] = False, False
        apart += int(near.sum())
        beside = _seen_together(a.seen_m[i], b.seen_m[j])
        both += min(int(beside.any(axis=1).sum()), int(beside.any(axis=0).sum()))
    order = np.argsort(one)
    return Pairs(np.array(one, np.int64)[order], np.array(other, np.int64)[order], apart, both)


def fused(a: VtMap, b: VtMap, pairs: Pairs, weight: float) -> VtMap:
    """Return two maps as one by covariance intersection, with this weight of the first map; its common errors are
    those of both."""
    a, b = _beside(a.widened(1.0 / weight), b.widened(1.0 / (1.0 - weight)))
    shift, root = _errors(a, b, pairs)[:2]
    a, b = (replace(m, position_m=m.position_m + m.common_m @ shift, common_m=m.common_m @ root) for m in (a, b))
    mine, theirs = a.part(pairs.one), b.part(pairs.other)
    share = theirs.own_m2 @ np.linalg.inv(mine.own_m2 + theirs.own_m2)
    own = share @ mine.own_m2
    off = theirs.position_m - mine.position_m
    same = replace(
        mine,
        position_m=theirs.position_m - (share @ off[..., None])[..., 0],
        common_m=theirs.common_m - share @ (theirs.common_m - mine.common_m),
        own_m2=0.5 * (own + np.swapaxes(own, 1, 2)),
        seen_m=_around(mine.seen_m, theirs.seen_m),
        hits=np.maximum(mine.hits, theirs.hits),
        missed=np.minimum(mine.missed, theirs.missed),
    )
    rest = (m.part(np.setdiff1d(np.arange(len(m)), of)) for m, of in ((a, pairs.one), (b, pairs.other)))
    return joined([same, *rest])


def _errors(a: VtMap, b: VtMap, pairs: Pairs) -> tuple[Floats, Floats, float]:
    """Return mean (R,) and a root (R, R) of the covariance of the common errors of two maps beside each other, given
    that `pairs` are the same, and by how much all of these differ, in squared deviations."""
    load = a.common_m[pairs.one] - b.common_m[pairs.other]
    off = a.position_m[pairs.one] - b.position_m[pairs.other]
    inverse = np.linalg.inv(a.own_m2[pairs.one] + b.own_m2[pairs.other])
    weighted, rank = inverse @ load, load.shape[2]
    information = np.eye(rank) + np.tensordot(load, weighted, ((0, 1), (0, 1)))
    found = np.tensordot(weighted, off, ((0, 1), (0, 1)))
    mean = np.linalg.solve(information, found)
    distance2 = float(np.einsum("ni,nij,nj->", off, inverse, off) - found @ mean)
    root = np.asarray(np.linalg.inv(np.linalg.cholesky(information)).T, np.float64)
    return np.asarray(-mean, np.float64), root, distance2


def _check_fit(a: VtMap, b: VtMap, pairs: Pairs) -> None:
    """Raise InputError unless what two maps both have agrees, and is as much as it should be."""
    same = len(pairs.one)
    if same < LEAST_SAME * pairs.both:
        raise InputError(
            f"the maps do not fit each other: of {pairs.both} VTs that were seen on the same way {same} are the same"
        )
    apart = _errors(*_beside(a, b), pairs)[2] / max(3 * same, 1)
    if apart > MOST_APART:
        raise InputError(
            f"the maps do not fit each other: VTs of both are {np.sqrt(apart):.1f} times as far apart as they may be"
        )


def _beside(a: VtMap, b: VtMap) -> tuple[VtMap, VtMap]:
    """Return two maps with the common errors of both, those of the first map first; nothing is quite exact."""
    rank = a.common_m.shape[2], b.common_m.shape[2]
    exact = EXACT_M2 * np.eye(3)
    return (
        replace(a, common_m=np.pad(a.common_m, ((0, 0), (0, 0), (0, rank[1]))), own_m2=a.own_m2 + exact),
        replace(b, common_m=np.pad(b.common_m, ((0, 0), (0, 0), (rank[0], 0))), own_m2=b.own_m2 + exact),
    )


def _origins(m: VtMap) -> list[Any]:
    """Return where the maps are from of which a map is made."""
    return list(m.provenance.get("joined", [dict(m.provenance)]))


def _by_link(m: VtMap) -> dict[tuple[str, int, int], Ints]:
    """Return which VTs are on which link: site, cell and port."""
    keys = list(zip(m.site.tolist(), m.cell_id.tolist(), m.port.tolist(), strict=True))
    return {key: np.array([j for j, of in enumerate(keys) if of == key], np.int64) for key in dict.fromkeys(keys)}


def _around(a: Floats, b: Floats) -> Floats:
    """Return the boxes (V, 2, 2) around boxes of two maps."""
    return np.stack([np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 1], b[:, 1])], axis=1)


def _seen_together(a: Floats, b: Floats) -> Floats:
    """Return which boxes (A, 2, 2) and (B, 2, 2), in m, meet, (A, B)."""
    return np.asarray(((a[:, None, 0] <= b[:, 1]) & (b[:, 0] <= a[:, None, 1])).all(axis=2))
