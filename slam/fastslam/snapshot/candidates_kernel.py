"""Compiled: which tracks could have given a link's measurements, predicted, and how well each pair fits."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from cellslam.slam.fastslam.parts.criterion import NEVER, score
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
)
from cellslam.slam.fastslam.state.tracks_kernel import ONCE, spokesman

B = LANES
STEEP = 3.0  # a VT higher than this times its distance on the ground is not told from others by azimuth


@njit(cache=True, error_model="numpy")
def middle(w, row):
    """Return the middle of a row's values, and how far they lie from it at most."""
    low, high = math.inf, -math.inf
    for l in range(B):
        low, high = min(low, w[row * B + l]), max(high, w[row * B + l])
    return 0.5 * (low + high), 0.5 * (high - low)


@njit(error_model="numpy")
def candidates(parts, s, now, link, count, travelled, turned, psi, psi_spread, z, first, last, rules):
    """Predict the tracks that could have given one of z[first:last] and score all pairs; return how many such tracks
    there are.

    A track whose distance or azimuth was far from every measured one when last predicted, less what the particles
    moved since, is passed over without reading its record.
    """
    possible = _within_reach(s, link, count, travelled, turned, psi, psi_spread, z, first, last, rules)
    status, records, bounds = link.status, link.records, link.bounds
    w, bits, near, rows, scores, claims = s.w, s.bits, s.near, s.rows, s.scores, s.claims
    tables, gate = rules.tables, rules.gate
    found = 0
    for i in range(possible):
        slot = near[i]
        row, out = status[slot], rows[found]
        lane, alike, _ = spokesman(row)
        predict(parts, w, records[slot], out)
        reach(w, out, lane)
        _bound(w, row, lane, out, bounds, slot, travelled, turned)
        chosen = False
        for k in range(first, last):
            claims[found, k - first] = False
            if not _fits(z[k], bounds, slot, gate, psi, psi_spread):
                continue
            if not chosen:
                _entitle(now, row, lane, alike, tables, rules.log_clutter, out)
                chosen = True
            innovate(w, out, z[k])
            invert(w, out, z[k], 1.0)
            logarithm(w, bits)
            score(parts.criterion, w, out, gate, z[k, 11])
            claims[found, k - first] = _note(w, scores[found, k - first], rules.least_score)
        if chosen:
            near[found] = slot
            found += 1
    return found


@njit(cache=True, error_model="numpy")
def _within_reach(s, link, count, travelled, turned, psi, psi_spread, z, first, last, rules):
    """Write at s.near the tracks that are not passed over, and have their records fetched; return how many there
    are."""
    order, records, near, reached = link.order, link.records, s.near, s.reached
    reached[: len(order)] = False
    for k in range(first, last):
        _reach_all(reached, link.bounds, z[k], rules.gate, rules.slack_m, travelled, turned, psi, psi_spread)
    possible = 0
    for i in range(count):
        slot = order[i]
        if reached[slot]:
            near[possible] = slot
            possible += 1
            prefetch(records[slot])
    return possible


@njit(cache=True, error_model="numpy")
def _reach_all(reached, bounds, z, gate, slack_m, travelled, turned, psi, psi_spread):
    """Note the tracks, in use or not, that a measurement could be of."""
    d, az, by_d, by_az = np.float64(z[0]), z[12] + psi, z[5], z[6]
    no_d, no_az = z[8] == 0.0, z[9] == 0.0
    for j in range(bounds.shape[1]):
        far, turn = slack_m + 1.05 * (travelled - bounds[MOVED, j]), 1.05 * (turned - bounds[TURNED, j])
        swing = far / (bounds[NEAR, j] - far)
        near, broad = bounds[NEAR, j], bounds[BROAD, j]
        close, by_distance = _distance_fits(
            d, by_d, gate, far, swing, bounds[LOW, j], bounds[HIGH, j], near, bounds[LONG, j], broad
        )
        by_azimuth = _azimuth_fits(
            az, by_az, gate, turn + psi_spread, swing, bounds[CENTRE, j], bounds[WIDTH, j], broad
        )
        reached[j] |= close | ((by_distance | no_d) & (by_azimuth | no_az))


@njit(inline="always")
def _distance_fits(d, variance, gate, far, swing, low, high, near, long, broad):
    """Say whether a track may be so close that nothing can be told, and whether a distance could be of it.

    No component alone has a greater normalised distance than all together. far: how much the distance may have changed
    since the track was last predicted, m; swing: over its least distance then. The others are its bounds.
    """
    gap = max(d - high, low - d) - far
    across = swing * near
    return near < far + far, (gap <= 0.0) | (gap * gap <= gate * (long + across * across * broad + variance))


@njit(inline="always")
def _azimuth_fits(azimuth, variance, gate, turned, swing, centre, width, broad):
    """Say whether an azimuth in the world frame could be of a track; turned: how much directions may have turned since
    it was last predicted, with the spread of the lanes' yaw."""
    turn = azimuth - centre
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    gap = abs(turn) - width - turned - swing
    closer = 1.0 + swing
    return (gap <= 0.0) | (gap * gap <= gate * (broad * closer * closer + variance))


@njit(cache=True, error_model="numpy")
def _fits(z, bounds, slot, gate, psi, psi_spread):
    """Say whether a measurement could be of a track that was predicted just now."""
    near, broad = bounds[NEAR, slot], bounds[BROAD, slot]
    _, by_distance = _distance_fits(
        z[0], z[5], gate, 0.0, 0.0, bounds[LOW, slot], bounds[HIGH, slot], near, bounds[LONG, slot], broad
    )
    by_azimuth = _azimuth_fits(
        z[12] + psi, z[6], gate, psi_spread, 0.0, bounds[CENTRE, slot], bounds[WIDTH, slot], broad
    )
    return near < 0.0 or ((by_distance or z[8] == 0.0) and (by_azimuth or z[9] == 0.0))


@njit(cache=True, error_model="numpy")
def _bound(w, row, first, out, bounds, slot, travelled, turned):
    """Write what the lanes alive expect of a track (see `layout`)."""
    low, high, left, right, near = math.inf, -math.inf, math.inf, -math.inf, math.inf
    wide, broad, steep = 0.0, 0.0, 0.0
    for l in range(B):
        if row[l] >= 0:
            low, high = min(low, w[W_REACH * B + l]), max(high, w[W_REACH * B + l])
            wide, broad = max(wide, w[(W_REACH + 1) * B + l]), max(broad, w[(W_REACH + 3) * B + l])
            left, right = min(left, w[(W_REACH + 2) * B + l]), max(right, w[(W_REACH + 2) * B + l])
            near, steep = min(near, out[O_FLAT * B + l]), max(steep, abs(out[O_Z * B + l]))
    bounds[LOW, slot], bounds[HIGH, slot], bounds[MOVED, slot] = low, high, travelled
    centre = math.atan2(out[O_Y * B + first], out[O_X * B + first]) + w[(W_POSE + 3) * B + first]
    bounds[CENTRE, slot], bounds[WIDTH, slot] = centre + 0.5 * (left + right), 0.5 * (right - left)
    bounds[TURNED, slot], bounds[NEAR, slot] = turned, near
    bounds[LONG, slot], bounds[BROAD, slot] = wide, broad
    if not right - left < 2.0 or steep > STEEP * near:
        bounds[WIDTH, slot] = math.inf


@njit(cache=True, error_model="numpy")
def _entitle(now, row, first, alike, tables, log_clutter, out):
    """Write each lane's log of visible and detected against missed and clutter."""
    horizon = tables.shape[2] - 1
    if alike:
        age, kind = min(now - (row[first] >> 2), horizon), 0 if row[first] & 3 == ONCE else 1
        value = tables[kind, 0, age] - log_clutter - tables[kind, 1, age]
        for l in range(B):
            out[O_SCORE * B + l] = value if row[l] >= 0 else NEVER
        return
    for l in range(B):
        seen = row[l]
        if seen >= 0:
            age, kind = min(now - (seen >> 2), horizon), 0 if seen & 3 == ONCE else 1
            out[O_SCORE * B + l] = tables[kind, 0, age] - log_clutter - tables[kind, 1, age]
        else:
            out[O_SCORE * B + l] = NEVER


@njit(cache=True, error_model="numpy")
def _note(w, scores, least):
    """Keep a pair's scores, lane by lane; return whether any lane could associate it."""
    best = NEVER
    for l in range(B):
        value = w[W_SCORE * B + l]
        scores[l] = value
        best = max(best, value)
    return best > least
