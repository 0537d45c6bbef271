"""Compiled: which tracks could have given a link's measurements, predicted, and how well each pair fits."""

from __future__ import annotations

import math

from numba import njit

from cellslam.slam.fastslam.criterion import NEVER, score
from cellslam.slam.fastslam.layout import (
    LANES,
    O_FLAT,
    O_SCORE,
    O_X,
    O_Y,
    O_Z,
    W_POSE,
    W_REACH,
    W_SCORE,
)
from cellslam.slam.fastslam.pair_kernel import innovate, invert, logarithm, reach
from cellslam.slam.fastslam.predict_kernel import predict
from cellslam.slam.fastslam.prefetch import prefetch
from cellslam.slam.fastslam.tracks_kernel import ONCE, spokesman

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
        row, out, bound = status[slot], rows[found], bounds[slot]
        lane, alike, _ = spokesman(row)
        predict(parts, w, records[slot], out)
        reach(w, out, lane)
        _bound(w, row, lane, out, bound, travelled, turned)
        chosen = False
        for k in range(first, last):
            claims[found, k - first] = False
            if not _in_reach(z[k], bound, gate, 0.0, 0.0, psi, psi_spread):
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
    order, bounds, records, near = link.order, link.bounds, link.records, s.near
    slack_m, gate = rules.slack_m, rules.gate
    possible = 0
    for i in range(count):
        slot = order[i]
        bound = bounds[slot]
        far = slack_m + 1.05 * (travelled - bound[2])
        turn = 1.05 * (turned - bound[5])
        for k in range(first, last):
            if _in_reach(z[k], bound, gate, far, turn, psi, psi_spread):
                near[possible] = slot
                possible += 1
                prefetch(records[slot])
                break
    return possible


@njit(cache=True, error_model="numpy")
def _in_reach(z, bound, gate, far, turned, psi, psi_spread):
    """Say whether a measurement could be of a track: `bound` says what the track could show when last predicted.

    No component alone has a greater normalised distance than all together. far: how much the distance may have changed
    since, m; turned: how much directions may have; psi +- psi_spread: yaw of the lanes.
    """
    near = bound[6] - far
    if near < far:
        return True
    swing = far / near
    if z[8] != 0.0:
        gap = max(z[0] - bound[1], bound[0] - z[0]) - far
        across = swing * bound[6]
        if gap > 0.0 and gap * gap > gate * (bound[7] + across * across * bound[8] + z[5]):
            return False
    if z[9] != 0.0:
        turn = z[12] + psi - bound[3]
        turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
        gap = abs(turn) - bound[4] - turned - swing - psi_spread
        closer = 1.0 + swing
        return gap <= 0.0 or gap * gap <= gate * (bound[8] * closer * closer + z[6])
    return True


@njit(cache=True, error_model="numpy")
def _bound(w, row, first, out, bound, travelled, turned):
    """Write what the lanes alive expect of a track: least and greatest distance, how far the particles had moved,
    azimuth in the world frame, give or take, how far they had turned, least distance from a particle, greatest variance
    of distance and of azimuth."""
    low, high, left, right, near = math.inf, -math.inf, math.inf, -math.inf, math.inf
    wide, broad, steep = 0.0, 0.0, 0.0
    for l in range(B):
        if row[l] >= 0:
            low, high = min(low, w[W_REACH * B + l]), max(high, w[W_REACH * B + l])
            wide, broad = max(wide, w[(W_REACH + 1) * B + l]), max(broad, w[(W_REACH + 3) * B + l])
            left, right = min(left, w[(W_REACH + 2) * B + l]), max(right, w[(W_REACH + 2) * B + l])
            near, steep = min(near, out[O_FLAT * B + l]), max(steep, abs(out[O_Z * B + l]))
    bound[0], bound[1], bound[2] = low, high, travelled
    centre = math.atan2(out[O_Y * B + first], out[O_X * B + first]) + w[(W_POSE + 3) * B + first]
    bound[3], bound[4] = centre + 0.5 * (left + right), 0.5 * (right - left)
    bound[5], bound[6] = turned, near
    bound[7], bound[8] = wide, broad
    if not right - left < 2.0 or steep > STEEP * near:
        bound[4] = math.inf


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
