"""Whether estimators know how wrong they are: their covariances against the errors, over the trials of a sweep.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), section 5.4:
over N trials the mean of a consistent filter's normalised error squared (NEES) is chi-square over N.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtri

from cellslam.benchmarks.scores.belief import claimed_probability, ratio, two_sided
from cellslam.benchmarks.scores.metrics import Scored
from cellslam.benchmarks.scores.statistics import wilson
from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.sweeps.store import trajectory_of
from cellslam.benchmarks.sweeps.trajectories import Trajectory
from cellslam.benchmarks.tables.summaries import CONFIDENCE, Layout, groups, ok_rows, row_keys
from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats, Ints, Recording

if TYPE_CHECKING:
    import pandas as pd

SIGMAS = 2.0  # of the clocks' band


@dataclass(frozen=True)
class Claimed:
    """The probabilities that were claimed in a drive for what reaches to the truth: horizontal ellipses `position`,
    intervals of the `heading`, and of each `clock`; each (n,), uniform where claims are right."""

    position: Floats
    heading: Floats
    clock: Floats


def claimed_in(one: Trajectory) -> Claimed:
    """Return what was claimed in a drive whose trajectory is kept; one of an older version has no heading."""
    heading = ratio(one.heading_error_rad, one.heading_std_rad**2)
    clock = ratio(one.offset_error_m, one.offset_std_m**2) if len(one.offset_std_m) else np.zeros(0)
    return _known(claimed_probability(one.nees), two_sided(heading), two_sided(clock.ravel()))


def claimed_by(recording: Recording, result: TrialResult) -> Claimed:
    """Return what a result claims of a drive with truth or reference."""
    scored = Scored(recording, result, None)
    errors, clock = scored.errors, scored.clock_ratios
    return _known(claimed_probability(errors.squared), two_sided(errors.heading_ratio), two_sided(clock))


def _known(*columns: Floats) -> Claimed:
    return Claimed(*(column[np.isfinite(column)] for column in columns))


def consistency(folder: str | Path, times: int = 10, rows: Sequence[str] | None = None) -> pd.DataFrame:
    """Return how consistent covariances are with errors, by group of a sweep's trials, at `times` moments.

    Where drives of a group differ in length, a moment is the same share of each. Columns: the row keys, `time_s` (the
    median), `trials`; `nees` of the horizontal position, mean over trials (2 is right), with the band `nees_low`,
    `nees_high` in which 95 % of such means are if all is right; `position_share` of the drives whose position lies
    within its 95 % ellipse; `clock_share` of the sites' clock offsets that lie within two claimed deviations,
    `vt_share` of the final VTs that lie within their 95 % ellipsoid (at the end, and where it is known which VT each
    stands for), all with Wilson's 95 % interval (`_low`, `_high`) and their number (`positions`, `clocks`, `vts`). None
    where there is nothing. Raises InputError where no trajectories are kept.
    """
    import pandas as pd

    if times < 1:
        raise InputError(f"times = {times}: must be at least 1")
    keys = row_keys(folder, Layout(rows=rows))
    lines = []
    for values, group in groups(ok_rows(folder, keys), keys):
        read = (trajectory_of(Path(folder), key) for key in group["key"])
        known = (one for one in read if one is not None and len(one.nees))
        lines += [{**values, **line} for line in _over_time(known, times)]
    if not lines:
        raise InputError(f"{folder}: no trajectories with truth are kept (was it swept with --no-trajectories?)")
    return pd.DataFrame(lines)


def nees_band(trials: int) -> tuple[float, float]:
    """Return the interval that has 95 % of the means of so many consistent trials."""
    above = (1.0 + CONFIDENCE) / 2.0, (1.0 - CONFIDENCE) / 2.0
    low, high = chdtri(2 * trials, above) / trials
    return float(low), float(high)


def _over_time(drives: Iterable[Trajectory], times: int) -> Iterator[dict[str, Any]]:
    """Yield what is claimed at each moment of the drives (N); all else of a trajectory is let go."""
    moments, nees, ratios, vts = [], [], [], []
    for one in drives:
        moments.append(one.time_s[-1] * np.arange(1, times + 1) / times)
        at = np.minimum(np.searchsorted(one.time_s, moments[-1] - 1e-6), len(one.time_s) - 1)
        nees.append(one.nees[at])
        ratios.append(_clock_ratios(one, at))
        vts.append(one.vt_nees[np.isfinite(one.vt_nees)])
    for number in range(times if moments else 0):
        squared = np.array([own[number] for own in nees])
        squared = squared[np.isfinite(squared)]
        low, high = nees_band(len(squared)) if len(squared) else (None, None)
        ratio = np.concatenate([own[number] for own in ratios])
        last = number == times - 1
        yield {
            "time_s": float(np.median([own[number] for own in moments])),
            "trials": len(nees),
            "nees": float(squared.mean()) if len(squared) else None,
            "nees_low": low,
            "nees_high": high,
            **_share("position", squared <= chdtri(2, 1.0 - CONFIDENCE)),
            **_share("clock", ratio[~np.isnan(ratio)] <= SIGMAS),  # a clock that was known has no ratio
            **_share("vt", np.concatenate(vts) <= chdtri(3, 1.0 - CONFIDENCE) if last else np.zeros(0, bool)),
        }


def _clock_ratios(one: Trajectory, at: Ints) -> Any:
    """Return the errors of the clock offsets over their claimed deviations (K, S) at the snapshots `at` (K,)."""
    if not (len(one.offset_error_m) and len(one.offset_std_m)):
        return np.zeros((len(at), 0))
    return ratio(one.offset_error_m[at], one.offset_std_m[at] ** 2)


def _share(name: str, inside: Any) -> dict[str, Any]:
    share, low, high = None, None, None
    if len(inside):
        share, (low, high) = float(inside.mean()), wilson(int(inside.sum()), len(inside), CONFIDENCE)
    return {f"{name}_share": share, f"{name}_low": low, f"{name}_high": high, f"{name}s": len(inside)}
