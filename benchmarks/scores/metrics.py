"""The scores of one trial, from a recording with truth, an estimator's result and the bound.

Position errors are horizontal, absolute and not aligned. Source: paper, section V.
"""

from __future__ import annotations

import numpy as np

from cellslam.benchmarks.bound.cramer_rao import BoundResult
from cellslam.benchmarks.scores.association import precision_recall, tracks_of, transmitter_errors
from cellslam.benchmarks.scores.gospa import gospa
from cellslam.benchmarks.scores.reference_fixes import usable, within
from cellslam.benchmarks.scores.trial_result import METRIC_KEYS, TrialResult
from cellslam.benchmarks.scores.walls import wall_scores
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording, Reference, Truth
from cellslam.slam.api import VtEstimate

GOSPA_CUTOFF_M = 20.0
GOSPA_ORDER = 2.0
DETECTIONS_OF_A_TRUE_VT = 20
SMALLEST_VARIANCE_M2 = 1e-12
SHORTEST_STEP_M = 1.0  # of a reference's path: below it lies the noise of fixes at rest


def score(recording: Recording, result: TrialResult, bound: BoundResult | None) -> dict[str, float | None]:
    """Return the metrics of a result by key (`METRIC_KEYS`).

    None where one does not apply: no truth, or the estimator does not estimate it.
    """
    scores: dict[str, float | None] = dict.fromkeys(METRIC_KEYS)
    if bound is not None:
        scores["bound_position_rmse_m"], scores["bound_merged_m"] = bound.position_rmse_m, bound.merged_m
    truth = recording.truth
    if truth is None:
        return scores | (reference_scores(recording, recording.reference, result) if recording.reference else {})
    error = horizontal_error(truth.poses, result.poses)
    scores["position_rmse_m"] = _rms(error)
    scores["position_max_m"] = float(error.max())
    scores["position_end_m"] = float(error[-1])
    scores["heading_rmse_rad"] = _rms(wrap_angle(result.poses[:, 3] - truth.poses[:, 3]))
    if not result.smoothed:  # the covariances are those of the snapshots
        squared = nees(truth.poses, result.poses, result.covariances)
        scores["nees_mean"] = float(np.nanmean(squared)) if np.isfinite(squared).any() else None
    if result.clock_offset_m is not None and len(recording.sites):
        scores["clock_offset_rmse_m"] = _rms(
            result.clock_offset_m[-1] - truth.clock_offsets_at(recording.elapsed_s)[-1]
        )
    if result.vts is not None:
        scores["map_gospa_m"] = map_gospa(recording, truth, result.vts)
    if result.walls is not None:
        scores |= wall_scores(recording, truth, result.walls)
    if result.association is not None:
        tracks = tracks_of(recording.measurements.link, result.association, truth.measurement_vt)
        precision, recall = precision_recall(tracks, truth.measurement_vt)
        scores["association_precision"], scores["association_recall"] = precision, recall
        if result.vts is not None:
            errors = transmitter_errors(recording, result.vts, tracks)
            scores["transmitter_rmse_m"] = _rms(errors) if len(errors) else None
    return scores


def reference_scores(recording: Recording, reference: Reference, result: TrialResult) -> dict[str, float | None]:
    """Return the scores against a reference: the estimate interpolated at its times, where they lie within the drive.

    Positions far off their neighbours are left out (`reference_fixes.outlying`). The NEES adds the reference's variance
    to the claimed one, and is None where the reference does not state its own.
    """
    scores: dict[str, float | None] = {}
    times, rows = recording.time_s, within(recording, reference)
    if not rows.any():
        return scores
    at = reference.time_s[rows]
    turns = np.unwrap(result.poses[:, 3:], axis=0)
    poses = np.column_stack([np.interp(at, times, column) for column in (*result.poses[:, :3].T, *turns.T)])
    known = np.column_stack([reference.position_m[rows], reference.yaw_rad[rows]])
    there = usable(recording, reference)[rows]
    if there.any():
        error = horizontal_error(known[there], poses[there])
        scores["position_rmse_m"], scores["position_max_m"] = _rms(error), float(error.max())
        scores["position_end_m"] = float(error[-1])
        std = reference.position_std_m[rows]
        nearest = np.clip(np.searchsorted(times, at), 0, len(times) - 1)
        claimed = result.covariances[nearest] + (std**2)[:, None, None] * np.eye(6)
        squared = nees(known[there & ~np.isnan(std)], poses[there & ~np.isnan(std)], claimed[there & ~np.isnan(std)])
        scores["nees_mean"] = float(np.nanmean(squared)) if np.isfinite(squared).any() else None
    turned = np.isfinite(known[:, 3])
    if turned.any():
        scores["heading_rmse_rad"] = _rms(wrap_angle(poses[turned, 3] - known[turned, 3]))
    return scores


def errors_over_time(recording: Recording, poses: Floats) -> tuple[Floats, Floats] | None:
    """Return times (N,) in s and horizontal errors (N,) in m of poses (T, 6); None without truth and reference.

    Against the truth at every snapshot, against a reference at its fixes (`reference_fixes.usable`).
    """
    if recording.truth is not None:
        return recording.time_s, horizontal_error(recording.truth.poses, poses)
    reference = recording.reference
    if reference is None:
        return None
    rows = usable(recording, reference)
    at = reference.time_s[rows]
    there = np.column_stack([np.interp(at, recording.time_s, poses[:, i]) for i in range(2)])
    return (at, horizontal_error(reference.position_m[rows], there)) if rows.any() else None


def horizontal_error(truth_poses: Floats, poses: Floats) -> Floats:
    """Return the horizontal distance (T,) in metres between two trajectories (T, 6) in the same frame."""
    return np.hypot(poses[:, 0] - truth_poses[:, 0], poses[:, 1] - truth_poses[:, 1])


def nees(truth_poses: Floats, poses: Floats, covariances: Floats) -> Floats:
    """Return the normalised estimation error squared e^T P^-1 e (T,) of the horizontal position, dimensionless.

    Its mean is 2 for a consistent estimator. NaN where the claimed covariance (T, 6, 6) has no inverse, as at a start
    that is known exactly. Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
    navigation", 2001, section 5.4.2.
    """
    e = poses[:, :2] - truth_poses[:, :2]
    xx, xy, yy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    determinant = xx * yy - xy * xy
    # The smaller eigenvalue is at least determinant / trace.
    regular = determinant > SMALLEST_VARIANCE_M2 * np.abs(xx + yy)
    quadratic = yy * e[:, 0] ** 2 - 2.0 * xy * e[:, 0] * e[:, 1] + xx * e[:, 1] ** 2
    return np.where(regular, quadratic / np.where(regular, determinant, 1.0), np.nan)


def map_gospa(recording: Recording, truth: Truth, vts: VtEstimate) -> float | None:
    """Return the GOSPA in metres between final and true VTs, averaged over links; None without links.

    The truth of a link are the VTs detected at least 20 times on it. p = 2, cut-off 20 m, alpha = 2. A link
    with neither true nor estimated VTs counts 0; one with no estimated VT has the map of its site's first link that
    has any, for the links of a site may share a map.
    """
    links, count = len(recording.links), len(truth.vts)
    if links == 0:
        return None
    real = truth.measurement_vt >= 0
    pair = recording.measurements.link[real] * max(count, 1) + truth.measurement_vt[real]
    detections = np.bincount(pair, minlength=links * max(count, 1)).reshape(links, -1)[:, :count]
    distances = [
        gospa(
            truth.vts.position_m[detections[link] >= DETECTIONS_OF_A_TRUE_VT],
            vts.position_m[vts.link == _keeper(vts.link, recording.links.site, link)],
            GOSPA_CUTOFF_M,
            GOSPA_ORDER,
        ).distance_m
        for link in range(links)
    ]
    return float(np.mean(distances))


def _keeper(own: Ints, site: Ints, link: int) -> int:
    """Return the link under which the map of `link` is kept; own (n,): link of each VT; site (L,)."""
    if (own == link).any():
        return link
    return int(min(own[site[own] == site[link]], default=link))


def duration_s(recording: Recording) -> float:
    """Return how long a recording lasts, in seconds: each snapshot stands for one (mean) interval."""
    count = len(recording.time_s)
    return float((recording.time_s[-1] - recording.time_s[0]) * count / (count - 1)) if count > 1 else 0.0


def distance_m(recording: Recording) -> float | None:
    """Return the true horizontal length of the drive in metres, or its reference's; None without both."""
    if recording.truth is not None:
        return float(np.linalg.norm(np.diff(recording.truth.poses[:, :2], axis=0), axis=1).sum())
    if recording.reference is None:
        return None
    return _length(recording.reference.position_m[usable(recording, recording.reference), :2])


def _length(points: Floats) -> float | None:
    """Return the length in metres of a noisy path (N, 2): steps of less than a metre are not counted one by one."""
    if not len(points):
        return None
    length, last = 0.0, points[0]
    for point in points[1:]:
        step = float(np.hypot(*(point - last)))
        if step >= SHORTEST_STEP_M:
            length, last = length + step, point
    return length


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
