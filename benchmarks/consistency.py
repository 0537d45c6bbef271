"""Whether estimators know how wrong they are: claimed covariances against the errors, over the trials of a sweep.

Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), section 5.4:
over N trials the mean of a consistent filter's normalised error squared (NEES) is chi-square over N.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.rows import results
from cellslam.benchmarks.store import trajectory_path
from cellslam.benchmarks.summaries import Layout, groups, row_keys
from cellslam.benchmarks.trajectories import Trajectory, unpack
from cellslam.sim.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

SHARE = 0.95  # of the intervals, and of a VT's ellipsoid
SIGMAS = 2.0  # of the clocks' band


def consistency(folder: str | Path, times: int = 10, rows: Sequence[str] | None = None) -> pd.DataFrame:
    """Return how honest the claimed covariances of a sweep's trials are, by group, at `times` moments up to the end.

    Columns: the row keys, `time_s`, `trials`; `nees` of the horizontal position, mean over trials (2 is right), with
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
        kept = [unpack(path) for path in paths if path.exists()]
        kept = [one for one in kept if len(one.nees)]
        lines += [{**values, **line} for line in _over_time(kept, times)]
    if not lines:
        raise InputError(f"{folder}: no trajectories with truth are kept (was it swept with --no-trajectories?)")
    return pd.DataFrame(lines)


def nees_band(trials: int) -> tuple[float, float]:
    """Return the interval that has 95 % of the means of so many consistent trials."""
    from scipy.stats import chi2

    low, high = chi2.ppf([(1.0 - SHARE) / 2.0, (1.0 + SHARE) / 2.0], 2 * trials) / trials
    return float(low), float(high)


def _over_time(kept: Sequence[Trajectory], times: int) -> Iterator[dict[str, Any]]:
    if not kept:
        return
    end = min(float(one.time_s[-1]) for one in kept)
    for number in range(1, times + 1):
        time_s = end * number / times
        at = [min(int(np.searchsorted(one.time_s, time_s - 1e-6)), len(one.time_s) - 1) for one in kept]
        squared = np.array([one.nees[t] for one, t in zip(kept, at, strict=True)])
        squared = squared[np.isfinite(squared)]
        low, high = nees_band(len(squared)) if len(squared) else (None, None)
        mean = float(squared.mean()) if len(squared) else None
        ratio = [np.abs(one.offset_error_m[t]) / one.offset_std_m[t] for one, t in zip(kept, at, strict=True)
                 if len(one.offset_error_m) and len(one.offset_std_m)]  # fmt: skip
        clock = _share("clock", np.concatenate(ratio) <= SIGMAS if ratio else np.zeros(0, bool))
        vt = _share("vt", _vts_inside(kept) if number == times else np.zeros(0, bool))
        yield {"time_s": time_s, "trials": len(kept), "nees": mean, "nees_low": low, "nees_high": high, **clock, **vt}


def _vts_inside(kept: Sequence[Trajectory]) -> Any:
    from scipy.stats import chi2

    squared = np.concatenate([one.vt_nees for one in kept])
    return squared[np.isfinite(squared)] <= chi2.ppf(SHARE, 3)


def _share(name: str, inside: Any) -> dict[str, Any]:
    from scipy.stats import binomtest

    count, numbers = len(inside), (None, None, None)
    if count:
        found = binomtest(int(inside.sum()), count).proportion_ci(SHARE, method="wilson")
        numbers = (float(inside.mean()), float(found.low), float(found.high))
    return dict(zip((f"{name}_share", f"{name}_low", f"{name}_high", f"{name}s"), (*numbers, count), strict=True))
