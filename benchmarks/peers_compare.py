"""Our paths beside those of a peer: what agrees, by how much, and why the rest does not."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from cellslam.benchmarks.peers import PeerPaths
from cellslam.sim.frames import wrap_angle
from cellslam.sim.rays import Paths, Scene
from cellslam.sim.rays.paths import Floats, Ints

SAME_M, SAME_RAD = 5e-3, 1e-3
GRAZING_M = 0.02


@dataclass(frozen=True)
class Comparison:
    """Counts of paths that both found (`matched`), and of the others; largest differences over the matched ones.

    `theirs_grazing`: theirs alone, with a reflection off the facet or a leg through an edge of a wall by less than
    2 cm, where float32 decides; `theirs_unexplained`: the rest of theirs, which would be our fault.
    `gain_db`, `field`: difference of total power, and of the 2x2 matrix relative to its largest element; None where
    the peer was not asked for gains.
    """

    matched: int
    theirs_grazing: int
    theirs_unexplained: int
    ours_only: int
    length_m: float
    angle_rad: float
    gain_db: float | None
    field: float | None


def compare(scene: Scene, transmitter: Floats, receivers: Floats, ours: Paths, theirs: PeerPaths) -> Comparison:
    """Compare the paths from one transmitter (3,) to receivers (N, 3), up to first order."""
    mine = np.full(len(theirs), -1, np.int64)
    start = np.searchsorted(ours.receiver, np.arange(len(receivers) + 1))
    for row in range(len(theirs)):
        near = np.arange(start[theirs.receiver[row]], start[theirs.receiver[row] + 1])
        near = near[ours.order[near] == theirs.order[row]]
        length, angle = _differences(ours, near, theirs, row)
        close = (length < SAME_M) & (angle < SAME_RAD)
        if close.any():
            mine[row] = near[np.argmin(np.where(close, length / SAME_M + angle / SAME_RAD, np.inf))]
    both = np.flatnonzero(mine >= 0)
    length = np.abs(ours.length_m[mine[both]] - theirs.length_m[both])
    angle = np.hypot(
        np.cos(theirs.elevation_rad[both]) * wrap_angle(ours.azimuth_rad[mine[both]] - theirs.azimuth_rad[both]),
        ours.elevation_rad[mine[both]] - theirs.elevation_rad[both],
    )
    alone = np.flatnonzero(mine < 0)
    grazing = sum(_grazes(scene, transmitter, receivers[theirs.receiver[row]], theirs, int(row)) for row in alone)
    gain_db, field = _gains(ours, mine[both], theirs, both)
    return Comparison(
        matched=len(both),
        theirs_grazing=int(grazing),
        theirs_unexplained=len(alone) - int(grazing),
        ours_only=len(ours) - len(np.unique(mine[both])),
        length_m=float(length.max(initial=0.0)),
        angle_rad=float(angle.max(initial=0.0)),
        gain_db=gain_db,
        field=field,
    )


def _differences(ours: Paths, near: Ints, theirs: PeerPaths, row: int) -> tuple[Floats, Floats]:
    turn = wrap_angle(ours.azimuth_rad[near] - theirs.azimuth_rad[row]) * np.cos(theirs.elevation_rad[row])
    rise = ours.elevation_rad[near] - theirs.elevation_rad[row]
    return np.abs(ours.length_m[near] - theirs.length_m[row]), np.hypot(turn, rise)


def _gains(ours: Paths, mine: Ints, theirs: PeerPaths, rows: Ints) -> tuple[float | None, float | None]:
    if theirs.gain is None or not len(rows):
        return None, None
    a, b = ours.gain[mine], theirs.gain[rows]
    power = [10.0 * np.log10((np.abs(g) ** 2).sum(axis=(1, 2))) for g in (a, b)]
    relative = np.abs(a - b).max(axis=(1, 2)) / np.abs(b).max(axis=(1, 2))
    return float(np.abs(power[0] - power[1]).max()), float(relative.max())


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
