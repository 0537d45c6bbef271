"""Noise, detection and clutter as a recording itself shows them, without truth.

White noise: the spread of second differences of innovations along tracks, n(t+2) - 2 n(t+1) + n(t), whose variance is
six times
that of one measurement, however smoothly everything else changes. Odometry: what the innovations of a snapshot have
in common,
over growing intervals: the variance of a sum of K errors is white K q + (K b)^2, measurements add a constant.
Detection: the share of
snapshots within the life of a track that have it. Clutter: rows in no track, per link and snapshot and volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.benchmarks.recordings.fit_tracks import QUANTITIES, Tracks, predicted, tracks_of
from cellslam.sim.errors import InputError
from cellslam.sim.frames import wrap_angle
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import COMPONENTS, Floats, Ints, Recording

LEAST_TRIPLES, LEAST_TRACKS, BINS = 100, 5, 8
LAGS = (1, 2, 4, 8, 16)
PLANE_ELEVATION_DEG = 0.5  # what estimators are told of the zero elevations of one plane
NAMES = {"distance_m": "m", "azimuth_rad": "azimuth_deg", "elevation_rad": "elevation_deg"}


@dataclass(frozen=True)
class Fitted:
    """What was found; deviations in m and deg, by the suffix of the options' names.

    `floor`, `unit` (at 0 dB), `slow` (beyond the white part, over about ten snapshots); `claimed`: spread over the
    deviations that the
    front end claims; `odometry`: noise density and bias by component.
    """

    tracks: int
    rows: int
    floor: dict[str, float]
    unit: dict[str, float]
    slow: dict[str, float]
    claimed: dict[str, float]
    detection_probability: float
    clutter_density: float
    visible_s: float
    longest_list: int
    odometry: dict[str, tuple[float, float]]


def fit(recording: Recording, progress: Progress = silent) -> Fitted:
    """Return what a recording shows of its noise. Raises InputError where it has too little to tell."""
    if np.isnan(recording.measurements.distance_m).all() and np.isnan(recording.measurements.azimuth_rad).all():
        raise InputError("fit-noise needs distances or azimuths, and the recording has neither")
    with progress("joining measurements to tracks", 1) as advance:
        tracks = tracks_of(recording)
        advance(1)
    count = len(np.unique(tracks.track[tracks.track >= 0]))
    if count < LEAST_TRACKS:
        raise InputError(
            f"fit-noise found {count} tracks of three detections, and needs {LEAST_TRACKS}: is the odometry right?"
        )
    floor, unit, claimed = _white(recording, tracks)
    detection, visible_s = _detection(recording, tracks)
    per_link = np.unique(
        np.column_stack([recording.measurements.link[: tracks.rows], tracks.track])[tracks.track >= 0], axis=0
    )
    return Fitted(
        tracks=count,
        rows=tracks.rows,
        floor=floor,
        unit=unit,
        slow=_slow(recording, tracks, floor),
        claimed=claimed,
        detection_probability=detection,
        clutter_density=_clutter(recording, tracks),
        visible_s=visible_s,
        longest_list=int(np.bincount(per_link[:, 0]).max()),
        odometry=_odometry(recording, tracks),
    )


def _in_unit(name: str, value: float) -> float:
    return value if name == "distance_m" else float(np.degrees(value))


def _triples(tracks: Tracks) -> tuple[Ints, Floats]:
    """Return pairs of steps of one snapshot each that follow one another: their middle rows and second differences
    (n, 3).
    """
    steps = tracks.steps
    single = np.flatnonzero((steps.lag == 1) & (tracks.track[steps.first] >= 0))
    at = np.full(tracks.rows, -1, np.int64)
    at[steps.first[single]] = single
    following = at[steps.second[single]]
    pairs = following >= 0
    one, two = single[pairs], following[pairs]
    difference = steps.innovation[two] - steps.innovation[one]
    difference[:, 1] = wrap_angle(difference[:, 1])
    return steps.second[one], difference


def _white(r: Recording, tracks: Tracks) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    middle, difference = _triples(tracks)
    floor, unit, claimed = {}, {}, {}
    for i, name in enumerate(QUANTITIES):
        known = ~np.isnan(difference[:, i])
        if known.sum() < LEAST_TRIPLES:
            continue
        values = difference[known, i]
        snr_db = r.measurements.snr_db[middle[known]]
        low, at_0_db = _against_snr(values, snr_db)
        floor[NAMES[name]], unit[NAMES[name]] = _in_unit(name, low), _in_unit(name, at_0_db)
        column = getattr(r.measurements, name.replace("_m", "_std_m").replace("_rad", "_std_rad"))
        if column is not None:
            claimed[NAMES[name]] = _deviation(values / column[middle[known]])
    return floor, unit, claimed


def _deviation(second_differences: Floats) -> float:
    known = second_differences[np.isfinite(second_differences)]
    return 1.4826 * float(np.median(np.abs(known - np.median(known)))) / np.sqrt(6.0) if len(known) else float("nan")


def _against_snr(values: Floats, snr_db: Floats) -> tuple[float, float]:
    """Return floor and deviation at 0 dB of variance = floor^2 + unit^2 / SNR, fitted to bins of equal count."""
    from scipy.optimize import nnls

    known = ~np.isnan(snr_db)
    if known.sum() < LEAST_TRIPLES or np.ptp(snr_db[known]) < 3.0:
        return _deviation(values), 0.0
    order = np.argsort(snr_db[known])
    parts = np.array_split(order, BINS)
    variance = np.array([_deviation(values[known][part]) ** 2 for part in parts])
    inverse = np.array([np.median(10.0 ** (-snr_db[known][part] / 10.0)) for part in parts])
    design = np.column_stack([np.ones(BINS), inverse]) / variance[:, None]
    solution, _ = nnls(design, np.ones(BINS))
    return float(np.sqrt(solution[0])), float(np.sqrt(solution[1]))


def _slow(r: Recording, tracks: Tracks, floor: dict[str, float]) -> dict[str, float]:
    """Return the deviation, beyond the white one, with which a track departs from its prediction over 16 snapshots,
    what is
    common to all paths of a snapshot removed."""
    out: dict[str, float] = {}
    first, second = _apart(r, tracks, LAGS[-1])
    if len(first) < LEAST_TRIPLES:
        return dict.fromkeys(floor, 0.0)
    z = np.column_stack([getattr(r.measurements, name)[second] for name in QUANTITIES])
    e = z - predicted(r, tracks.poses, first, r.measurements.snapshot[second])
    e[:, 1] = wrap_angle(e[:, 1])
    common, design = _common(r, first, e)
    for i, name in enumerate(QUANTITIES):
        key = NAMES[name]
        if key not in floor:
            continue
        rest = e[:, i] - (common[:, 0] * design if i == 0 else common[:, 1] if i == 1 else 0.0)
        rest = rest[np.isfinite(rest)]
        # The median deviation of the difference of two errors; what is white has that of the second differences.
        spread = 1.4826 * float(np.median(np.abs(rest - np.median(rest)))) / np.sqrt(2.0) if len(rest) else 0.0
        white = _in_unit(name, _all_white(tracks, i))
        out[key] = float(np.sqrt(max(_in_unit(name, spread) ** 2 - white**2, 0.0)))
    return out


def _all_white(tracks: Tracks, column: int) -> float:
    return _deviation(_triples(tracks)[1][:, column])


def _apart(r: Recording, tracks: Tracks, lag: int) -> tuple[Ints, Ints]:
    """Return rows of one track, `lag` snapshots apart, whether or not it was detected in between."""
    rows = np.flatnonzero(tracks.track >= 0)
    snapshots = len(r.time_s) + lag
    code = tracks.track[rows] * snapshots + r.measurements.snapshot[rows]
    order = np.argsort(code)
    at = np.minimum(np.searchsorted(code[order], code + lag), len(code) - 1)
    found = code[order][at] == code + lag
    return rows[found], rows[order[at[found]]]


def _common(r: Recording, first: Ints, e: Floats) -> tuple[Floats, Floats]:
    """Return for each row what its snapshot's innovations have in common: forward error (m) and turn (rad), (n, 2);
    and what a
    metre forward does to its distance (n,).

    Least squares over the snapshot, where it has three paths or more.
    """
    m = r.measurements
    azimuth = np.nan_to_num(m.azimuth_rad[first])
    design = -np.cos(azimuth) * np.cos(np.nan_to_num(m.elevation_rad[first]))
    snapshot = m.snapshot[first]
    order = np.argsort(snapshot, kind="stable")
    begin = np.flatnonzero(np.append(True, np.diff(snapshot[order]) != 0))
    size = np.diff(np.append(begin, len(order)))
    forward = _weighted(design[order] * e[order, 0], design[order] ** 2, begin)
    turn = _weighted(e[order, 1], np.isfinite(e[order, 1]).astype(float), begin)
    out = np.full((len(first), 2), np.nan)
    out[order] = np.column_stack([np.repeat(forward, size), np.repeat(turn, size)])
    out[np.repeat(size, size)[np.argsort(order)] < 3] = np.nan
    return out, design


def _weighted(numerator: Floats, weight: Floats, begin: Ints) -> Floats:
    known = np.isfinite(numerator) & np.isfinite(weight)
    top = np.add.reduceat(np.where(known, numerator, 0.0), begin)
    bottom = np.add.reduceat(np.where(known, weight, 0.0), begin)
    return np.where(bottom > 0.5, top / np.maximum(bottom, 1e-9), np.nan)


def _odometry(r: Recording, tracks: Tracks) -> dict[str, tuple[float, float]]:
    """Return noise density and bias of speed and yaw rate."""
    from scipy.optimize import nnls

    step = float(np.median(np.diff(r.time_s)))
    spreads: dict[str, list[tuple[float, float, float]]] = {"u_x": [], "u_psi": []}
    for lag in LAGS:
        first, second = _apart(r, tracks, lag)
        if len(first) < LEAST_TRIPLES:
            continue
        z = np.column_stack([getattr(r.measurements, name)[second] for name in QUANTITIES])
        e = z - predicted(r, tracks.poses, first, r.measurements.snapshot[second])
        e[:, 1] = wrap_angle(e[:, 1])
        common, _ = _common(r, first, e)
        _, one = np.unique(r.measurements.snapshot[first], return_index=True)
        for name, column in (("u_x", 0), ("u_psi", 1)):
            values = common[one, column]
            values = values[np.isfinite(values)]
            if len(values) >= 30:
                middle = float(np.median(values))
                spreads[name].append((lag * step, (1.4826 * float(np.median(np.abs(values - middle)))) ** 2, middle))
    out = {}
    for name, rows in spreads.items():
        if len(rows) < 3 or np.isnan(r.odometry[:, COMPONENTS.index(name)]).all():
            continue
        t, variance, middle = np.array(rows).T
        design = np.column_stack([np.ones(len(t)), t]) / variance[:, None]
        (_, density), _ = nnls(design, np.ones(len(t)))
        out[name] = (float(np.sqrt(density)), abs(float(middle[-1] / t[-1])))
    return out


def _detection(r: Recording, tracks: Tracks) -> tuple[float, float]:
    """Return the share of snapshots between a track's first and last detection that have it, and its mean life in s."""
    rows = np.flatnonzero(tracks.track >= 0)
    _, label = np.unique(tracks.track[rows], return_inverse=True)
    snapshot = r.measurements.snapshot[rows]
    count = np.bincount(label)
    first, last = np.full(len(count), np.iinfo(np.int64).max), np.zeros(len(count), np.int64)
    np.minimum.at(first, label, snapshot)
    np.maximum.at(last, label, snapshot)
    inner = last - first - 1
    share = (count - 2).sum() / max(inner.sum(), 1)
    life = r.time_s[last] - r.time_s[first]
    return float(np.clip(share, 0.01, 0.99)), float(max(np.average(life, weights=count), 1e-3))


def _clutter(r: Recording, tracks: Tracks) -> float:
    """Return rows without a track per link and snapshot and m rad rad (over the middle 90 % of their distances)."""
    m = r.measurements
    loose = np.flatnonzero(tracks.track < 0)
    seen = len(np.unique((m.snapshot * max(len(r.links), 1) + m.link)[: tracks.rows]))
    volume = 2.0 * np.pi
    distance = m.distance_m[loose]
    distance = distance[~np.isnan(distance)]
    volume *= max(float(np.diff(np.quantile(distance, (0.05, 0.95)))[0]), 1.0) if len(distance) > 20 else 1000.0
    elevation = m.elevation_rad[loose]
    elevation = elevation[~np.isnan(elevation)]
    if r.plane:
        volume *= np.sqrt(2.0 * np.pi) * np.radians(PLANE_ELEVATION_DEG)
    else:
        volume *= (
            max(float(np.diff(np.quantile(elevation, (0.05, 0.95)))[0]), 0.01) if len(elevation) > 20 else np.pi / 2
        )
    return float(np.clip(max(len(loose), 1) / max(seen, 1) / volume, 1e-9, 1e3))
