"""Compiled: one snapshot for every block of particles: move, associate, update, weigh, give birth, drop.

Parallel over blocks, each thread with scratch of its own; no block reads another, so the result does not depend on the
number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import get_thread_id, njit, prange  # type: ignore[attr-defined]

from cellslam.slam.fastslam.assignment import assign
from cellslam.slam.fastslam.layout import (
    HITS,
    LANES,
    O_FULL,
    O_SCORE,
    O_X,
    O_Y,
    POSE,
    POSE_G,
    THETA,
    V_WEIGHT,
    W_B,
    W_BIAS,
    W_D2,
    W_DROT,
    W_LOG,
    W_MASK,
    W_P,
    W_POSE,
    W_REACH,
    W_ROT,
    W_SCALE,
    W_SCORE,
)
from cellslam.slam.fastslam.nuisance_kernel import absorb, collect, condition, forget
from cellslam.slam.fastslam.predict_kernel import (
    LOG_2PI_3,
    complete,
    correct,
    give_birth,
    innovate,
    invert,
    logarithm,
    predict,
    reach,
    score,
)

B = LANES
DEAD = -1  # status of a lane that does not believe in a track; else 4 * snapshot last seen + class
ONCE, UNCONFIRMED, CONFIRMED = 1, 2, 3
UNKNOWN = -2  # in `alike`


@njit(cache=True, error_model="numpy")
def _spokesman(row):
    """Return the first lane alive, -1 if none; whether all lanes alive have its status; whether all lanes are alive."""
    low, high = row[0], row[0]
    for l in range(B):
        low, high = min(low, row[l]), max(high, row[l])
    if low == high:
        return (0 if low >= 0 else -1), True, low >= 0
    different = 0
    for l in range(B):
        different |= (row[l] ^ high) & ~(row[l] >> 31)
    first = 0
    while row[first] < 0:
        first += 1
    return first, different == 0, False


@njit(cache=True, error_model="numpy")
def _prepare(w, state):
    """Copy pose and sensitivities, write the rotation and its derivative by yaw, clear the sums."""
    for i in range(12 * B):
        w[W_POSE * B + i] = state[POSE * B + i]
    for l in range(B):
        psi, theta, phi = w[(W_POSE + 3) * B + l], w[(W_POSE + 4) * B + l], w[(W_POSE + 5) * B + l]
        cp, sp, ct, st, cr, sr = math.cos(psi), math.sin(psi), 1.0, 0.0, 1.0, 0.0
        if theta != 0.0 or phi != 0.0:
            ct, st, cr, sr = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
        r0, r1, r2 = cp * ct, cp * st * sr - sp * cr, cp * st * cr + sp * sr
        r3, r4, r5 = sp * ct, sp * st * sr + cp * cr, sp * st * cr - cp * sr
        w[W_ROT * B + l], w[(W_ROT + 1) * B + l], w[(W_ROT + 2) * B + l] = r0, r1, r2
        w[(W_ROT + 3) * B + l], w[(W_ROT + 4) * B + l], w[(W_ROT + 5) * B + l] = r3, r4, r5
        w[(W_ROT + 6) * B + l], w[(W_ROT + 7) * B + l], w[(W_ROT + 8) * B + l] = -st, ct * sr, ct * cr
        w[W_DROT * B + l], w[(W_DROT + 1) * B + l], w[(W_DROT + 2) * B + l] = -r3, -r4, -r5
        w[(W_DROT + 3) * B + l], w[(W_DROT + 4) * B + l], w[(W_DROT + 5) * B + l] = r0, r1, r2


@njit(cache=True, error_model="numpy")
def _middle(w, row):
    """Return the middle of a row's values, and how far they lie from it at most."""
    low, high = math.inf, -math.inf
    for l in range(B):
        low, high = min(low, w[row * B + l]), max(high, w[row * B + l])
    return 0.5 * (low + high), 0.5 * (high - low)


@njit(cache=True, error_model="numpy")
def _load_site(w, state, site, size):
    """Copy the nuisance mean and covariance that concern one site."""
    cov = THETA + size
    last = size - 2
    for l in range(B):
        w[W_B * B + l] = state[(THETA + site) * B + l]
        w[W_BIAS * B + l] = state[(THETA + last) * B + l]
        w[W_SCALE * B + l] = state[(THETA + last + 1) * B + l]
        w[W_P * B + l] = state[(cov + site * size + site) * B + l]
        w[(W_P + 1) * B + l] = state[(cov + site * size + last) * B + l]
        w[(W_P + 2) * B + l] = state[(cov + site * size + last + 1) * B + l]
        w[(W_P + 3) * B + l] = state[(cov + last * size + last) * B + l]
        w[(W_P + 4) * B + l] = state[(cov + last * size + last + 1) * B + l]
        w[(W_P + 5) * B + l] = state[(cov + (last + 1) * size + last + 1) * B + l]


@njit(cache=True, error_model="numpy")
def _age(v, now, status, alike, order, count, tables, cfg, share):
    """Charge each lane for each VT as missed, drop what was never confirmed and is unlikely to be there; return the
    number of tracks.

    alike (C,): the status that all lanes of a track have, UNKNOWN where that must be looked up.
    """
    horizon = tables.shape[2] - 1
    i = 0
    common = 0.0
    while i < count:
        slot = order[i]
        seen = alike[slot]
        if seen & 3 == CONFIRMED and seen >= 0:
            common += tables[1, 1, min(now - (seen >> 2), horizon)]
            i += 1
            continue
        row = status[slot]
        first, same, whole = _spokesman(row)
        alike[slot] = row[0] if whole else UNKNOWN
        if first >= 0 and same:
            age, kind = min(now - (row[first] >> 2), horizon), row[first] & 3
            charge = share * tables[0 if kind == ONCE else 1, 1, age]
            if (kind == ONCE and age > cfg[5]) or (kind == UNCONFIRMED and age > cfg[6]):
                first = -1
            else:
                for l in range(B):
                    v[V_WEIGHT * B + l] += charge if row[l] >= 0 else 0.0
        elif first >= 0:
            first = _age_each(v, now, row, tables, cfg, share)
        if first >= 0:
            i += 1
        else:
            count -= 1
            order[i], order[count] = order[count], order[i]
    common *= share
    for l in range(B):
        v[V_WEIGHT * B + l] += common
    return count


@njit(cache=True, error_model="numpy")
def _age_each(v, now, row, tables, cfg, share):
    """Do the same for a track that the lanes saw last at different times; return -1 if no lane keeps it."""
    horizon = tables.shape[2] - 1
    kept = -1
    for l in range(B):
        s = row[l]
        if s >= 0:
            age, kind = min(now - (s >> 2), horizon), s & 3
            if (kind == ONCE and age > cfg[5]) or (kind == UNCONFIRMED and age > cfg[6]):
                row[l] = DEAD
            else:
                v[V_WEIGHT * B + l] += share * tables[0 if kind == ONCE else 1, 1, age]
                kept = l
    return kept


@njit(cache=True, error_model="numpy")
def _span(z, first, last):
    """Return the least and the greatest distance that z[first:last] can stand for, give or take 6 sigma."""
    low, high = math.inf, -math.inf
    for k in range(first, last):
        if z[k, 8] == 0.0:
            return -math.inf, math.inf
        low, high = min(low, z[k, 0] - z[k, 13]), max(high, z[k, 0] + z[k, 13])
    return low, high


@njit(cache=True, error_model="numpy")
def _in_reach(z, bound, far, turned, psi, psi_spread):
    """Say whether a measurement could be of a track: `bound` says what the track could show when last predicted.

    far: how much the distance may have changed since, m; turned: how much directions may have; psi +- psi_spread: yaw
    of the lanes.
    """
    if z[8] != 0.0 and (z[0] + z[13] + far < bound[0] or z[0] - z[13] - far > bound[1]):
        return False
    if z[9] != 0.0 and bound[6] > 2.0 * far:
        wide = z[14] + bound[4] + turned + far / (bound[6] - far) + psi_spread
        turn = z[12] + psi - bound[3]
        turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
        return abs(turn) <= wide
    return True


@njit(cache=True, error_model="numpy")
def _entitle(w, now, row, first, alike, tables, cfg, out):
    """Write each lane's log of visible and detected against missed and clutter."""
    horizon = tables.shape[2] - 1
    if alike:
        age, kind = min(now - (row[first] >> 2), horizon), 0 if row[first] & 3 == ONCE else 1
        value = tables[kind, 0, age] - cfg[0] - tables[kind, 1, age]
        for l in range(B):
            out[O_SCORE * B + l] = value if row[l] >= 0 else -1e30
        return
    for l in range(B):
        s = row[l]
        if s >= 0:
            age, kind = min(now - (s >> 2), horizon), 0 if s & 3 == ONCE else 1
            out[O_SCORE * B + l] = tables[kind, 0, age] - cfg[0] - tables[kind, 1, age]
        else:
            out[O_SCORE * B + l] = -1e30


@njit(cache=True, error_model="numpy")
def _bound(w, row, first, out, bound, travelled, turned):
    """Write what the lanes alive could measure of a track: least and greatest distance, how far the particles had
    moved, azimuth in the world frame, give or take, how far they had turned, least distance from a particle."""
    low, high, left, right, near = math.inf, -math.inf, math.inf, -math.inf, math.inf
    for l in range(B):
        if row[l] >= 0:
            low, high = min(low, w[W_REACH * B + l]), max(high, w[(W_REACH + 1) * B + l])
            left, right = min(left, w[(W_REACH + 2) * B + l]), max(right, w[(W_REACH + 3) * B + l])
            near = min(near, out[O_FULL * B + l])
    bound[0], bound[1], bound[2] = low, high, travelled
    centre = math.atan2(out[O_Y * B + first], out[O_X * B + first]) + w[(W_POSE + 3) * B + first]
    bound[3], bound[4] = centre + 0.5 * (left + right), 0.5 * (right - left)
    bound[5], bound[6] = turned, near
    if not right - left < 2.0:
        bound[4] = math.inf


@njit(cache=True, error_model="numpy")
def _note(w, scores):
    """Keep a pair's scores, lane by lane; return whether any lane would gain by associating it."""
    best = -math.inf
    for l in range(B):
        value = w[W_SCORE * B + l]
        scores[l] = value
        best = max(best, value)
    return best > 0.0


@njit(cache=True, error_model="numpy")
def _candidates(
    w,
    bits,
    now,
    status,
    records,
    order,
    count,
    bounds,
    travelled,
    turned,
    psi,
    psi_spread,
    z,
    first,
    last,
    tables,
    cfg,
    near,
    rows,
    scores,
    claims,
):
    """Predict the tracks that could have given one of z[first:last] and score all pairs; return how many such tracks
    there are.

    A track whose distance or azimuth was far from every measured one when last predicted, less what the particles
    moved since, is passed over without reading its record.
    """
    found = 0
    least, most = _span(z, first, last)
    for i in range(count):
        slot = order[i]
        bound = bounds[slot]
        far = cfg[3] + 1.05 * (travelled - bound[2])
        if most + far < bound[0] or least - far > bound[1]:
            continue
        turn = 1.05 * (turned - bound[5])
        possible = False
        for k in range(first, last):
            possible = possible or _in_reach(z[k], bound, far, turn, psi, psi_spread)
        if not possible:
            continue
        row, out = status[slot], rows[found]
        lane, alike, _ = _spokesman(row)
        predict(w, records[slot], out)
        reach(w, out, lane)
        _bound(w, row, lane, out, bound, travelled, turned)
        chosen = False
        for k in range(first, last):
            claims[found, k - first] = False
            if not _in_reach(z[k], bound, 0.0, 0.0, psi, psi_spread):
                continue
            if not chosen:
                _entitle(w, now, row, lane, alike, tables, cfg, out)
                chosen = True
            innovate(w, out, z[k])
            invert(w, out, z[k], 1.0)
            logarithm(w, bits)
            score(w, out, cfg[1], z[k, 11])
            claims[found, k - first] = _note(w, scores[found, k - first])
        if chosen:
            near[found] = slot
            found += 1
    return found


@njit(cache=True)
def _associate(w, scores, claims, found, measured, row_of, table, column, floats, ints):
    """Write row_of (measured, LANES): the track of each measurement in each lane, -1 for none.

    Each measurement takes the track that gains most. Where that leaves no track with two measurements nothing can be
    better; the other lanes are solved one by one.
    """
    for k in range(measured):
        _take_best(w, scores, claims, found, k, row_of[k])
    rivals = False
    for q in range(found):
        total = 0
        for k in range(measured):
            total += claims[q, k]
        rivals = rivals or total > 1
    if not rivals:
        return
    for l in range(B):
        clash = False
        for k in range(1, measured):
            for i in range(k):
                clash = clash or (row_of[k, l] >= 0 and row_of[k, l] == row_of[i, l])
        if clash:
            for q in range(found):
                for k in range(measured):
                    table[q, k] = scores[q, k, l] if claims[q, k] else -1.0
            assign(table, found, measured, column, floats, ints)
            for k in range(measured):
                row_of[k, l] = column[k]


@njit(cache=True, error_model="numpy")
def _take_best(w, scores, claims, found, k, mine):
    """Write the track with the greatest positive score of measurement k, lane by lane, -1 for none."""
    F = w.dtype.type
    for l in range(B):
        mine[l] = -1
        w[W_D2 * B + l] = F(0.0)
    for q in range(found):
        if claims[q, k]:
            gain, track = scores[q, k], np.int32(q)
            for l in range(B):
                better = gain[l] > w[W_D2 * B + l]
                mine[l] = track if better else mine[l]
                w[W_D2 * B + l] = gain[l] if better else w[W_D2 * B + l]


@njit(cache=True, error_model="numpy")
def _credit(w, v, out, lack, share):
    """Add what the association at hand is worth, where W_MASK is 1: the fit e^T S^-1 e, and `share` of all the rest.

    `lack`: see `measurement_kernel.pack`. The links of a site see the same VT come and go, so that each counts for its
    share only.
    """
    F = w.dtype.type
    half, part, rest = F(0.5), F(share), F(lack - LOG_2PI_3)
    for l in range(B):
        value = part * (out[O_SCORE * B + l] + rest - half * w[W_LOG * B + l]) - half * w[W_D2 * B + l]
        v[V_WEIGHT * B + l] += value if w[W_MASK * B + l] > half else F(0.0)


@njit(cache=True, error_model="numpy")
def _mask(w, row_of, q):
    """Set W_MASK to 1 in the lanes whose measurement goes to track q; return whether there are any."""
    F = w.dtype.type
    wanted, any_ = np.int32(q), np.int32(0)
    for l in range(B):
        w[W_MASK * B + l] = F(1.0) if row_of[l] == wanted else F(0.0)
        any_ |= np.int32(row_of[l] == wanted)
    return any_ != 0


@njit(cache=True, error_model="numpy")
def _update(
    w,
    bits,
    v,
    now,
    status,
    alike,
    records,
    ident,
    near,
    found,
    rows,
    row_of,
    claims,
    z,
    first,
    last,
    cfg,
    share,
    association,
):
    """Update every associated track; return the number of associations, lanes counted once.

    `association` takes up those with confirmed VTs.
    """
    updates = 0
    for q in range(found):
        slot = near[q]
        record, out, row = records[slot], rows[q], status[slot]
        for k in range(first, last):
            if not claims[q, k - first] or not _mask(w, row_of[k - first], q):
                continue
            innovate(w, out, z[k])
            invert(w, out, z[k], 0.0)
            logarithm(w, bits)
            _credit(w, v, out, z[k, 11], share)
            absorb(w, out)
            correct(w, record, out)
            updates += 1
            mine = association[k]
            for l in range(B):
                on = w[W_MASK * B + l] > 0.5
                seen = 4 * now + (CONFIRMED if record[HITS * B + l] >= cfg[4] else UNCONFIRMED)
                row[l] = seen if on else row[l]
                mine[l] = ident[slot] if on and seen & 3 == CONFIRMED else mine[l]
            alike[slot] = UNKNOWN
    return updates


@njit(cache=True, error_model="numpy")
def _give_births(
    w,
    v,
    now,
    status,
    alike,
    records,
    ident,
    order,
    count,
    bounds,
    travelled,
    row_of,
    z,
    first,
    last,
    born,
    cfg,
    share,
    block,
):
    """Start a track for each measurement that no particle's VT explains; return the number of tracks."""
    for k in range(first, last):
        if z[k, 8] + z[k, 9] == 0.0:
            continue
        anywhere = False
        for l in range(B):
            on = row_of[k - first, l] < 0 and (z[k, 8] == 0.0 or z[k, 0] - w[W_B * B + l] > 1.0)
            w[W_MASK * B + l] = 1.0 if on else 0.0
            anywhere = anywhere or on
        if not anywhere:
            continue
        if count == order.shape[0]:
            count = _evict(now, status, order, count)
        slot = order[count]
        count += 1
        complete(w, z[k], block * B, born + k)
        give_birth(w, records[slot], z[k])
        ident[slot], alike[slot] = born + k, UNKNOWN
        spread = 6.0 * math.sqrt(z[k, 5]) if z[k, 8] > 0.0 else math.inf
        bounds[slot, 0], bounds[slot, 1], bounds[slot, 2] = z[k, 0] - spread, z[k, 0] + spread, travelled
        bounds[slot, 4] = math.inf
        for l in range(B):
            on = w[W_MASK * B + l] > 0.5
            status[slot, l] = 4 * now + (CONFIRMED if cfg[4] <= 1.0 else ONCE) if on else DEAD
            v[V_WEIGHT * B + l] += share * cfg[2] if on else 0.0
    return count


@njit(cache=True, error_model="numpy")
def _evict(now, status, order, count):
    """Give up the track that is confirmed in the fewest lanes, longest unseen; its place is then the first free one."""
    worst, worst_rank = 0, math.inf
    for i in range(count):
        rank = 0.0
        for l in range(B):
            s = status[order[i], l]
            if s >= 0:
                rank += (s & 3) + 1.0 / (2.0 + now - (s >> 2))
        if rank < worst_rank:
            worst, worst_rank = i, rank
    order[worst], order[count - 1] = order[count - 1], order[worst]
    return count - 1


@njit(cache=True, error_model="numpy")
def advance(s, travelled, u, dt, size):
    """Advance the poses of a block by sampled body velocities u (6, LANES), corrected by the nuisance mean; carry the
    sensitivities.

    The paper's motion model, with the attitude taken at mid-interval. u: measured, less what was sampled of its errors.
    """
    farthest = 0.0
    for l in range(B):
        bias, scale = s[(THETA + size - 2) * B + l], s[(THETA + size - 1) * B + l]
        stretch = 1.0 / (1.0 + scale)
        turn = (u[3, l] - bias) * dt
        psi = s[(POSE + 3) * B + l] + 0.5 * turn
        theta, phi = s[(POSE + 4) * B + l] + 0.5 * u[4, l] * dt, s[(POSE + 5) * B + l] + 0.5 * u[5, l] * dt
        cp, sp, ct, st, cr, sr = math.cos(psi), math.sin(psi), 1.0, 0.0, 1.0, 0.0
        if theta != 0.0 or phi != 0.0:
            ct, st, cr, sr = math.cos(theta), math.sin(theta), math.cos(phi), math.sin(phi)
        ux, uy, uz = u[0, l] * stretch * dt, u[1, l] * dt, u[2, l] * dt
        mx = cp * ct * ux + (cp * st * sr - sp * cr) * uy + (cp * st * cr + sp * sr) * uz
        my = sp * ct * ux + (sp * st * sr + cp * cr) * uy + (sp * st * cr - cp * sr) * uz
        mz = -st * ux + ct * sr * uy + ct * cr * uz
        s[POSE * B + l] += mx
        s[(POSE + 1) * B + l] += my
        s[(POSE + 2) * B + l] += mz
        s[(POSE + 3) * B + l] += turn
        s[(POSE + 4) * B + l] += u[4, l] * dt
        s[(POSE + 5) * B + l] += u[5, l] * dt
        # d(x, y)/d(bias, scale): through the heading at mid-interval, and through the stretch
        by_bias, by_scale = s[(POSE_G + 4) * B + l] - 0.5 * dt, s[(POSE_G + 5) * B + l]
        s[POSE_G * B + l] -= my * by_bias
        s[(POSE_G + 1) * B + l] -= my * by_scale + cp * ct * ux * stretch
        s[(POSE_G + 2) * B + l] += mx * by_bias
        s[(POSE_G + 3) * B + l] += mx * by_scale - sp * ct * ux * stretch
        s[(POSE_G + 4) * B + l] -= dt
        farthest = max(farthest, abs(mx) + abs(my) + abs(mz))
    for site in range(travelled.shape[0] - 1):
        travelled[site] += farthest


@njit(cache=True, error_model="numpy")
def _block(
    block,
    now,
    dt,
    velocity,
    state,
    status,
    alike,
    records,
    ident,
    order,
    counts,
    bounds,
    travelled,
    first,
    site_of,
    shares,
    z,
    z_many,
    z_fresh,
    born,
    tables,
    cfg,
    log_weight,
    association,
    w,
    bits,
    v,
    near,
    rows,
    scores,
    claims,
    row_of,
    table,
    column,
    floats,
    ints,
):
    """Use one snapshot in one block."""
    size = travelled.shape[0] + 1
    turned = travelled[size - 2]
    if dt > 0.0:
        advance(state, travelled, velocity, dt, size)
    _prepare(w, state)
    psi, psi_spread = _middle(w, W_POSE + 3)
    forget(w, v, size)
    updates, loaded = 0, -1
    for link in range(counts.shape[0]):
        start, stop, site = first[link], first[link + 1], site_of[link]
        share = shares[link]
        counts[link] = _age(v, now, status[link], alike[link], order[link], counts[link], tables, cfg, share)
        if stop == start:
            continue
        if site != loaded:
            _load_site(w, state, site, size)
            loaded = site
        found = _candidates(
            w,
            bits,
            now,
            status[link],
            records[link],
            order[link],
            counts[link],
            bounds[link],
            travelled[site],
            turned,
            psi,
            psi_spread,
            z,
            start,
            stop,
            tables,
            cfg,
            near,
            rows,
            scores,
            claims,
        )
        _associate(w, scores, claims, found, stop - start, row_of, table, column, floats, ints)
        more = _update(
            w,
            bits,
            v,
            now,
            status[link],
            alike[link],
            records[link],
            ident[link],
            near,
            found,
            rows,
            row_of,
            claims,
            z_many,
            start,
            stop,
            cfg,
            share,
            association,
        )
        if more > 0:
            collect(w, v, site, size)
        updates += more
        counts[link] = _give_births(
            w,
            v,
            now,
            status[link],
            alike[link],
            records[link],
            ident[link],
            order[link],
            counts[link],
            bounds[link],
            travelled[site],
            row_of,
            z_fresh,
            start,
            stop,
            born,
            cfg,
            share,
            block,
        )
    if updates > 0:
        _apply(v, state, travelled, size)
    for l in range(B):
        log_weight[l] += cfg[7] * v[V_WEIGHT * B + l]


@njit(cache=True, error_model="numpy")
def _apply(v, state, travelled, size):
    """Condition theta on the snapshot and move theta and pose by its change."""
    change = (v.shape[0] // B - size) * B
    cov = change - size * size * B
    for i in range(size * size * B):
        v[cov + i] = state[(THETA + size) * B + i]
    condition(v, cov, change, size)
    for i in range(size * size * B):
        state[(THETA + size) * B + i] = v[cov + i]
    for i in range(size * B):
        state[THETA * B + i] += v[change + i]
    bias, scale = change + (size - 2) * B, change + (size - 1) * B
    shift, turn = 0.0, 0.0
    for l in range(B):
        dx = state[POSE_G * B + l] * v[bias + l] + state[(POSE_G + 1) * B + l] * v[scale + l]
        dy = state[(POSE_G + 2) * B + l] * v[bias + l] + state[(POSE_G + 3) * B + l] * v[scale + l]
        by_bias, by_scale = state[(POSE_G + 4) * B + l] * v[bias + l], state[(POSE_G + 5) * B + l] * v[scale + l]
        state[POSE * B + l] += dx
        state[(POSE + 1) * B + l] += dy
        state[(POSE + 3) * B + l] += by_bias + by_scale
        shift, turn = max(shift, abs(dx) + abs(dy)), max(turn, abs(by_bias) + abs(by_scale))
    for site in range(size - 2):
        largest = 0.0
        for l in range(B):
            largest = max(largest, abs(v[change + site * B + l]))
        travelled[site] += shift + largest
    travelled[size - 2] += turn


@njit(cache=True, parallel=True)
def update(
    now,
    dt,
    velocity,
    state,
    status,
    alike,
    records,
    ident,
    order,
    counts,
    bounds,
    travelled,
    first,
    site_of,
    shares,
    z,
    z_many,
    z_fresh,
    born,
    tables,
    cfg,
    log_weight,
    association,
    w,
    bits,
    v,
    near,
    rows,
    scores,
    claims,
    row_of,
    table,
    column,
    floats,
    ints,
):
    """Move by velocity (G, 6, LANES) for dt, then use one snapshot, in every block: G blocks, L links, C tracks a link,
    M measurements.

    state (G, F LANES), status (G, L, C, LANES), alike (G, L, C), records (G, L, C, RECORD LANES), ident, order (G, L,
    C), counts (G, L), bounds (G, L, C, 7), travelled (G, S + 1), log_weight (G, LANES): written. first (L + 1,): first
    measurement of each link; shares (L,): weight of a link's evidence on which VTs there are; z, z_many, z_fresh (M,
    15): see `measurement_kernel.pack`; born: number of the first measurement; tables (2, 2, ages): log of visible-and-
    detected and of missed, for VTs seen once and others; cfg: log clutter density, gate, log-weight of a birth, slack
    of the distance test, hits to confirm, ages to drop at (2), likelihood exponent. association (G, M, LANES) is
    written; the rest is scratch, one a thread.
    """
    for g in prange(state.shape[0]):
        t = get_thread_id()
        _block(
            g,
            now,
            dt,
            velocity[g],
            state[g],
            status[g],
            alike[g],
            records[g],
            ident[g],
            order[g],
            counts[g],
            bounds[g],
            travelled[g],
            first,
            site_of,
            shares,
            z,
            z_many,
            z_fresh,
            born,
            tables,
            cfg,
            log_weight[g],
            association[g],
            w[t],
            bits[t],
            v[t],
            near[t],
            rows[t],
            scores[t],
            claims[t],
            row_of[t],
            table[t],
            column[t],
            floats[t],
            ints[t],
        )
