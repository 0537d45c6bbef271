"""Scores of a map of VTs: its distance from the true one, what each VT stands for, how right the associations are.

Sources: Rahmathullah, Garcia-Fernandez, Svensson, "Generalized optimal sub-pattern assignment metric", FUSION 2017,
proposition 1 (GOSPA); Manning, Raghavan and Schuetze, "Introduction to information retrieval", 2008, sections 8.3
(precision, recall) and 16.3 (each cluster counts for the class of its majority); Bar-Shalom, Li and Kirubarajan,
"Estimation with applications to tracking and navigation", 2001, section 5.4.2 (NEES).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from cellslam.benchmarks.bound import DETECTIONS_OF_A_TRUE_VT
from cellslam.sim.recording import Floats, Ints, Recording, Truth
from cellslam.slam.api import VtEstimate

CUTOFF_M = 20.0  # a pair farther apart is a truth missed and a false estimate


def gospa(distance_m: Floats) -> tuple[float, Ints]:
    """Return the GOSPA in m between n truths and k estimates at these distances d (n, k), and the pairs (m, 2) of them.

    With p = 2 and alpha = 2: the best assignment minimises the sum of d^2 over pairs nearer than the cut-off c, plus
    c^2 / 2 for each truth without an estimate and each estimate without a truth; the distance is the root.
    """
    rows, columns = linear_sum_assignment(np.minimum(distance_m, CUTOFF_M) ** 2)
    inside = distance_m[rows, columns] < CUTOFF_M
    pairs = np.column_stack([rows[inside], columns[inside]])
    unmatched = sum(distance_m.shape) - 2 * len(pairs)
    square = float((distance_m[rows[inside], columns[inside]] ** 2).sum()) + CUTOFF_M**2 / 2.0 * unmatched
    return square**0.5, pairs


def map_gospa(recording: Recording, truth: Truth, vts: VtEstimate) -> float | None:
    """Return the GOSPA in metres between final and true VTs, averaged over links; None without links.

    The truth of a link are the VTs detected at least 20 times on it. p = 2, cut-off 20 m, alpha = 2. A link
    with neither true nor estimated VTs counts 0; one with no estimated VT has the map of its site's first link that
    has any, for the links of a site may share a map. Scatterers and mirror images are no pairs, however near.
    """
    links, count = len(recording.links), len(truth.vts)
    if links == 0:
        return None
    real = truth.measurement_vt >= 0
    pair = recording.measurements.link[real] * max(count, 1) + truth.measurement_vt[real]
    detections = np.bincount(pair, minlength=links * max(count, 1)).reshape(links, -1)[:, :count]
    apart = cdist(truth.vts.position_m, vts.position_m)
    apart[truth.vts.scatters[:, None] != vts.scatters] = np.inf
    distances = [
        gospa(apart[detections[link] >= DETECTIONS_OF_A_TRUE_VT][:, mine == vts.link])[0]
        for link, mine in enumerate(_keeper(vts.link, recording.links.site, link) for link in range(links))
    ]
    return float(np.mean(distances))


def _keeper(own: Ints, site: Ints, link: int) -> int:
    """Return the link under which the map of `link` is kept; own (n,): link of each VT; site (L,)."""
    if (own == link).any():
        return link
    return int(min(own[site[own] == site[link]], default=link))


@dataclass(frozen=True)
class Tracks:
    """The VTs of an estimate, one row each (K,): id, link, what it stands for, how often it was measured.

    `row_track` (M,) is the track of each measurement of the recording, -1 where it was not associated.
    """

    link: Ints
    id: Ints
    stands_for: Ints
    count: Ints
    row_track: Ints


def tracks_of(link: Ints, association: Ints, measurement_vt: Ints) -> Tracks:
    """Return the tracks of an association (M,) of measurements.

    They are on `link` (M,) and came from `measurement_vt` (M,), -1 for clutter. An id counts per link. It
    stands for the source that most of its measurements came from: a true VT (ties: the lowest index; and
    before clutter), or nothing if that is clutter.
    """
    row_track = np.full(len(link), -1, np.int64)
    used = np.flatnonzero(association >= 0)
    if len(used) == 0:
        none = np.zeros(0, np.int64)
        return Tracks(none, none, none, none, row_track)
    ids, id_index = np.unique(association[used], return_inverse=True)
    keys, track = np.unique(link[used] * len(ids) + id_index, return_inverse=True)
    row_track[used] = track
    # Clutter gets the highest code, so that the stable order below prefers a true VT, and the lowest one, in
    # a tie.
    sources = int(measurement_vt.max()) + 2
    source = np.where(measurement_vt[used] >= 0, measurement_vt[used], sources - 1)
    pair, votes = np.unique(track * sources + source, return_counts=True)
    order = np.lexsort((-votes, pair // sources))
    winner = order[np.searchsorted((pair // sources)[order], np.arange(len(keys)))]
    stands_for = pair[winner] % sources
    stands_for = np.where(stands_for == sources - 1, -1, stands_for)
    return Tracks(keys // len(ids), ids[keys % len(ids)], stands_for, np.bincount(track), row_track)


def precision_recall(tracks: Tracks, measurement_vt: Ints) -> tuple[float | None, float | None]:
    """Return precision and recall over measurements, each None where it has no denominator.

    measurement_vt (M,): true VT of each, -1 for clutter. Right: a measurement of a true VT, associated with a track
    that stands for this VT. Precision: right ones among all that were associated. Recall: right ones among all that
    came from a true VT, those of VTs that were seen only once included. Several tracks on one link may stand for one
    true VT (it was lost and found again): what they hold is right; duplicates that remain at the end cost in GOSPA.
    """
    used = tracks.row_track >= 0
    real = measurement_vt >= 0
    right = np.zeros(len(used), np.bool_)
    right[used] = tracks.stands_for[tracks.row_track[used]] == measurement_vt[used]
    right &= real
    precision = float(right.sum() / used.sum()) if used.any() else None
    return precision, (float(right.sum() / real.sum()) if real.any() else None)


def vt_nees(recording: Recording, vts: VtEstimate, association: Ints) -> Floats:
    """Return e^T P^-1 e (V,) of the final VTs, NaN where an estimate stands for no true VT or claims to be exact.

    association (M,): id of the VT of each measurement, -1 none; ids count per site. Dimensionless; its mean is 3 where
    the covariances are right. Raises ValueError without truth.
    """
    truth, out = recording.truth, np.full(len(vts.id), np.nan)
    for row, vt in enumerate(stand_for(recording, vts, association).tolist()):
        if truth is not None and vt >= 0:
            error, claimed = vts.position_m[row] - truth.vts.position_m[vt], vts.covariance[row]
            if np.linalg.det(claimed) > 0.0:
                out[row] = error @ np.linalg.solve(claimed, error)
    return out


def stand_for(recording: Recording, vts: VtEstimate, association: Ints) -> Ints:
    """Return which true VT each final one (V,) stands for, -1: none, or a mirror image and a scatterer for each other;
    arguments and error as of `vt_nees`."""
    truth, site = recording.truth, recording.links.site
    if truth is None:
        raise ValueError("a VT's error needs the truth")
    tracks = tracks_of(site[recording.measurements.link], association, truth.measurement_vt)
    known = {(s, i): v for s, i, v in zip(tracks.link.tolist(), tracks.id.tolist(), tracks.stands_for, strict=True)}
    keys = zip(site[vts.link].tolist(), vts.id.tolist(), strict=True)
    vt = np.array([known.get(key, -1) for key in keys], np.int64)
    same = np.append(truth.vts.scatters, False)[vt] == vts.scatters
    return np.where((vt >= 0) & same, vt, -1)


def transmitter_errors(recording: Recording, vts: VtEstimate, tracks: Tracks) -> Floats:
    """Return the distances (n,) in metres between each link's estimate of its line-of-sight VT and the site.

    The estimate of a link is the track that stands for the site's true VT of order 0 and is among the final
    `vts`; of several the one with most measurements. Links without one have no entry. Raises ValueError
    without truth.
    """
    truth = recording.truth
    if truth is None:
        raise ValueError("a transmitter error needs the truth")
    errors = []
    for link in range(len(recording.links)):
        site = recording.links.site[link]
        direct = np.flatnonzero((truth.vts.order == 0) & (truth.vts.site == site))
        mine = np.flatnonzero((tracks.link == link) & np.isin(tracks.stands_for, direct))
        final = np.flatnonzero(vts.link == link)
        for k in mine[np.argsort(-tracks.count[mine], kind="stable")]:
            found = final[vts.id[final] == tracks.id[k]]
            if len(found):
                errors.append(np.linalg.norm(vts.position_m[found[0]] - truth.site_positions_m[site]))
                break
    return np.asarray(errors, np.float64)
