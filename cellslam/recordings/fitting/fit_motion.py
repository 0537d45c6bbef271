"""What the innovations of a snapshot share, the error of the odometry, and what is left of each path's own.

Over a short drive an odometry that errs by (forward, left, turn) = (x, y, psi) shifts every path by

    distance  -x cos az - y sin az,    azimuth  (x sin az - y cos az) / range - psi,

three numbers for all paths of a snapshot: fitted robustly where it has four paths or more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.recordings.fitting.fit_tracks import QUANTITIES, Tracks, predicted
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording

LEAST_PATHS = 4
ROUNDS = 6
MOST_LEVERAGE = 0.8


@dataclass(frozen=True)
class Apart:
    """Pairs of rows of one track some snapshots apart: `innovation` and what is `left` of it, both (n, 3); `motion` (S,
    3): forward, left (m), turn (rad) of each snapshot that has paths enough, for which `moved_m` and `turned_rad`
    are the means."""

    first: Ints
    innovation: Floats
    left: Floats
    motion: Floats
    moved_m: float
    turned_rad: float


def pairs(tracks: Tracks, recording: Recording, lag: int) -> tuple[Ints, Ints]:
    """Return rows (n,), (n,) of one track, `lag` snapshots apart, whether or not it was detected in between."""
    rows = np.flatnonzero(tracks.track >= 0)
    snapshots = len(recording.time_s) + lag
    code = tracks.track[rows] * snapshots + recording.measurements.snapshot[rows]
    order = np.argsort(code)
    at = np.minimum(np.searchsorted(code[order], code + lag), len(code) - 1)
    found = code[order][at] == code + lag
    return rows[found], rows[order[at[found]]]


def apart(recording: Recording, tracks: Tracks, lag: int, white: Floats) -> Apart:
    """Return the pairs of tracks `lag` snapshots apart, with the odometry's error taken off where it is known.

    `white` (2,): deviations of distance (m) and azimuth (rad), of which the ratio counts.
    """
    r, m = recording, recording.measurements
    first, second = pairs(tracks, r, lag)
    z = np.column_stack([getattr(m, name)[second] for name in QUANTITIES])
    e = z - predicted(r, tracks.poses, first, m.snapshot[second])
    e[:, 1] = wrap_angle(e[:, 1])
    order = np.argsort(m.snapshot[first], kind="stable")
    snapshot = m.snapshot[first][order]
    begin = np.flatnonzero(np.append(True, np.diff(snapshot) != 0)) if len(order) else np.empty(0, np.int64)
    size = np.diff(np.append(begin, len(order)))
    motion, rest = _shared(_design(r, first[order]), e[order, :2], white, begin, size)
    left = e.copy()
    left[order, :2] = rest
    a, b = tracks.poses[m.snapshot[first]], tracks.poses[m.snapshot[second]]
    moved, turned = np.hypot(*(b[:, :2] - a[:, :2]).T), np.abs(wrap_angle(b[:, 3] - a[:, 3]))
    means = (float(moved.mean()), float(turned.mean())) if len(first) else (0.0, 0.0)
    return Apart(first, e, left, motion, *means)


def offset_known(recording: Recording, rows: Ints) -> NDArray[np.bool_]:
    """Return for each row (n,) whether its site's clock offset is known, so that its distance is a range."""
    r = recording
    known: NDArray[np.bool_] = r.sites.clock_offset_std_m[r.links.site[r.measurements.link[rows]]] == 0.0
    return known


def _design(r: Recording, rows: Ints) -> Floats:
    """Return what (forward, left, turn) does to distance and azimuth of each row, (n, 2, 3)."""
    m = r.measurements
    azimuth, flat = m.azimuth_rad[rows], np.cos(np.nan_to_num(m.elevation_rad[rows]))
    offset = r.sites.clock_offset_mean_m[r.links.site[m.link[rows]]]
    reach = np.maximum((m.distance_m[rows] - offset) * flat, 5.0)
    near = np.where(offset_known(r, rows), 1.0 / reach, 0.0)
    c, s, none = np.cos(azimuth), np.sin(azimuth), np.zeros(len(rows))
    distance = np.stack([-c * flat, -s * flat, none], axis=1)
    return np.stack([distance, np.stack([s * near, -c * near, none - 1.0], axis=1)], axis=1)


def _shared(design: Floats, e: Floats, white: Floats, begin: Ints, size: Ints) -> tuple[Floats, Floats]:
    """Return (forward, left, turn) of each snapshot with paths enough, and e (n, 2) without it, NaN elsewhere.

    Robust (Cauchy) least squares over the rows of each snapshot, which start at `begin`, with deviations in the ratio
    of the `white` ones (2,). What is left is divided by sqrt(1 - leverage): the fit takes up part of each error.
    """
    usable = np.isfinite(np.column_stack([design.sum(axis=(1, 2)), e])).all(axis=1)
    count = np.add.reduceat(usable.astype(np.int64), begin) if len(begin) else np.empty(0, np.int64)
    enough = count >= LEAST_PATHS
    if not enough.any():
        return np.empty((0, 3)), np.full_like(e, np.nan)
    used = usable & np.repeat(enough, size)
    h, y = np.where(usable[:, None, None], design, 0.0) / white[:, None], np.where(usable[:, None], e, 0.0) / white
    weight = np.repeat(usable[:, None].astype(np.float64), 2, axis=1)
    for _ in range(ROUNDS):
        normal = np.add.reduceat(np.einsum("nqi,nq,nqj->nij", h, weight, h), begin) + 1e-9 * np.eye(3)
        right = np.add.reduceat(np.einsum("nqi,nq,nq->ni", h, weight, y), begin)
        motion = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        rest = y - np.einsum("nqi,ni->nq", h, np.repeat(motion, size, axis=0))
        scale = max(1.4826 * float(np.median(np.abs(rest[used]))), 1e-9)
        lowered = 1.0 / (1.0 + (rest / (2.0 * scale)) ** 2)
        leverage = weight * np.einsum("nqi,nij,nqj->nq", h, np.repeat(np.linalg.inv(normal), size, axis=0), h)
        weight = np.where(usable[:, None], lowered, 0.0)
    kept = used[:, None] & (leverage < MOST_LEVERAGE)
    own: Floats = np.where(kept, rest * white / np.sqrt(np.maximum(1.0 - leverage, 1.0 - MOST_LEVERAGE)), np.nan)
    shared: Floats = np.array(motion[enough], np.float64)
    return shared, own
