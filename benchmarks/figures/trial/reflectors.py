"""From estimated VTs back to the walls: where each path was reflected, if it was reflected once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellslam.benchmarks.scores.map_scores import Tracks, tracks_of
from cellslam.benchmarks.scores.metrics import duration_s
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.model.walls import reflection_point

# A VT this near to its site is the site itself, seen in line of sight.
LINE_OF_SIGHT_M = 15.0
FEWEST_MEASUREMENTS = 40
SNAPSHOTS_PER_POINT = 40


@dataclass(frozen=True)
class Reflector:
    """Where the paths of one estimated VT were reflected, over the time in which it was measured.

    `points_m` (n, 3) on the wall, seen from the estimated `vehicle_m` (n, 3); `site_m` (3,) as estimated;
    `life_s`: for how long it was measured, gaps left out.
    """

    link: int
    site: int
    site_m: Floats
    points_m: Floats
    vehicle_m: Floats
    life_s: float


def site_estimates(recording: Recording, result: TrialResult, tracks: Tracks) -> dict[int, Floats]:
    """Return each site's position (3,) in m: mean of the estimated VTs that stand for it, else the truth."""
    truth, vts, found = recording.truth, result.vts, {}
    if truth is None or vts is None:
        return {}
    for site in range(len(recording.sites)):
        direct = np.flatnonzero((truth.vts.order == 0) & (truth.vts.site == site))
        mine = np.isin(tracks.stands_for, direct) & (tracks.count >= FEWEST_MEASUREMENTS)
        pairs = set(zip(tracks.link[mine], tracks.id[mine], strict=True))
        rows = [k for k in range(len(vts.id)) if (vts.link[k], vts.id[k]) in pairs]
        found[site] = vts.position_m[rows].mean(axis=0) if rows else truth.site_positions_m[site]
    return found


def reflectors_of(recording: Recording, result: TrialResult) -> list[Reflector]:
    """Return the reflectors of a result's final VTs, longest-lived first.

    Empty without truth, VTs or associations.

    Truth serves only to tell which VTs are sites. Vehicle positions are the estimated ones.
    """
    if recording.truth is None or result.vts is None or result.association is None:
        return []
    m, vts = recording.measurements, result.vts
    tracks = tracks_of(m.link, result.association, recording.truth.measurement_vt)
    sites = site_estimates(recording, result, tracks)
    interval_s = duration_s(recording) / len(recording.time_s)
    found = []
    for k in range(len(vts.id)):
        track = np.flatnonzero((tracks.link == vts.link[k]) & (tracks.id == vts.id[k]))
        site = int(recording.links.site[vts.link[k]])
        near = np.linalg.norm(vts.position_m[k] - sites[site]) < LINE_OF_SIGHT_M
        if len(track) == 0 or near or tracks.count[track[0]] < FEWEST_MEASUREMENTS:
            continue
        seen = m.snapshot[np.flatnonzero(tracks.row_track == track[0])]
        vehicle = result.poses[_spread(seen), :3]
        points = reflection_point(sites[site], vts.position_m[k], vehicle)
        there = np.isfinite(points).all(axis=1)
        life_s = len(np.unique(seen)) * interval_s
        if there.any():
            link = int(vts.link[k])
            found.append(Reflector(link, site, sites[site], points[there], vehicle[there], life_s))
    return sorted(found, key=lambda r: -r.life_s)


def _spread(snapshots: Ints) -> Ints:
    """Return some of the snapshots: the first in each stretch of `SNAPSHOTS_PER_POINT`."""
    _, first = np.unique(snapshots // SNAPSHOTS_PER_POINT, return_index=True)
    return np.asarray(snapshots[first])
