"""Errors of measurements that persist: deviations by place and by direction, and over which distance they change.

What the innovations of a snapshot share is the error of the odometry. Over a short drive an odometry that errs by
(forward, left, turn) = (x, y, psi) shifts every path by

    distance  -x cos az - y sin az,    azimuth  (x sin az - y cos az) / range - psi,

three numbers for all paths of a snapshot: fitted robustly where it has four paths or more, and taken off. What is left
is each path's own: a difference of two of its errors, some snapshots apart, with the variance of one

    white + place^2 (1 - rho(travelled)) + direction^2 (1 - rho(change of direction)),  rho = exp(-x^2 / (2 scale^2)),

as `slam.front_end` has it; the scale of the place is the one that fits best.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import nnls

from cellslam.recordings.fitting.fit_tracks import QUANTITIES, Tracks, innovations, robust_std
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.measurements.measurement_options import MeasurementOptions

NAMES = {"distance_m": "m", "azimuth_rad": "azimuth_deg", "elevation_rad": "elevation_deg"}
LAGS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
LEAST_SNAPSHOTS = 30
# How far the vehicle may have come, in shares of the range, for a prediction to be one.
FAR_KNOWN, FAR_UNKNOWN = 0.3, 0.03
LEAST_PATHS, ROUNDS, MOST_LEVERAGE = 4, 6, 0.8  # of the robust fit


class Persisting(NamedTuple):
    """Deviations of errors that change with the place, over `scale_m`, and with the direction; empty: not known."""

    place: dict[str, float]
    direction: dict[str, float]
    scale_m: float


@dataclass(frozen=True)
class Apart:
    """Pairs of rows of one track some snapshots apart: what is `left` (n, 3) of their innovations, in how many
    `snapshots` the odometry's error could be told, and how far the vehicle moved and turned in between, on average.
    """

    left: Floats
    snapshots: int
    moved_m: float
    turned_rad: float


def in_unit(name: str, value: float) -> float:
    """Return metres as they are, radians in degrees."""
    return value if name == "distance_m" else float(np.degrees(value))


def persisting(r: Recording, tracks: Tracks, white: dict[str, float]) -> Persisting:
    """Return the errors beyond the `white` ones, whose deviations are given by name: how paths depart from their
    predictions over more and more snapshots.
    """
    nothing = Persisting({}, {}, 0.0)
    if not all(NAMES[name] in white for name in QUANTITIES[:2]):
        return nothing
    ratio = np.maximum([white["m"], np.radians(white["azimuth_deg"])], 1e-6)
    range_m, known = reach(r, tracks)
    parts: list[Apart] = []
    for lag in LAGS:
        part = _apart(r, tracks, lag, ratio)
        clear = part.moved_m < (FAR_KNOWN if known else FAR_UNKNOWN) * range_m
        if part.snapshots < LEAST_SNAPSHOTS or part.moved_m == 0.0 or (parts and not clear):
            break
        parts.append(part)
    if len(parts) < 3:
        return nothing
    travelled = np.array([part.moved_m for part in parts])
    change = np.degrees([part.turned_rad for part in parts]) + np.degrees(travelled / range_m)
    grid = np.geomspace(0.5 * travelled[0], travelled[-1], 24)
    fits = [(*_components(parts, white, travelled, change, float(scale)), float(scale)) for scale in grid]
    return Persisting(*min(fits, key=lambda fit: fit[0])[1:])


def reach(r: Recording, tracks: Tracks) -> tuple[float, bool]:
    """Return the median distance of what is tracked, and whether it is a range: measured, the clocks known."""
    rows = np.flatnonzero(tracks.track >= 0)
    offset = r.sites.clock_offset_mean_m[r.links.site[r.measurements.link[rows]]]
    distance = r.measurements.distance_m[rows] - offset
    if np.isnan(distance).all():
        return 1.0, False
    return max(float(np.nanmedian(distance)), 1.0), bool(_offset_known(r, rows).all())


def _components(
    parts: list[Apart], white: dict[str, float], travelled: Floats, change_deg: Floats, scale_m: float
) -> tuple[float, dict[str, float], dict[str, float]]:
    """Return the misfit of a scale of the place, and the deviations of place and direction that fit best with it."""
    scale_deg = MeasurementOptions().calibration_scale_deg
    misfit, place, direction = 0.0, {}, {}
    for i, name in enumerate(QUANTITIES):
        key = NAMES[name]
        # Of one error, of which these are differences of two.
        variance = np.array([in_unit(name, robust_std(part.left[:, i]) / np.sqrt(2.0)) ** 2 for part in parts])
        if key not in white or not (variance > 0.0).all():
            continue
        columns = [-np.expm1(-0.5 * (travelled / scale_m) ** 2), -np.expm1(-0.5 * (change_deg / scale_deg) ** 2)]
        target = np.maximum(variance - white[key] ** 2, 0.0) / variance
        share, rest = nnls(np.column_stack(columns) / variance[:, None], target)
        misfit += rest**2
        place[key], direction[key] = (float(np.sqrt(s)) for s in share)
    return misfit, place, direction


def _apart(r: Recording, tracks: Tracks, lag: int, white: Floats) -> Apart:
    """Return the pairs of tracks `lag` snapshots apart, with the odometry's error taken off where it is known.

    `white` (2,): deviations of distance (m) and azimuth (rad), of which the ratio counts.
    """
    m = r.measurements
    first, second = _pairs(tracks, r, lag)
    left = innovations(r, tracks.poses, first, second)
    order = np.argsort(m.snapshot[first], kind="stable")
    snapshot = m.snapshot[first][order]
    begin = np.flatnonzero(np.append(True, np.diff(snapshot) != 0)) if len(order) else np.empty(0, np.int64)
    size = np.diff(np.append(begin, len(order)))
    snapshots, left[order, :2] = _without_motion(_design(r, first[order]), left[order, :2], white, begin, size)
    a, b = tracks.poses[m.snapshot[first]], tracks.poses[m.snapshot[second]]
    moved, turned = np.hypot(*(b[:, :2] - a[:, :2]).T), np.abs(wrap_angle(b[:, 3] - a[:, 3]))
    means = (float(moved.mean()), float(turned.mean())) if len(first) else (0.0, 0.0)
    return Apart(left, snapshots, *means)


def _pairs(tracks: Tracks, recording: Recording, lag: int) -> tuple[Ints, Ints]:
    """Return rows (n,), (n,) of one track, `lag` snapshots apart, whether or not it was detected in between."""
    rows = np.flatnonzero(tracks.track >= 0)
    snapshots = len(recording.time_s) + lag
    code = tracks.track[rows] * snapshots + recording.measurements.snapshot[rows]
    later = pd.Series(rows, code).reindex(code + lag, fill_value=-1).to_numpy()
    return rows[later >= 0], later[later >= 0]


def _offset_known(r: Recording, rows: Ints) -> NDArray[np.bool_]:
    """Return for each row (n,) whether its site's clock offset is known, so that its distance is a range."""
    known: NDArray[np.bool_] = r.sites.clock_offset_std_m[r.links.site[r.measurements.link[rows]]] == 0.0
    return known


def _design(r: Recording, rows: Ints) -> Floats:
    """Return what (forward, left, turn) does to distance and azimuth of each row, (n, 2, 3)."""
    m = r.measurements
    azimuth, flat = m.azimuth_rad[rows], np.cos(np.nan_to_num(m.elevation_rad[rows]))
    offset = r.sites.clock_offset_mean_m[r.links.site[m.link[rows]]]
    reach = np.maximum((m.distance_m[rows] - offset) * flat, 5.0)
    near = np.where(_offset_known(r, rows), 1.0 / reach, 0.0)
    c, s, none = np.cos(azimuth), np.sin(azimuth), np.zeros(len(rows))
    distance = np.stack([-c * flat, -s * flat, none], axis=1)
    return np.stack([distance, np.stack([s * near, -c * near, none - 1.0], axis=1)], axis=1)


def _without_motion(design: Floats, e: Floats, white: Floats, begin: Ints, size: Ints) -> tuple[int, Floats]:
    """Return how many snapshots have paths enough, and e (n, 2) without their (forward, left, turn), NaN elsewhere.

    Robust (Cauchy) least squares over the rows of each snapshot, which start at `begin`, with deviations in the ratio
    of the `white` ones (2,). What is left is divided by sqrt(1 - leverage): the fit takes up part of each error.
    """
    usable = np.isfinite(np.column_stack([design.sum(axis=(1, 2)), e])).all(axis=1)
    count = np.add.reduceat(usable.astype(np.int64), begin) if len(begin) else np.empty(0, np.int64)
    enough = count >= LEAST_PATHS
    if not enough.any():
        return 0, np.full_like(e, np.nan)
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
    return int(enough.sum()), own
