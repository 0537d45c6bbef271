"""How measurements, odometry and reference of a recording change together: the evidence behind `suspicions`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellslam.benchmarks.recordings.importing.odometry_resampling import Motion, integrate
from cellslam.benchmarks.scores.metrics import within
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.api import odometry_of

PAIRS = 60_000  # of measurements at most: more say nothing new
STEP_M, TURN_RAD = 2.0, 0.15  # how far the vehicle shall have come, or turned, between the snapshots of a pair
SHORT = 0.25
LONGEST_LAG = 60
LEAST_PAIRS = 60
WINDOW_M, WINDOWS = 8.0, 12


@dataclass(frozen=True)
class Slopes:
    """Change of distance against the odometry's: factor `distance` and angle of the azimuths' zero; of azimuth: `turn`.

    All with standard errors; NaN where nothing tells. `turned_rad`: turn of a typical pair of those that turn.
    """

    pairs: int
    distance: float
    distance_error: float
    azimuth_zero_rad: float
    azimuth_zero_error: float
    turns: int
    turn: float
    turn_error: float
    turned_rad: float


@dataclass(frozen=True)
class Track:
    """The reference against the odometry: ratio of lengths, slope of turns, direction of the first stretch; its own
    course
    and yaw (N,) where it moves."""

    length_ratio: float
    turn_slope: float
    turn_error: float
    start_turn_rad: float
    course_rad: Floats
    yaw_rad: Floats


def dead_reckoned(recording: Recording, times: Floats) -> Floats:
    """Return poses (N, 6), in m and rad, of the odometry alone at `times` (N,) in s within the drive."""
    motion = Motion(recording.time_s, odometry_of(recording)[1:], (True,) * 6)
    poses, _ = integrate(
        motion,
        np.insert(times, 0, recording.time_s[0]) if times[0] > recording.time_s[0] else times,
        recording.start_pose,
    )
    return poses[-len(times) :]


def slopes(recording: Recording) -> Slopes | None:
    """Return how distances and azimuths change with the odometry; None without distances, azimuths or odometry."""
    m, r = recording.measurements, recording
    if (
        np.isnan(m.distance_m).all()
        or np.isnan(m.azimuth_rad).all()
        or np.isnan(r.odometry[:, 0]).all()
        or len(r.time_s) < 3
    ):
        return None
    poses = dead_reckoned(r, r.time_s)
    first, second = _pairs(r, poses)
    if len(first) < LEAST_PAIRS:
        return None
    a, b = poses[m.snapshot[first]], poses[m.snapshot[second]]
    moved = _in_body(a, b)
    azimuth, elevation = m.azimuth_rad[first], np.nan_to_num(m.elevation_rad[first])
    # Azimuths turn with the vehicle in between: those at the middle belong to the mean displacement.
    flat = -moved[:, 0] * np.cos(elevation)
    side = -moved[:, 0] * np.cos(elevation)
    change = m.distance_m[second] - m.distance_m[first]
    design = np.column_stack([flat * np.cos(azimuth), side * np.sin(azimuth)])
    coefficients, errors = _robust(design, change)
    size = float(np.hypot(*coefficients))
    error = float(np.hypot(*errors))
    turning = wrap_angle(b[:, 3] - a[:, 3])
    swung = wrap_angle(m.azimuth_rad[second] - azimuth)
    known = _offset_known(r)[m.link[first]]
    reach = np.maximum(m.distance_m[first], 1.0)
    parallax = np.where(known, (moved[:, 0] * np.sin(azimuth) - moved[:, 1] * np.cos(azimuth)) / reach, 0.0)
    turns = (np.abs(turning) > min(0.3 * TURN_RAD, np.quantile(np.abs(turning), 0.8))) & (np.abs(parallax) < 0.5)
    slope, slope_error = np.array([np.nan]), np.array([np.nan])
    if turns.sum() >= LEAST_PAIRS:
        slope, slope_error = _robust(-turning[turns, None], (swung - parallax)[turns])
    return Slopes(
        len(first),
        size,
        error,
        float(np.arctan2(coefficients[1], coefficients[0])),
        error / max(size, 1e-12),
        int(turns.sum()),
        float(slope[0]),
        float(slope_error[0]),
        float(np.median(np.abs(turning[turns]))) if turns.any() else 0.0,
    )


def _offset_known(recording: Recording) -> NDArray[np.bool_]:
    known: NDArray[np.bool_] = (recording.sites.clock_offset_std_m == 0.0)[recording.links.site]
    return known


def _in_body(a: Floats, b: Floats) -> Floats:
    """Return the displacement (N, 2) from poses a to b in the body frame half-way."""
    heading = a[:, 3]
    step = b[:, :2] - a[:, :2]
    c, s = np.cos(heading), np.sin(heading)
    return np.column_stack([c * step[:, 0] + s * step[:, 1], -s * step[:, 0] + c * step[:, 1]])


def _pairs(recording: Recording, poses: Floats) -> tuple[Ints, Ints]:
    """Return rows of measurements that are the same path a little later: on their link, alone nearest in distance."""
    m = recording.measurements
    links = max(len(recording.links), 1)
    usable = np.flatnonzero(~np.isnan(m.distance_m) & ~np.isnan(m.azimuth_rad))
    key = m.snapshot[usable] * links + m.link[usable]
    order = usable[np.lexsort((m.distance_m[usable], key))]
    key, distance = m.snapshot[order] * links + m.link[order], m.distance_m[order]
    span = float(distance.max() - distance.min()) * 4.0 + 1.0
    place = key * span + (distance - distance.min())
    apart = _neighbour_gap(place, span)
    apart = apart[np.isfinite(apart)]
    lag = _lag(poses, float(np.median(apart)) if len(apart) else np.inf)
    chosen = np.arange(len(order))
    if len(chosen) > PAIRS:
        chosen = np.unique(np.linspace(0, len(chosen) - 1, PAIRS).astype(np.int64))
    wanted = place[chosen] + lag * links * span
    near, gap, rival = _nearest(place, wanted, span)
    back, _, _ = _nearest(place, place[near] - lag * links * span, span)
    # Alone: the next candidate is three times as far, there and at home.
    alone = (gap < rival / 3.0) & (back == chosen) & (_neighbour_gap(place, span)[chosen] > 3.0 * gap)
    return order[chosen[alone]], order[near[alone]]


def _nearest(place: Floats, wanted: Floats, span: float) -> tuple[Ints, Floats, Floats]:
    """Return the nearest entry in `place`, its gap, and the gap of the second nearest; infinite beyond the link."""
    right = np.searchsorted(place, wanted)
    candidates = np.stack([right - 2, right - 1, right, right + 1])
    inside = (candidates >= 0) & (candidates < len(place))
    gaps = np.abs(place[np.clip(candidates, 0, len(place) - 1)] - wanted)
    gaps = np.where(inside & (gaps < 0.5 * span), gaps, np.inf)
    order = np.argsort(gaps, axis=0)
    take = np.arange(len(wanted))
    return (
        np.clip(candidates[order[0], take], 0, len(place) - 1),
        gaps[order[0], take],
        gaps[order[1], take],
    )


def _neighbour_gap(place: Floats, span: float) -> Floats:
    gap = np.diff(place)
    gap = np.where(gap < 0.5 * span, gap, np.inf)
    nearest: Floats = np.minimum(np.append(gap, np.inf), np.insert(gap, 0, np.inf))
    return nearest


def _lag(poses: Floats, apart_m: float) -> int:
    """Return over how many snapshots the vehicle comes a step further, or turns enough, in the middle.

    A step is short against `apart_m`, how far the paths of a link are apart: or one would be taken for the other.
    """
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turn = np.abs(np.diff(poses[:, 3]))
    share = np.maximum(step / max(min(STEP_M, SHORT * apart_m), 1e-3), turn / TURN_RAD)
    typical = float(np.mean(share[share > 0])) if (share > 0).any() else 1.0
    return int(np.clip(round(1.0 / max(typical, 1e-9)), 1, min(LONGEST_LAG, max(len(step) // 2, 1))))


def _robust(design: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return coefficients and standard errors of a regression that outliers hardly move (Cauchy weights, 30 rounds)."""
    weight = np.ones(len(target))
    coefficients = np.zeros(design.shape[1])
    for _ in range(30):
        # einsum: threads of a linear-algebra library would cost more than they give here.
        normal = np.einsum("ni,n,nj->ij", design, weight, design) + 1e-12 * np.eye(design.shape[1])
        coefficients = np.linalg.solve(normal, np.einsum("ni,n,n->i", design, weight, target))
        residual = target - np.einsum("ni,i->n", design, coefficients)
        scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-12
        weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2)
    inverse = np.linalg.inv(normal)
    spread = inverse @ np.einsum("ni,n,nj->ij", design, (weight * residual) ** 2, design) @ inverse
    return coefficients, np.sqrt(np.maximum(np.diag(spread), 0.0))


def reference_track(recording: Recording) -> Track | None:
    """Return the reference, or the truth, against the odometry; None without one of them, or if they hardly move."""
    known = _reference(recording)
    if known is None:
        return None
    times, position, yaw = known
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position, axis=0).T))])
    window = min(WINDOW_M, way[-1] / WINDOWS)
    if window < 1.0:
        return None
    keep = np.flatnonzero(np.append(True, np.diff(np.floor(way / window)) > 0))
    if len(keep) < WINDOWS // 2:
        return None
    times, position, yaw = times[keep], position[keep], yaw[keep]
    step = np.diff(position, axis=0)
    course = np.arctan2(step[:, 1], step[:, 0])
    middle = np.angle(np.exp(1j * yaw[:-1]) + np.exp(1j * yaw[1:]))
    with_yaw = np.isfinite(middle)
    if np.isnan(recording.odometry[:, 0]).all():
        return Track(np.nan, np.nan, np.nan, np.nan, course[with_yaw], middle[with_yaw])
    poses = dead_reckoned(recording, times)
    own = np.diff(poses[:, :2], axis=0)
    lengths = np.hypot(*own.T).sum() / np.hypot(*step.T).sum()
    slope, error = np.array([np.nan]), np.array([np.nan])
    own_course = np.arctan2(own[:, 1], own[:, 0])
    turns, its = wrap_angle(np.diff(own_course)), wrap_angle(np.diff(course))
    if not np.isnan(recording.odometry[:, 3]).all() and len(turns) >= 8:
        much = np.abs(its) > 0.2
        if np.abs(turns).sum() > 1.0:
            slope, error = _robust(turns[:, None], its)
        elif much.sum() >= 3:
            slope, error = np.array([np.abs(its[much]).sum() / max(np.abs(turns[much]).sum(), 1e-9)]), np.zeros(1)
    first = slice(0, min(4, len(course)))
    start = np.angle(np.exp(1j * (course[first] - own_course[first])).sum())
    return Track(float(lengths), float(slope[0]), float(error[0]), float(start), course[with_yaw], middle[with_yaw])


def _reference(recording: Recording) -> tuple[Floats, Floats, Floats] | None:
    if recording.truth is not None:
        return recording.time_s, recording.truth.poses[:, :2], recording.truth.poses[:, 3]
    r = recording.reference
    if r is None:
        return None
    rows = within(recording, r) & np.isfinite(r.position_m[:, :2]).all(axis=1)
    return (r.time_s[rows], r.position_m[rows, :2], r.yaw_rad[rows]) if rows.sum() > 2 else None
