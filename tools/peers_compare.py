"""Our paths beside those of a peer: what agrees, by how much, and why the rest does not."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.sim.rays import Paths, Scene
from cellslam.sim.rays.paths import Floats, Ints
from tools.peers import PeerPaths

# Paths are taken for one another within these, and agree within the closer ones.
SAME_M, SAME_RAD = 5e-3, 1e-3
AGREE_M, AGREE_RAD, AGREE_DB = 1e-3, 1e-4, 0.1
GRAZING_M = 0.02


@dataclass(frozen=True)
class Comparison:
    """Counts of a peer's paths, each in one class, and of ours that it misses.

    `agreeing`: within 1 mm, 1e-4 rad and 0.1 dB of one of ours; `theirs_bent`: its direction alone is further off,
    and the peer's own point breaks the law of reflection by at least as much; `theirs_copies`: further paths for one
    of ours, found in several triangles, or with the plane of the wall beside the one that carries it;
    `theirs_grazing`: no such path of ours, and it passes an edge or the rim of its wall by less than 2 cm, where
    float32 decides; `theirs_unexplained`: the rest, which would be our fault; `ours_only`: ours that the peer misses.

    Largest differences over the agreeing paths: `length_m`, `angle_rad`, `gain_db` (total power) and `field` (the 2x2
    matrix relative to its largest element), the last two None where the peer was not asked for gains; `bent_rad`: of
    angles over those that are bent.
    """

    agreeing: int
    theirs_bent: int
    theirs_copies: int
    theirs_grazing: int
    theirs_unexplained: int
    ours_only: int
    length_m: float
    angle_rad: float
    gain_db: float | None
    field: float | None
    bent_rad: float


def compare(scene: Scene, transmitter: Floats, receivers: Floats, ours: Paths, theirs: PeerPaths) -> Comparison:
    """Compare the paths from one transmitter (3,) to receivers (N, 3), both in m, up to first order."""
    mine, found, both = _matches(ours, theirs)
    pairs = mine[both]
    length, angle = _differences(ours, pairs, theirs, both)
    gain_db, field = _gains(ours, pairs, theirs, both)
    near = (length < AGREE_M) & (True if gain_db is None else gain_db < AGREE_DB)
    agree = near & (angle < AGREE_RAD)
    broken = _law_broken(scene, transmitter, receivers, ours, pairs, theirs, both)
    bent = near & ~agree & (broken >= angle)
    alone = np.flatnonzero(mine < 0)
    grazing = sum(_grazes(scene, transmitter, receivers[theirs.receiver[row]], theirs, int(row)) for row in alone)
    return Comparison(
        agreeing=int(agree.sum()),
        theirs_bent=int(bent.sum()),
        theirs_copies=len(found) - len(both),
        theirs_grazing=int(grazing),
        theirs_unexplained=len(alone) - int(grazing) + int((~agree & ~bent).sum()),
        ours_only=len(ours) - len(both),
        length_m=float(length[agree].max(initial=0.0)),
        angle_rad=float(angle[agree].max(initial=0.0)),
        gain_db=None if gain_db is None else float(gain_db[agree].max(initial=0.0)),
        field=None if field is None else float(field[agree].max(initial=0.0)),
        bent_rad=float(angle[bent].max(initial=0.0)),
    )


def _matches(ours: Paths, theirs: PeerPaths) -> tuple[Ints, Ints, Ints]:
    """Return the row of ours for each of theirs (-1 none), those of theirs that have one, and of these the best for
    each of ours.
    """
    mine, misfit = np.full(len(theirs), -1, np.int64), np.full(len(theirs), np.inf)
    start = np.searchsorted(ours.receiver, np.arange(int(theirs.receiver.max(initial=0)) + 2))
    for row in range(len(theirs)):
        near = np.arange(start[theirs.receiver[row]], start[theirs.receiver[row] + 1])
        near = near[ours.order[near] == theirs.order[row]]
        length, angle = _differences(ours, near, theirs, np.full(len(near), row))
        close = (length < SAME_M) & (angle < SAME_RAD)
        if close.any():
            apart = np.where(close, length / SAME_M + angle / SAME_RAD, np.inf)
            mine[row], misfit[row] = near[np.argmin(apart)], apart.min()
    found = np.flatnonzero(mine >= 0)
    order = found[np.lexsort((misfit[found], mine[found]))]
    return mine, found, order[np.unique(mine[order], return_index=True)[1]]


def _differences(ours: Paths, mine: Ints, theirs: PeerPaths, rows: Ints) -> tuple[Floats, Floats]:
    """Return differences of length in metres and of the direction of arrival in radians, pair by pair (P,)."""
    turn = wrap_angle(ours.azimuth_rad[mine] - theirs.azimuth_rad[rows]) * np.cos(theirs.elevation_rad[rows])
    rise = ours.elevation_rad[mine] - theirs.elevation_rad[rows]
    return np.abs(ours.length_m[mine] - theirs.length_m[rows]), np.hypot(turn, rise)


def _gains(ours: Paths, mine: Ints, theirs: PeerPaths, rows: Ints) -> tuple[Floats | None, Floats | None]:
    if theirs.gain is None:
        return None, None
    a, b = ours.gain[mine], theirs.gain[rows]
    power = [10.0 * np.log10((np.abs(g) ** 2).sum(axis=(1, 2))) for g in (a, b)]
    relative = np.abs(a - b).max(axis=(1, 2)) / np.abs(b).max(axis=(1, 2))
    return np.abs(power[0] - power[1]), np.asarray(relative, np.float64)


def _law_broken(
    scene: Scene, transmitter: Floats, receivers: Floats, ours: Paths, mine: Ints, theirs: PeerPaths, rows: Ints
) -> Floats:
    """Return the angle (P,) between where their point sends the ray and where the wall of ours would reflect it."""
    point = theirs.point_m[rows]
    k_in, k_out = point - transmitter, receivers[theirs.receiver[rows]] - point
    k_in, k_out = (k / np.linalg.norm(k, axis=1, keepdims=True) for k in (k_in, k_out))
    normal = scene.city.facets.normal[ours.facets[mine, 0]]
    mirrored = k_in - 2.0 * np.einsum("pi,pi->p", k_in, normal)[:, None] * normal
    return np.where(theirs.order[rows] == 1, np.linalg.norm(mirrored - k_out, axis=1), 0.0)


def _grazes(scene: Scene, transmitter: Floats, receiver: Floats, theirs: PeerPaths, row: int) -> bool:
    """Tell whether a path that only a peer has passes within 2 cm of an edge, in double precision."""
    t, r = transmitter - scene.origin_m, receiver - scene.origin_m
    if theirs.order[row] == 0:
        return _edge_distance(scene, np.array([t, r])) < GRAZING_M
    normal, offset = scene.table[:, :3], scene.table[:, 3]
    image = t - 2.0 * (normal @ t - offset)[:, None] * normal
    away = image - r
    length = np.linalg.norm(away, axis=1)
    cos = np.cos(theirs.elevation_rad[row])
    azimuth, elevation = theirs.azimuth_rad[row], theirs.elevation_rad[row]
    heading = np.array([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)])
    fits = (np.abs(length - theirs.length_m[row]) < SAME_M) & (
        np.linalg.norm(away / length[:, None] - heading, axis=1) < SAME_RAD
    )
    for facet in np.flatnonzero(fits):
        from_t, from_r = normal[facet] @ t - offset[facet], normal[facet] @ r - offset[facet]
        point = r + (image[facet] - r) * (from_r / (from_r + from_t))
        if _edge_distance(scene, np.array([t, point, r])) < GRAZING_M:
            return True
    return False


def _edge_distance(scene: Scene, corners: Floats) -> float:
    """Return the least distance in metres between the legs of a path (n, 3) and any edge of any triangle."""
    triangles = scene.city.vertices[scene.city.triangles] - scene.origin_m
    start = triangles.reshape(-1, 3)
    end = np.roll(triangles, -1, axis=1).reshape(-1, 3)
    return min(float(_segment_distance(a, b, start, end).min()) for a, b in itertools.pairwise(corners))


def _segment_distance(a: Floats, b: Floats, start: Floats, end: Floats) -> Floats:
    """Return distances (N,) between the segment a-b (3,) and segments (N, 3)."""
    d1, d2, r = b - a, end - start, a - start
    aa, ee = float(d1 @ d1), np.maximum(np.einsum("ni,ni->n", d2, d2), 1e-18)
    c, f, cross = r @ d1, np.einsum("ni,ni->n", d2, r), d2 @ d1
    denominator = aa * ee - cross**2
    s = np.where(denominator > 1e-12, (cross * f - c * ee) / np.maximum(denominator, 1e-12), 0.0).clip(0.0, 1.0)
    u = ((cross * s + f) / ee).clip(0.0, 1.0)
    s = ((cross * u - c) / aa).clip(0.0, 1.0)
    return np.asarray(np.linalg.norm(r + s[:, None] * d1 - u[:, None] * d2, axis=1), np.float64)
