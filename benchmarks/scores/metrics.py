"""Metrics: what is scored of one trial, from a recording with truth, an estimator's result and the bound.

A metric is a line of `METRICS`, and a line is all that a new one needs: rows, stores, the reference page and
`table --metric` follow from it, the tables that it names, and, where it has an axis, figures and curves of reports.
Position errors are horizontal, absolute and not aligned. Source: paper, section V.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.bound import DETECTIONS_OF_A_TRUE_VT
from cellslam.benchmarks.scores import belief, map_scores
from cellslam.benchmarks.scores.belief import AS_CLAIMED, Claim
from cellslam.benchmarks.scores.map_scores import Tracks
from cellslam.benchmarks.scores.reference_fixes import at_fixes, compared, covariances_at_fixes, unled, usable, within
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.scores.walls import wall_scores
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording, Reference

if TYPE_CHECKING:
    from cellslam.benchmarks.bound.cramer_rao import BoundResult

# Rows have the protection level of one risk, and of one alert limit; `cellslam integrity` has those of any.
RISK, ALERT_LIMIT_M = 1e-3, 3.0
SHORTEST_STEP_M = 1.0  # of a reference's path: below it lies the noise of fixes at rest


@dataclass(frozen=True)
class Errors:
    """Errors of a trial against its truth at every snapshot, or against a reference at its fixes, and what was claimed.

    `horizontal` (N, 2): estimate less truth in m, `covariance` (N, 2, 2): the claim, with the reference's variance, NaN
    where there is none; `yaw` (N,): the estimated one. `heading` (K,) in rad, and its claimed variance (K,).
    """

    horizontal: Floats
    covariance: Floats
    yaw: Floats
    heading: Floats
    heading_variance: Floats

    @cached_property
    def position(self) -> Floats:
        """Sizes (N,) of the horizontal errors in m."""
        return np.asarray(np.hypot(self.horizontal[:, 0], self.horizontal[:, 1]))

    @cached_property
    def squared(self) -> Floats:
        """The NEES (N,), NaN where nothing is claimed, or that there is no error."""
        return belief.squared_error(self.horizontal, self.covariance)

    @property
    def heading_ratio(self) -> Floats:
        """Sizes (K,) of the errors of the heading over their claimed deviations; NaN where none is claimed."""
        return belief.ratio(self.heading, self.heading_variance)

    @cached_property
    def claimed(self) -> tuple[Floats, Floats]:
        """The horizontal errors (n, 2), and covariances (n, 2, 2), where there is a claim."""
        there = np.isfinite(self.squared)
        return self.horizontal[there], self.covariance[there]

    def protection(
        self, direction: str = "horizontal", claim: Claim = AS_CLAIMED, risk: float = RISK
    ) -> tuple[Floats, Floats]:
        """Return sizes of the errors (n,) and protection levels (n,) in m, where there is a claim, which `claim` reads:
        horizontal, or along or across the estimated heading."""
        error, covariance = self.claimed
        if direction == "horizontal":
            return np.hypot(error[:, 0], error[:, 1]), claim.radius(covariance, risk)
        yaw = self.yaw[np.isfinite(self.squared)] + (np.pi / 2.0 if direction == "across" else 0.0)
        n = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        variance = np.einsum("ti,tij,tj->t", n, covariance, n)
        return np.abs((n * error).sum(axis=1)), claim.half_width(variance, risk)


NO_ERRORS = Errors(np.zeros((0, 2)), np.zeros((0, 2, 2)), *np.zeros((3, 0)))


@dataclass(frozen=True)
class Scored:
    """What metrics are computed from; what several of them need is computed once, and None where it does not apply."""

    recording: Recording
    result: TrialResult
    bound: BoundResult | None

    @cached_property
    def errors(self) -> Errors:
        """Errors of pose, against truth or reference; empty without both."""
        return errors_of(self.recording, self.result)

    @cached_property
    def tracks(self) -> Tracks | None:
        """Which estimated VT is of which true one."""
        truth, association = self.recording.truth, self.result.association
        if truth is None or association is None:
            return None
        return map_scores.tracks_of(self.recording.measurements.link, association, truth.measurement_vt)

    @cached_property
    def mapped(self) -> tuple[Floats, Floats, Ints]:
        """Errors of the final VTs and bounds of what they stand for (n,), in m, and in how many snapshots that was seen
        (n,); none without a bound of the map."""
        truth, vts, association = self.recording.truth, self.result.vts, self.result.association
        if truth is None or vts is None or association is None or self.bound is None or self.bound.map is None:
            return np.zeros(0), np.zeros(0), np.zeros(0, np.int64)
        of = map_scores.stand_for(self.recording, vts, association)
        known = np.flatnonzero(of >= 0)
        known = known[np.isfinite(self.bound.map.std_m[of[known]])]
        error = np.linalg.norm(vts.position_m[known] - truth.vts.position_m[of[known]], axis=1)
        return error, self.bound.map.std_m[of[known]], self.bound.map.times_seen[of[known]]

    @cached_property
    def settled(self) -> tuple[Floats, Floats]:
        """Errors and bounds (n,) in m of the final VTs that were seen in twenty snapshots or more."""
        error, bound, times_seen = self.mapped
        often = times_seen >= DETECTIONS_OF_A_TRUE_VT
        return error[often], bound[often]

    @cached_property
    def walls(self) -> dict[str, float | None]:
        """Scores of the walls by key."""
        truth, walls = self.recording.truth, self.result.walls
        return {} if truth is None or walls is None else wall_scores(self.recording, truth, walls)

    @property
    def clock_offset_m(self) -> Floats | None:
        """Errors (S,) of the clock offsets at the end."""
        truth, offset = self.recording.truth, self.result.clock_offset_m
        if truth is None or offset is None or not len(self.recording.sites):
            return None
        return np.asarray(offset[-1] - truth.clock_offsets_at(self.recording.elapsed_s)[-1])

    @cached_property
    def clock_ratios(self) -> Floats:
        """Errors of the clock offsets at all snapshots over their claimed deviations (n,), NaN of known clocks."""
        truth, offset, variance = self.recording.truth, self.result.clock_offset_m, self.result.clock_offset_variance_m2
        if truth is None or offset is None or variance is None:
            return np.zeros(0)
        return belief.ratio((offset - truth.clock_offsets_at(self.recording.elapsed_s)).ravel(), variance.ravel())

    @property
    def transmitter_m(self) -> Floats | None:
        """Errors of the sites' positions."""
        if self.tracks is None or self.result.vts is None:
            return None
        return map_scores.transmitter_errors(self.recording, self.result.vts, self.tracks)

    @property
    def map_gospa_m(self) -> float | None:
        """GOSPA of the map of VTs."""
        truth, vts = self.recording.truth, self.result.vts
        return None if truth is None or vts is None else map_scores.map_gospa(self.recording, truth, vts)

    @cached_property
    def associated(self) -> tuple[float | None, float | None]:
        """Precision and recall of the associations."""
        truth = self.recording.truth
        if truth is None or self.tracks is None:
            return None, None
        return map_scores.precision_recall(self.tracks, truth.measurement_vt)


@dataclass(frozen=True)
class Metric:
    """A metric: its key in rows, unit, heading of a column, digits in tables, meaning, and how it is computed; None: of
    several rows, or measured while the estimator runs. `axis`: label in figures; those without one have none. `tables`
    show it without being asked: `trial` and `trials` of `run`, `summary` of `table`, `suite`, `report`. `rising`: more
    is better. `share`: a value of one drive is 0 to 1."""

    key: str
    unit: str
    heading: str
    digits: int
    meaning: str
    of: Callable[[Scored], float | None] | None = None
    axis: str = ""
    tables: str = ""
    rising: bool = False
    share: bool = False

    @property
    def titled(self) -> str:
        """Heading and unit."""
        return f"{self.heading} {self.unit}" if self.unit == "time" else _with_unit(self.heading, self.unit)

    @property
    def label(self) -> str:
        """Label of an axis, with unit."""
        return _with_unit(self.axis, self.unit)


def _coverage() -> Iterator[Metric]:
    """Yield the metrics that say how often errors lie within what is claimed to hold them so often."""
    of: dict[str, tuple[str, Callable[[Scored], Floats]]] = {
        "coverage": ("horizontal position", lambda s: belief.claimed_probability(s.errors.squared)),
        "heading_coverage": ("heading", lambda s: belief.two_sided(s.errors.heading_ratio)),
        "clock_coverage": ("clock offsets", lambda s: belief.two_sided(s.clock_ratios)),
    }
    for name, (what, probability) in of.items():
        for level in belief.LEVELS:

            def share(s: Scored, level: float = level, probability: Any = probability) -> float | None:
                found = probability(s)
                return _over(np.mean, found[np.isfinite(found)] <= level)

            percent = f"{100 * level:g}"
            heading = f"{name.removesuffix('coverage').replace('_', ' ')}in {percent} %"
            shown = "report" if (name, level) == ("coverage", 0.95) else ""
            yield Metric(
                f"{name}_{percent}", "", heading, 3,
                f"share of snapshots in which the {what} lies within what is claimed to hold {percent} %", share,
                f"{percent} % coverage of the {what}" if shown else "", tables=shown, share=True,
            )  # fmt: skip


METRICS = (
    Metric("position_rmse_m", "m", "RMSE", 2, "root mean square of the horizontal position error, not aligned",
           lambda s: _rms(s.errors.position), "position RMSE", tables="trial trials summary suite report"),
    Metric("position_max_m", "m", "max", 2, "largest position error",
           lambda s: _over(np.max, s.errors.position), "largest position error", tables="trial trials summary suite"),
    Metric("position_end_m", "m", "end", 2, "position error at the end",
           lambda s: _over(lambda e: e[-1], s.errors.position), "position error at the end",
           tables="trial summary suite"),
    Metric("heading_rmse_rad", "rad", "heading", 4, "heading error, root mean square",
           lambda s: _rms(s.errors.heading), "heading RMSE", tables="trials suite report"),
    Metric("clock_offset_rmse_m", "m", "offset", 2, "error of the sites' clock offsets at the end, root mean square",
           lambda s: _rms(s.clock_offset_m), "clock offset error at the end",
           tables="trial trials summary suite report"),
    Metric("transmitter_rmse_m", "m", "sites", 2, "error of the sites' positions at the end, root mean square",
           lambda s: _rms(s.transmitter_m)),
    Metric("map_gospa_m", "m", "GOSPA", 2,
           "map of virtual transmitters: GOSPA, mean over links, which also counts what is missed and what is false",
           lambda s: s.map_gospa_m, "map GOSPA", tables="trials suite report"),
    Metric("map_rmse_m", "m", "VTs", 2,
           "error of the final virtual transmitters that were seen in twenty snapshots or more, root mean square",
           lambda s: _rms(s.settled[0])),
    Metric("bound_map_m", "m", "bound of VTs", 2,
           "Cramér-Rao bound of the same: the least error that a filter can have of what these VTs stand for",
           lambda s: _rms(s.settled[1])),
    Metric("wall_gospa_m", "m", "walls", 2, "walls, of estimators that report walls: GOSPA of their visible parts",
           lambda s: s.walls.get("wall_gospa_m")),
    Metric("wall_share", "", "mapped", 2, "share of the seen facades' length that is mapped",
           lambda s: s.walls.get("wall_share"), rising=True, share=True),
    Metric("wall_normal_rmse_rad", "rad", "wall normals", 4, "error of the walls' directions, root mean square",
           lambda s: s.walls.get("wall_normal_rmse_rad")),
    Metric("wall_offset_rmse_m", "m", "wall offsets", 2, "by how much walls are off across them, root mean square",
           lambda s: s.walls.get("wall_offset_rmse_m")),
    Metric("association_precision", "", "precision", 2, "share of associations that are right",
           lambda s: s.associated[0], tables="trial trials suite", rising=True, share=True),
    Metric("association_recall", "", "recall", 2, "share of measurements of a VT that were associated rightly",
           lambda s: s.associated[1], tables="trial trials suite", rising=True, share=True),
    Metric("nees_mean", "", "NEES", 2,
           "mean normalised estimation error squared of the position: 2 where the claimed covariance is right; a "
           "reference that states no deviation is taken as exact, and the value is then an upper limit",
           lambda s: _over(np.mean, s.errors.squared[np.isfinite(s.errors.squared)]), "mean NEES (2 is right)",
           tables="trials suite report"),
    Metric("log_score", "nat", "log score", 2,
           "minus the logarithm of the density that was claimed for the true horizontal position, mean: less is better",
           lambda s: _over(np.mean, belief.log_score(*s.errors.claimed)), "log score", tables="report"),
    Metric("energy_score_m", "m", "energy score", 2,
           "energy score of the claimed horizontal position, mean: in m, and kinder to outliers than the log score",
           lambda s: _over(np.mean, belief.energy_score(*s.errors.claimed))),
    *_coverage(),
    Metric("claimed_95_m", "m", "claimed 95 %", 2, "radius that is claimed to hold 95 % of the position, median",
           lambda s: _over(np.median, AS_CLAIMED.radius(s.errors.claimed[1], 0.05))),
    Metric("protection_m", "m", "protection", 2,
           "horizontal protection level, which the error is claimed to exceed once in a thousand times; median",
           lambda s: _over(np.median, s.errors.protection()[1])),
    Metric("protection_along_m", "m", "along", 2, "the same, along the track",
           lambda s: _over(np.median, s.errors.protection("along")[1])),
    Metric("protection_across_m", "m", "across", 2, "the same, across the track",
           lambda s: _over(np.median, s.errors.protection("across")[1])),
    Metric("availability", "", "available", 3, "share of snapshots with a horizontal protection level below 3 m",
           lambda s: _over(np.mean, s.errors.protection()[1] < ALERT_LIMIT_M), rising=True, share=True),
    Metric("misleading", "", "misleading", 4, "share of snapshots with an error above the horizontal protection level",
           lambda s: _exceeding(*s.errors.protection()), share=True),
    Metric("misleading_along", "", "along", 4, "the same, along the track",
           lambda s: _exceeding(*s.errors.protection("along")), share=True),
    Metric("misleading_across", "", "across", 4, "the same, across the track",
           lambda s: _exceeding(*s.errors.protection("across")), share=True),
    Metric("bound_position_rmse_m", "m", "bound", 2,
           "Cramér-Rao bound of the position RMSE: the least error that a filter can have on average on this drive, "
           "errors that persist included", lambda s: None if s.bound is None else s.bound.position_rmse_m,
           tables="suite report"),
    Metric("bound_merged_m", "m", "bound, merging in", 2,
           "the same with what merging does as one more error that persists; given where more than 5 % of the "
           "measurements are merged", lambda s: None if s.bound is None else s.bound.merged_m),
)  # fmt: skip
# What the estimator took, which varies from run to run; all else of a row is the same for a seed.
COSTS = (
    Metric("estimate_seconds", "s", "time a drive", 2, "time of the estimator's code", axis="time of the estimator",
           tables="suite"),
    Metric("realtime_factor", "time", "x real", 1, "duration of the drive over time of the estimator",
           tables="trial trials summary suite report", rising=True),
    Metric("peak_memory_mb", "MB", "memory", 1, "the most that the estimator made resident memory grow by",
           tables="suite report"),
)  # fmt: skip
# Of a group of rows: `tables.summaries.estimate` takes them from `statistics.efficiency_ratio`.
RATIOS = (
    Metric("efficiency_ratio", "", "efficiency ratio", 2,
           "root mean square of the RMSE over that of the bound, 1 at best", tables="trials summary suite report"),
    Metric("efficiency_ratio_merged", "", "merging counted in", 2,
           "the same, of the bound with merging as an error that persists", tables="trials suite"),
    Metric("map_efficiency_ratio", "", "map efficiency", 2, "root mean square of the VTs' error over that of its bound",
           tables="suite report"),
)  # fmt: skip
METRIC_KEYS, COST_KEYS = tuple(m.key for m in METRICS), tuple(m.key for m in COSTS)
# In the order of columns: the ratio stands beside the error that it is of.
METRIC = {metric.key: metric for metric in (METRICS[0], *RATIOS, *METRICS[1:], *COSTS)}
# Keys of one row of results, in the order in which they are written; a value that does not apply is null.
ROW_KEYS = (
    "scenario", "estimator", "trial", "seed", "status", "error", "snapshots", "duration_s", "distance_m",
    *METRIC_KEYS, *COST_KEYS,
)  # fmt: skip


def shown_in(table: str) -> tuple[str, ...]:
    """Return the keys of the metrics that a table shows without being asked."""
    return tuple(key for key, metric in METRIC.items() if table in metric.tables.split())


def score(recording: Recording, result: TrialResult, bound: BoundResult | None) -> dict[str, float | None]:
    """Return the metrics of a result by key (`METRICS`).

    None where one does not apply: no truth, or the estimator does not estimate it.
    """
    scored = Scored(recording, result, bound)
    return {metric.key: metric.of(scored) for metric in METRICS if metric.of is not None}


def errors_of(recording: Recording, result: TrialResult) -> Errors:
    """Return the errors of a result against the truth, or else the reference; none without both."""
    truth, reference = recording.truth, recording.reference
    if truth is None:
        return NO_ERRORS if reference is None else reference_errors(recording, reference, result)
    # The covariances of a smoother are those of the snapshots, and say nothing of its poses.
    claimed = np.full_like(result.covariances, np.nan) if result.smoothed else result.covariances
    return _errors(truth.poses, result.poses, claimed)


def reference_errors(recording: Recording, reference: Reference, result: TrialResult) -> Errors:
    """Return the errors against a reference: of the estimate at its times, where they lie within the drive.

    `reference_fixes` says which positions are left out. The NEES adds the reference's variance to the claimed one; a
    reference that does not state its own is taken as exact, so that the NEES is rather too large than too small.
    """
    rows = within(recording, reference) & ~unled(recording, reference)
    if not rows.any():
        return NO_ERRORS
    poses = at_fixes(recording, reference, rows, result.poses)
    known = np.column_stack([reference.position_m[rows], reference.yaw_rad[rows]])
    there, turned = usable(recording, reference)[rows], np.isfinite(known[:, 3])
    std = np.nan_to_num(reference.position_std_m[rows])
    claimed = covariances_at_fixes(recording, reference, rows, result.poses, result.covariances)
    claimed = claimed + (std**2)[:, None, None] * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    return _errors(known, poses, claimed, there, turned)


def _errors(
    known: Floats, poses: Floats, claimed: Floats, there: Any = slice(None), turned: Any = slice(None)
) -> Errors:
    """Return the errors of poses (N, 6) with their claims (N, 6, 6) against what is known, (N, 4) or more columns: of
    positions where they are `there`, of headings where `turned`."""
    horizontal = (poses[:, :2] - known[:, :2])[there]
    heading = wrap_angle(poses[turned, 3] - known[turned, 3])
    return Errors(horizontal, claimed[there, :2, :2], poses[there, 3], heading, claimed[turned, 3, 3])


def errors_over_time(recording: Recording, poses: Floats) -> tuple[Floats, Floats] | None:
    """Return times (N,) in s and horizontal errors (N,) in m of poses (T, 6); None where nothing is known."""
    found = compared(recording, poses)
    if found is None or not len(found[0]):
        return None
    time_s, there, known = found
    return time_s, np.hypot(*(there - known).T)


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


def _exceeding(error: Floats, level: Floats) -> float | None:
    """Return the share of errors (n,) above their protection levels (n,)."""
    return _over(np.mean, error > level)


def _rms(values: Floats | None) -> float | None:
    return _over(lambda found: np.sqrt(np.mean(np.square(found))), values)


def _over(statistic: Callable[[Any], Any], values: Any) -> float | None:
    """Return a statistic of values (N,), None where there are none."""
    return None if values is None or not len(values) else float(statistic(values))


def _with_unit(text: str, unit: str) -> str:
    return f"{text} ({unit})" if unit else text
