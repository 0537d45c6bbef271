"""Whether estimators know how wrong they are: claimed covariances against the errors, over the trials of a sweep.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), section 5.4:
over N trials the mean of a consistent filter's normalised error squared (NEES) is chi-square over N.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.sweeps.rows import results
from cellslam.benchmarks.sweeps.store import trajectory_path
from cellslam.benchmarks.sweeps.trajectories import Trajectory, unpack
from cellslam.benchmarks.tables.summaries import Layout, groups, row_keys
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

SHARE = 0.95  # of the intervals, and of a VT's ellipsoid
SIGMAS = 2.0  # of the clocks' band


@dataclass(frozen=True)
class _Claims:
    """One drive at K moments: `time_s`, `nees` (K,), `clock_ratio` (K, S or 0): |error| over deviation,
    `vt_nees` (V,)."""

    time_s: Any
    nees: Any
    clock_ratio: Any
    vt_nees: Any


def consistency(folder: str | Path, times: int = 10, rows: Sequence[str] | None = None) -> pd.DataFrame:
    """Return how honest the claimed covariances of a sweep's trials are, by group, at `times` moments up to the end.

    Where drives of a group differ in length, a moment is the same share of each. Columns: the row keys, `time_s` (the
    median), `trials`; `nees` of the horizontal position, mean over trials (2 is right), with
    the band `nees_low`, `nees_high` in which 95 % of such means are if all is right; `clock_share` of the sites' clock
    offsets that lie within two claimed deviations, `vt_share` of the final VTs that lie within their 95 % ellipsoid (at
    the end, and where it is known which VT each stands for), both with Wilson's 95 % interval (`_low`, `_high`) and
    their number (`clocks`, `vts`). None where there is nothing. Raises InputError where no trajectories are kept.
    """
    import pandas as pd

    if times < 1:
        raise InputError(f"times = {times}: must be at least 1")
    keys = row_keys(folder, Layout(rows=rows))
    frame = results(folder, [*keys, "key", "status"])
    lines = []
    for values, group in groups(frame[frame["status"] == "ok"], keys):
        paths = (trajectory_path(Path(folder), key) for key in group["key"])
        read = (unpack(path) for path in paths if path.exists())
        kept = [_claims(one, times) for one in read if len(one.nees)]
        lines += [{**values, **line} for line in _over_time(kept, times)]
    if not lines:
        raise InputError(f"{folder}: no trajectories with truth are kept (was it swept with --no-trajectories?)")
    return pd.DataFrame(lines)


def nees_band(trials: int) -> tuple[float, float]:
    """Return the interval that has 95 % of the means of so many consistent trials."""
    from scipy.stats import chi2

    tails = ((1.0 - SHARE) / 2.0, (1.0 + SHARE) / 2.0)
    return float(chi2.ppf(tails[0], 2 * trials) / trials), float(chi2.ppf(tails[1], 2 * trials) / trials)


def _claims(trajectory: Trajectory, times: int) -> _Claims:
    """Return what is compared of one drive: all else of a trajectory is let go."""
    time_s = trajectory.time_s
    moments = time_s[-1] * np.arange(1, times + 1) / times
    at = np.minimum(np.searchsorted(time_s, moments - 1e-6), len(time_s) - 1)
    ratio = np.zeros((times, 0))
    if len(trajectory.offset_error_m) and len(trajectory.offset_std_m):
        error_m, std_m = np.abs(trajectory.offset_error_m[at]), trajectory.offset_std_m[at]
        ratio = np.divide(error_m, std_m, out=np.full_like(std_m, np.nan), where=std_m > 0.0)
    return _Claims(moments, trajectory.nees[at], ratio, trajectory.vt_nees)


def _over_time(kept: Sequence[_Claims], times: int) -> Iterator[dict[str, Any]]:
    if not kept:
        return
    for number in range(times):
        squared = np.array([one.nees[number] for one in kept])
        squared = squared[np.isfinite(squared)]
        low, high = nees_band(len(squared)) if len(squared) else (None, None)
        mean = float(squared.mean()) if len(squared) else None
        ratio = np.concatenate([one.clock_ratio[number] for one in kept])
        clock = _share("clock", ratio[~np.isnan(ratio)] <= SIGMAS)  # a clock that was known has no ratio
        vt = _share("vt", _vts_inside(kept) if number == times - 1 else np.zeros(0, bool))
        time_s = float(np.median([one.time_s[number] for one in kept]))
        yield {"time_s": time_s, "trials": len(kept), "nees": mean, "nees_low": low, "nees_high": high, **clock, **vt}


def _vts_inside(kept: Sequence[_Claims]) -> Any:
    from scipy.stats import chi2

    squared = np.concatenate([one.vt_nees for one in kept])
    return squared[np.isfinite(squared)] <= chi2.ppf(SHARE, 3)


def _share(name: str, inside: Any) -> dict[str, Any]:
    from scipy.stats import binomtest

    count = len(inside)
    numbers: tuple[float | None, ...] = (None, None, None)
    if count:
        found = binomtest(int(inside.sum()), count).proportion_ci(SHARE, method="wilson")
        numbers = (float(inside.mean()), float(found.low), float(found.high))
    return dict(zip((f"{name}_share", f"{name}_low", f"{name}_high", f"{name}s"), (*numbers, count), strict=True))
