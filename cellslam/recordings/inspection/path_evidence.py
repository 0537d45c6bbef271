"""How well measured paths agree with the odometry, or with a reference that has a yaw: each measurement is predicted
from those of moments before.

A measurement z_j is one of its link's n measurements z_i of these, moved on by what the other table says, or new:

    p(z_j) = w / n sum_i N(z_j - h(z_i, motion); 0, diag(sigma_m^2, sigma_rad^2)) + (1 - w) / area

Which one it is, w and the sigmas are found with each correction by ROUNDS of expectation-maximisation (`_mixture`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from cellslam.recordings.inspection.corrections import Correction, Drive, Fixes, displacement, moved_on
from cellslam.sim.frames import wrap_angle
from cellslam.sim.recording import Floats, Ints, Recording

STEP_M, TURN_RAD = 1.5, 0.15  # how far the vehicle comes, or turns, within the shorter lag
MOVES = 16  # such steps or turns a drive must have: what moves less shows nothing
LONGER = 6  # times as long, the longer lag: what is near moves against what is far
LONGEST_S, LAGS = 30.0, 8  # a lag is no longer than this; and so many fit into the drive
# A reference does not drift: lags double up to half of the drive, which may be half as long.
MOVES_KNOWN, LAGS_KNOWN = 8, 2
PATHS = 40  # of a snapshot
CANDIDATES = 8_000  # for a lag
PAIRS = (40, 120)  # of snapshots
FEWEST = 40
ROUNDS = 4
LEAST_STD_M, LEAST_STD_RAD = 0.02, 0.002
ERROR, ERROR_KNOWN = 0.3, 0.05  # of a motion, with which the sigmas begin: of odometry and of a reference
FAR_M = 1e6
BLOCKS = 16
MOST_INDEPENDENT = 5.0  # most measurements of a pair of moments that count: their errors are alike


@dataclass(frozen=True)
class Pairs:
    """Moments (n,) in s, and candidates for their measurements: row `first` (C,) of an earlier moment, `before_s` (C,)
    in s, may have become `second`.

    `at` (C,): which of the G second measurements that is; `pair` (G,): to which moment it belongs; `share` (G,): one
    over the number of its candidates.
    """

    after_s: Floats
    before_s: Floats
    first: Ints
    second: Ints
    at: Ints
    pair: Ints
    share: Floats


class PathEvidence:
    """Log-likelihood of measurements, given those before and the motion, over many pairs of moments of a drive.

    The motion is that of the odometry, or of a reference. Over the long lags of a reference a path is predicted from
    where its source is, so that clocks must be known.
    """

    def __init__(self, recording: Recording, motion: Drive | Fixes) -> None:
        """Raise ValueError where azimuths, yaws or motion are too few."""
        m, self.motion, self.time_s = recording.measurements, motion, recording.time_s
        self.of_fixes = isinstance(motion, Fixes)
        self.name = f"measured paths and {motion.table}"
        self.usable = ~np.isnan(m.azimuth_rad) & (~np.isnan(m.distance_m) | np.isnan(m.distance_m).all())
        if self.usable.sum() < FEWEST:
            raise ValueError
        self.azimuth = m.azimuth_rad
        self.elevation = np.nan_to_num(m.elevation_rad)
        self.ranged = not np.isnan(m.distance_m).all()
        self.known = (recording.sites.clock_offset_std_m == 0.0)[recording.links.site][m.link] & self.ranged
        mean = recording.sites.clock_offset_mean_m[recording.links.site][m.link]
        self.distance = np.where(self.known, m.distance_m - mean, m.distance_m) if self.ranged else np.zeros(len(m))
        if isinstance(motion, Fixes):
            self.usable &= motion.known(self.time_s)[m.snapshot]
            if motion.yaw_rad is None or self.usable.sum() < FEWEST or not self.known[self.usable].all():
                raise ValueError
        area = np.ptp(self.azimuth[self.usable]) + 1e-3
        if self.ranged:
            area *= np.ptp(self.distance[self.usable]) + 1e-3
        self.area = float(area)
        self.lags = [pairs for lags in self._lags() if len((pairs := self._pairs(recording, lags)).pair)]
        if sum(len(pairs.pair) for pairs in self.lags) < FEWEST:
            raise ValueError
        moments = np.concatenate([pairs.after_s for pairs in self.lags])
        self.block = ((moments - self.time_s[0]) / np.ptp(self.time_s) * BLOCKS).astype(np.int64)
        self._plain = [self._logs(pairs, Correction()) for pairs in self.lags]

    def effect_of(self, c: Correction) -> Correction:
        """Return what a correction comes to between measurements and odometry or reference."""
        fields = ("azimuth", "azimuth_zero_rad", "distance", "distance_zero_m")
        return c.effect(self.motion.table, "measurements", fields)

    def change(self, c: Correction) -> Floats:
        """Return by how much an effect raises the log-likelihood (n,); NaN outside of the drive."""
        return np.concatenate(
            [self._change(pairs, plain, c) for pairs, plain in zip(self.lags, self._plain, strict=True)]
        )

    def _change(self, pairs: Pairs, plain: Floats, c: Correction) -> Floats:
        found = self._logs(pairs, c)
        inside = np.isfinite(found)
        # The noise is fitted to those moments that a delay leaves: so must it be for the comparison.
        same = bool((inside == np.isfinite(plain)).all())
        return np.asarray(found - (plain if same else self._logs(pairs, Correction(), inside)))

    def _lags(self) -> list[list[int]]:
        """Return lags in snapshots, those by which moments before stand together in one prediction in one list."""
        poses = self.motion.poses(self.time_s, Correction())
        self.progress = np.concatenate([[0.0], np.cumsum(np.nan_to_num(_moves(poses)))])
        typical = self.progress[-1] / max(int((np.diff(self.progress) > 1e-6).sum()), 1)
        if typical <= 0.0:
            raise ValueError
        drifts = np.inf if self.of_fixes else LONGEST_S / float(np.median(np.diff(self.time_s)))
        longest = max(min(drifts, len(self.time_s) / (LAGS_KNOWN if self.of_fixes else LAGS)), 1.0)
        lag = int(np.clip(round(1.0 / typical), 1, longest))
        if np.nansum(_moves(poses[::lag])) < (MOVES_KNOWN if self.of_fixes else MOVES):
            raise ValueError
        if self.of_fixes:
            return [[lag * 2**k for k in range(int(np.log2(longest / lag)) + 1)]]
        return [[each] for each in sorted({lag, int(min(LONGER * lag, longest))})]

    def _pairs(self, recording: Recording, lags: Sequence[int]) -> Pairs:
        m, first = recording.measurements, lags[0]
        each = np.bincount(m.snapshot[self.usable] * len(recording.links) + m.link[self.usable])
        candidates = len(lags) * float((each.astype(np.float64) ** 2).sum()) / len(self.time_s)
        pairs = int(np.clip(CANDIDATES / max(candidates, 1e-9), *PAIRS))
        even = np.linspace(self.progress[first], self.progress[-1], pairs)
        chosen = np.unique(np.clip(np.searchsorted(self.progress, even), first, len(self.time_s) - 1))
        rows = np.flatnonzero(self.usable)
        table = pd.DataFrame({"snapshot": m.snapshot[rows], "link": m.link[rows], "row": rows})
        table = table[table.groupby("snapshot").cumcount() < PATHS]
        after = table[table["snapshot"].isin(chosen)]
        before = pd.concat([table.assign(snapshot=table["snapshot"] + lag) for lag in lags])
        found = before.merge(after, on=["snapshot", "link"], suffixes=("_before", "_after"))
        found = found.sort_values(["row_after", "row_before"])
        source, second = found["row_before"].to_numpy(), found["row_after"].to_numpy()
        targets, at, count_of = np.unique(second, return_inverse=True, return_counts=True)
        moments, pair = np.unique(m.snapshot[targets], return_inverse=True)
        return Pairs(
            after_s=self.time_s[moments],
            before_s=self.time_s[m.snapshot[source]],
            first=source,
            second=second,
            at=at,
            pair=pair,
            share=1.0 / count_of,
        )

    def _logs(self, pairs: Pairs, c: Correction, among: NDArray[np.bool_] | bool = True) -> Floats:
        """Return the log-likelihood (n,) of pairs of moments, in units as recorded; NaN outside of the drive."""
        if not c.mirrored:
            return self._logs_of(pairs, c, among)
        # Of a reference with x and y swapped the yaw may be right, or from north as well.
        either = [self._logs_of(pairs, one, among) for one in (c, c.having("yaw_mirrored", True))]
        return max(either, key=lambda logs: float(np.nansum(logs)))

    def _logs_of(self, pairs: Pairs, c: Correction, among: NDArray[np.bool_] | bool) -> Floats:
        at = pairs.pair[pairs.at]
        before, after = (self.motion.poses(t, c) for t in (pairs.before_s, pairs.after_s))
        moved = displacement(before, after[at])
        inside = np.isfinite(moved).all(axis=1) & np.broadcast_to(among, len(pairs.after_s))[at]
        range_error, azimuth_error = self._innovations(pairs, moved, c)
        # In units as recorded: a correction that shrinks what is recorded is not the better for it.
        jacobian = c.distance if self.ranged else 1.0
        typical = np.median(np.abs(moved[inside]), axis=0) if inside.any() else np.zeros(3)
        error = ERROR_KNOWN if self.of_fixes else ERROR
        std_m = max(error * float(np.hypot(typical[0], typical[1])), 10 * LEAST_STD_M)
        std_rad = max(error * float(typical[2]), 0.05)
        range_error, azimuth_error = (np.where(inside, e, np.inf) for e in (range_error, azimuth_error))
        found, seen = self._mixture(pairs, range_error, azimuth_error, (std_m, std_rad), jacobian)
        total = np.bincount(pairs.pair, np.log(found), minlength=len(pairs.after_s))
        targets = np.bincount(pairs.pair, minlength=len(total))
        return np.where(seen, total * np.minimum(1.0, MOST_INDEPENDENT / np.maximum(targets, 1)), np.nan)

    def _innovations(self, pairs: Pairs, moved: Floats, c: Correction) -> tuple[Floats, Floats]:
        """Return second minus predicted distances and azimuths (C,) in m and rad, after `moved` (C, 3)."""
        i, j = pairs.first, pairs.second
        distance = self.distance * c.distance + c.distance_zero_m
        azimuth = self.azimuth * c.azimuth + c.azimuth_zero_rad
        range_m = np.where(self.known[i], distance[i], FAR_M)
        change, expected = moved_on(range_m, azimuth[i], self.elevation[i], moved)
        range_error = distance[j] - distance[i] - change if self.ranged else np.zeros(len(i))
        return range_error, wrap_angle(azimuth[j] - expected)

    def _mixture(
        self, pairs: Pairs, range_error: Floats, azimuth_error: Floats, start: tuple[float, float], jacobian: float
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the density (G,) of each second measurement as recorded, and for which moments there is any."""
        std_m, std_rad = start
        weight, count = 0.5, len(pairs.pair)
        e, a = range_error**2, azimuth_error**2
        both = np.isfinite(e)
        share = pairs.share[pairs.at]
        seen = np.bincount(pairs.pair[pairs.at], both, minlength=len(pairs.after_s)) > 0
        alive = max(int(seen[pairs.pair].sum()), 1)
        for _ in range(ROUNDS):
            scale = jacobian / (np.sqrt(2.0 * np.pi) * std_rad)
            exponent = a / std_rad**2
            if self.ranged:
                exponent = exponent + e / std_m**2
                scale /= np.sqrt(2.0 * np.pi) * std_m
            kernel = weight * scale * share * np.exp(-0.5 * exponent)
            density = np.bincount(pairs.at, kernel, minlength=count) + (1.0 - weight) / self.area
            mine = np.where(both, kernel / density[pairs.at], 0.0)
            total = mine.sum() + 1e-9
            weight = float(np.clip(total / alive, 0.05, 0.98))
            std_rad = max(float(np.sqrt((mine * np.where(both, a, 0.0)).sum() / total)), LEAST_STD_RAD)
            std_m = max(float(np.sqrt((mine * np.where(both, e, 0.0)).sum() / total)), LEAST_STD_M)
        return np.asarray(density, np.float64), seen


def _moves(poses: Floats) -> Floats:
    """Return how many steps, or turns, lie between poses (N, 3)."""
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    return np.asarray(np.maximum(step / STEP_M, np.abs(np.diff(poses[:, 2])) / TURN_RAD))
