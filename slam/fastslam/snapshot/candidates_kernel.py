"""Compiled: which tracks could have given a link's measurements, predicted, and how well each pair fits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cellslam.sim.compiling import njit
from cellslam.slam.fastslam.parts.criterion import NEVER, score
from cellslam.slam.fastslam.parts.part_types import Parts
from cellslam.slam.fastslam.running.prefetch import prefetch
from cellslam.slam.fastslam.snapshot.pair_kernel import innovate, invert, logarithm, reach
from cellslam.slam.fastslam.snapshot.predict_kernel import predict
from cellslam.slam.fastslam.state.layout import (
    BROAD,
    CENTRE,
    HIGH,
    LANES,
    LONG,
    LOW,
    MOVED,
    NEAR,
    O_FLAT,
    O_SCORE,
    O_X,
    O_Y,
    O_Z,
    TURNED,
    W_POSE,
    W_REACH,
    W_SCORE,
    WIDTH,
    Bound,
    Link,
    Rows,
    Rules,
    Scene,
    Scratch,
)
from cellslam.slam.fastslam.state.tracks_kernel import ONCE, spokesman

B = LANES
STEEP = 3.0  # a VT higher than this times its distance on the ground is not told from others by azimuth


@njit(cache=True, error_model="numpy")
def middle(w: Rows, row: int) -> tuple[float, float]:
    """Return the middle of a row's values, and how far they lie from it at most."""
    low, high = math.inf, -math.inf
    for l in range(B):
        low, high = min(low, w[row * B + l]), max(high, w[row * B + l])
    return 0.5 * (low + high), 0.5 * (high - low)


@njit(error_model="numpy")
def candidates(parts: Parts, s: Scratch, now: int, link: Link, count: int, scene: Scene, z: Rows, rules: Rules) -> int:
    """Predict the tracks that could have given one of the scene's measurements z and score all pairs; return how many
    such tracks there are.

    A track whose distance or azimuth was far from every measured one when last predicted, less what the particles
    moved since, is passed over without reading its record.
    """
    possible = _within_reach(s, link, count, scene, z, rules)
    status, records, bounds = link.status, link.records, link.bounds
    w, bits, near, rows, scores, claims = s.w, s.bits, s.near, s.rows, s.scores, s.claims
    gate, first, found = rules.gate, scene.first, 0
    for i in range(possible):
        slot = near[i]
        row, out = status[slot], rows[found]
        lane, alike, _ = spokesman(row)
        predict(parts, w, records[slot], out)
        reach(w, out, lane)
        _bound(w, row, lane, out, bounds, slot, scene)
        chosen, bound = False, bound_at(bounds, slot)
        for k in range(first, scene.last):
            claims[found, k - first] = False
            if not _fits(z[k], bound, gate, scene.psi, scene.psi_spread):
                continue
            if not chosen:
                _entitle(now, row, lane, alike, rules, out)
                chosen = True
            innovate(w, out, z[k])
            invert(w, out, z[k], 1.0)
            logarithm(w, bits)
            score(parts.criterion, w, out, gate, z[k, 11])
            claims[found, k - first] = _note(w, scores[found, k - first])
        if chosen:
            near[found] = slot
            found += 1
    return found


@njit(cache=True, error_model="numpy")
def _within_reach(s: Scratch, link: Link, count: int, scene: Scene, z: Rows, rules: Rules) -> int:
    """Write at s.near the tracks that are not passed over, and have their records fetched; return how many there
    are."""
    order, near, reached = link.order, s.near, s.reached
    reached[: len(order)] = False
    for k in range(scene.first, scene.last):
        _reach_all(reached, link.bounds, z[k], scene, rules)
    possible = 0
    for i in range(count):
        slot = order[i]
        if reached[slot]:
            near[possible] = slot
            possible += 1
            prefetch(link.records[slot])
    return possible


@njit(cache=True, error_model="numpy")
def _reach_all(reached: Rows, bounds: Rows, z: Rows, scene: Scene, rules: Rules) -> None:
    """Note the tracks, in use or not, that a measurement could be of."""
    d, az, by_d, by_az, gate = np.float64(z[0]), z[12] + scene.psi, z[5], z[6], rules.gate
    no_d, no_az = z[8] == 0.0, z[9] == 0.0
    for j in range(bounds.shape[1]):
        bound = bound_at(bounds, j)
        far, turn = rules.slack_m + 1.05 * (scene.travelled - bound.moved), 1.05 * (scene.turned - bound.turned)
        swing = far / (bound.near - far)
        close = bound.near < far + far
        by_distance = _distance_fits(d, by_d, bound, gate, far, swing)
        by_azimuth = _azimuth_fits(az, by_az, bound, gate, turn + scene.psi_spread, swing)
        reached[j] |= close | ((by_distance | no_d) & (by_azimuth | no_az))


@njit(cache=True, error_model="numpy")
def _fits(z: Rows, bound: Bound, gate: float, psi: float, psi_spread: float) -> bool:
    """Say whether a measurement could be of a track that was predicted just now."""
    by_distance = _distance_fits(z[0], z[5], bound, gate, 0.0, 0.0)
    by_azimuth = _azimuth_fits(z[12] + psi, z[6], bound, gate, psi_spread, 0.0)
    return bound.near < 0.0 or ((by_distance or z[8] == 0.0) and (by_azimuth or z[9] == 0.0))


@njit(inline="always")
def bound_at(bounds: Rows, j: int) -> Bound:
    """Return the bounds of track j."""
    return Bound(
        bounds[LOW, j], bounds[HIGH, j], bounds[MOVED, j], bounds[CENTRE, j], bounds[WIDTH, j], bounds[TURNED, j],
        bounds[NEAR, j], bounds[LONG, j], bounds[BROAD, j],
    )  # fmt: skip


@njit(inline="always")
def _distance_fits(d: Any, variance: Any, bound: Bound, gate: float, far: float, swing: float) -> Any:
    """Say whether a distance could be of a track: no component alone has a greater normalised distance than all
    together.

    far: how much the distance may have changed since the track was last predicted, m; swing: over its least distance
    then.
    """
    gap = max(d - bound.high, bound.low - d) - far
    across = swing * bound.near
    return (gap <= 0.0) | (gap * gap <= gate * (bound.long + across * across * bound.broad + variance))


@njit(inline="always")
def _azimuth_fits(azimuth: Any, variance: Any, bound: Bound, gate: float, turned: float, swing: float) -> Any:
    """Say whether an azimuth in the world frame could be of a track; turned: how much directions may have turned since
    it was last predicted, with the spread of the lanes' yaw."""
    turn = azimuth - bound.centre
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    gap = abs(turn) - bound.width - turned - swing
    closer = 1.0 + swing
    return (gap <= 0.0) | (gap * gap <= gate * (bound.broad * closer * closer + variance))


@njit(cache=True, error_model="numpy")
def _bound(w: Rows, row: Rows, first: int, out: Rows, bounds: Rows, slot: int, scene: Scene) -> None:
    """Write what the lanes alive expect of a track (see `layout`)."""
    low, high, left, right, near = math.inf, -math.inf, math.inf, -math.inf, math.inf
    wide, broad, steep = 0.0, 0.0, 0.0
    for l in range(B):
        if row[l] >= 0:
            low, high = min(low, w[W_REACH * B + l]), max(high, w[W_REACH * B + l])
            wide, broad = max(wide, w[(W_REACH + 1) * B + l]), max(broad, w[(W_REACH + 3) * B + l])
            left, right = min(left, w[(W_REACH + 2) * B + l]), max(right, w[(W_REACH + 2) * B + l])
            near, steep = min(near, out[O_FLAT * B + l]), max(steep, abs(out[O_Z * B + l]))
    bounds[LOW, slot], bounds[HIGH, slot], bounds[MOVED, slot] = low, high, scene.travelled
    centre = math.atan2(out[O_Y * B + first], out[O_X * B + first]) + w[(W_POSE + 3) * B + first]
    bounds[CENTRE, slot], bounds[WIDTH, slot] = centre + 0.5 * (left + right), 0.5 * (right - left)
    bounds[TURNED, slot], bounds[NEAR, slot] = scene.turned, near
    bounds[LONG, slot], bounds[BROAD, slot] = wide, broad
    if not right - left < 2.0 or steep > STEEP * near:
        bounds[WIDTH, slot] = math.inf


@njit(cache=True, error_model="numpy")
def _entitle(now: int, row: Rows, first: int, alike: bool, rules: Rules, out: Rows) -> None:
    """Write each lane's log of visible and detected against missed and clutter."""
    if alike:
        value = _title(now, row[first], rules)
        for l in range(B):
            out[O_SCORE * B + l] = value if row[l] >= 0 else NEVER
    else:
        for l in range(B):
            out[O_SCORE * B + l] = _title(now, row[l], rules) if row[l] >= 0 else NEVER


@njit(cache=True, error_model="numpy")
def _title(now: int, seen: int, rules: Rules) -> Any:
    """Return the log of visible and detected against missed and clutter, of a track with status `seen`."""
    age, kind = min(now - (seen >> 2), rules.tables.shape[2] - 1), 0 if seen & 3 == ONCE else 1
    return rules.tables[kind, 0, age] - rules.log_clutter - rules.tables[kind, 1, age]


@njit(cache=True, error_model="numpy")
def _note(w: Rows, scores: Rows) -> bool:
    """Keep a pair's scores, lane by lane; return whether any lane could associate it."""
    best = NEVER
    for l in range(B):
        value = w[W_SCORE * B + l]
        scores[l] = value
        best = max(best, value)
    return bool(best > 0.0)
