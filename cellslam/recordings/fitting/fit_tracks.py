"""Measurements of consecutive snapshots joined to tracks by the odometry's prediction: the raw material of `fit_noise`.

An epoch of a link is a snapshot in which it has measurements: beacons that are polled in turn have one in several.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from cellslam.recordings.inspection.corrections import PLANE, dead_reckoned, displacement, moved_on
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording

ROWS = 250_000  # of a long recording the first so many measurements
MISSES = 3  # a track may pause for so many epochs of its link
GATE = 4.0  # standard deviations of a prediction's error, in each quantity
INITIAL_STD = (2.0, np.radians(5.0), np.radians(5.0))
QUANTITIES = ("distance_m", "azimuth_rad", "elevation_rad")
LONG_GAPS = 0.1  # share of the gaps between epochs of a link that are pauses, as behind an obstacle, or may be


@dataclass(frozen=True)
class Steps:
    """Pairs of rows (n,) of one track, `lag` epochs apart, and how far the later one is from its prediction (n, 3)."""

    first: Ints
    second: Ints
    lag: Ints
    innovation: Floats


@dataclass(frozen=True)
class Tracks:
    """`track` (M,) of each row used, -1 for none of three detections; `steps` between detections; poses (T, 6)."""

    track: Ints
    steps: Steps
    poses: Floats


def robust_std(values: Floats) -> float:
    """Return the standard deviation of values (n,), NaN among them, by the median of their deviations; NaN for none."""
    known = values[np.isfinite(values)]
    return 1.4826 * float(np.median(np.abs(known - np.median(known)))) if len(known) else float("nan")


def tracks_of(recording: Recording) -> Tracks:
    """Return the tracks of a recording; the gates are twice taken from the innovations."""
    r = recording
    poses = dead_reckoned(r, r.time_s)
    rows = min(len(r.measurements), ROWS)
    scale = np.array(INITIAL_STD)
    steps = _joined(r, poses, rows, scale)
    for _ in range(2):
        for i, initial in enumerate(INITIAL_STD):
            known = np.isfinite(steps.innovation[:, i]).sum()
            scale[i] = initial if known < 30 else max(robust_std(steps.innovation[:, i]), 1e-4 * initial)
        steps = _joined(r, poses, rows, scale)
    return Tracks(_labels(steps, rows), steps, poses)


def innovations(recording: Recording, poses: Floats, first: Ints, second: Ints) -> Floats:
    """Return rows `second` less what rows `first` lead one to expect in their snapshots if sources stay (n, 3)."""
    m = recording.measurements
    z = np.column_stack([getattr(m, name)[second] for name in QUANTITIES])
    out: Floats = z - _predicted(recording, poses, first, m.snapshot[second])
    out[:, 1] = wrap_angle(out[:, 1])
    return out


def _predicted(recording: Recording, poses: Floats, first: Ints, later: Ints) -> Floats:
    """Return the measurements (n, 3) that rows `first` lead one to expect in snapshots `later`, if sources stay."""
    m = recording.measurements
    if np.isnan(m.azimuth_rad).all():
        return np.column_stack([m.distance_m[first], np.full(len(first), np.nan), m.elevation_rad[first]])
    offset = recording.sites.clock_offset_mean_m[recording.links.site[m.link[first]]]
    range_m = np.maximum(np.nan_to_num(m.distance_m[first] - offset, nan=1e6), 5.0)
    moved = displacement(poses[m.snapshot[first]][:, PLANE], poses[later][:, PLANE])
    change, azimuth = moved_on(range_m, m.azimuth_rad[first], np.nan_to_num(m.elevation_rad[first]), moved)
    return np.column_stack([m.distance_m[first] + change, azimuth, m.elevation_rad[first]])


def _joined(r: Recording, poses: Floats, rows: int, scale: Floats) -> Steps:
    """Return the steps: of all pairs within the gate the best first, each row with one successor and one
    predecessor.
    """
    m = r.measurements
    links = max(len(r.links), 1)
    key = _epochs(m.snapshot[:rows], m.link[:rows]) * links + m.link[:rows]
    order = np.argsort(key, kind="stable")
    has_next, has_last = np.zeros(rows, bool), np.zeros(rows, bool)
    parts = []
    for lag in range(1, MISSES + 2):
        first, second = _candidates(key[order], key, np.flatnonzero(~has_next), lag * links)
        second = order[second]
        free = ~has_last[second]
        first, second = first[free], second[free]
        innovation = innovations(r, poses, first, second)
        cost = np.nansum((innovation / (scale * np.sqrt(lag))) ** 2, axis=1)
        near = np.flatnonzero(cost < GATE**2)
        near = near[np.argsort(cost[near], kind="stable")]
        # Mutual best: the first row of each in order of cost.
        kept = near[~(pd.Series(first[near]).duplicated() | pd.Series(second[near]).duplicated())]
        has_next[first[kept]], has_last[second[kept]] = True, True
        parts.append((first[kept], second[kept], np.full(len(kept), lag), innovation[kept]))
    return Steps(*(np.concatenate([part[i] for part in parts]) for i in range(4)))


def polled_share(recording: Recording) -> float:
    """Return the share of snapshots in which a link is observed at all: 1 where all are observed at once, 1 / L where L
    links are polled in turn. Of a snapshot in which it has no measurement nobody knows whether it was polled.

    Median over links of one over the mean number of snapshots from epoch to epoch, the longest gaps left out.
    """
    m, shares = recording.measurements, []
    for one in np.unique(m.link):
        gaps = np.sort(np.diff(np.unique(m.snapshot[m.link == one])))
        if len(gaps):
            shares.append(1.0 / gaps[: max(int((1.0 - LONG_GAPS) * len(gaps)), 1)].mean())
    return float(np.median(shares)) if shares else 1.0


def _epochs(snapshot: Ints, link: Ints) -> Ints:
    """Return the number of each row's snapshot (M,) among those in which its link has measurements."""
    return pd.Series(snapshot).groupby(link).rank("dense").to_numpy(np.int64)


def _candidates(ordered: Ints, key: Ints, rows: Ints, shift: int) -> tuple[Ints, Ints]:
    """Return all pairs of a row and a place in the ordered keys whose key is `shift` higher."""
    begin, end = np.searchsorted(ordered, key[rows] + shift), np.searchsorted(ordered, key[rows] + shift, side="right")
    count = end - begin
    first = np.repeat(rows, count)
    second = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
    return first, second


def _labels(steps: Steps, rows: int) -> Ints:
    """Return the track of each row, -1 where it has fewer than three detections."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(steps.first)), (steps.first, steps.second)), shape=(rows, rows))
    label = connected_components(graph, directed=False)[1].astype(np.int64)
    return np.where(np.bincount(label)[label] >= 3, label, -1)
