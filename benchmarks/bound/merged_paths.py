"""What paths that are not resolved do to the bound.

A merged measurement lies between two paths, for as long as these stay close: azimuths are off by degrees, or, over a
ground that reflects, elevations. Nobody tells an estimator which ones are merged. The lower bound counts them as if
they were not. The upper one takes what merging does to a VT for one more error that persists, as large and as lasting
as it is on this drive: what a linear filter can reach that knows how strongly paths merge, and not which.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellslam.benchmarks.bound.cramer_rao import BoundResult, bound
from cellslam.benchmarks.bound.linear_model import Flags
from cellslam.sim.lte.persisting_errors import Cause
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording

# A measurement is merged where it is moved by more than this share of its deviation.
LEAST_SHIFT = 0.5
# Where fewer are merged the upper bound is not computed: it takes longer than the lower one.
LEAST_SHARE = 0.05
# How lasting merging is shows in what is left of it after so long, s: a share that lies between these.
LATER_S, LEAST_LEFT, MOST_LEFT = 5.0, 0.01, 0.99


def both_bounds(recording: Recording, progress: Progress = silent) -> BoundResult:
    """Return the bound of a recording with truth, and where many are merged the upper one, in m.

    Raises InputError as `bound` does.
    """
    lower = bound(recording, progress)
    if not merged_share(recording) > LEAST_SHARE:
        return lower
    return replace(lower, merged_m=bound(recording, progress, merging=merging(recording)).position_rmse_m)


def merging(recording: Recording) -> Cause:
    """Return what merging does on a drive whose truth tells it: root mean squares of its moves, and the time in which
    their correlation falls to 1/e, as if it fell exponentially; moves are added up in deviations of measurements."""
    truth, m = recording.truth, recording.measurements
    assert truth is not None and truth.merging_shift is not None
    real, count = np.flatnonzero(truth.measurement_vt >= 0), len(recording.time_s)
    shift = np.nan_to_num(truth.merging_shift[real])
    std = np.nan_to_num(truth.measurement_std[real])
    in_deviations = np.divide(shift, std, out=np.zeros_like(shift), where=std > 0.0)
    step_s = recording.elapsed_s[-1] / max(count - 1, 1) or LATER_S
    later = max(round(LATER_S / step_s), 1)
    key = (truth.measurement_vt[real] * len(recording.links) + m.link[real]) * (2 * count) + m.snapshot[real]
    _, first, again = np.intersect1d(key + later, key, return_indices=True)
    square, product = np.sum(in_deviations[first] ** 2), np.sum(in_deviations[first] * in_deviations[again])
    left = np.clip(product / max(square, np.finfo(float).tiny), LEAST_LEFT, MOST_LEFT)
    return Cause("merging", np.sqrt(np.mean(shift**2, axis=0)), float(-later * step_s / np.log(left)))


def merged(recording: Recording) -> Flags | None:
    """Return which measurements (M,) others have moved; None where the recording does not tell."""
    truth = recording.truth
    if truth is None or truth.merging_shift is None:
        return None
    moved = np.abs(truth.merging_shift) > LEAST_SHIFT * truth.measurement_std
    return np.asarray(moved.any(axis=1) & (truth.measurement_vt >= 0))


def merged_share(recording: Recording) -> float:
    """Return the share of merged ones among the measurements of true VTs; NaN where the recording does not tell."""
    flags = merged(recording)
    if flags is None:
        return float("nan")
    assert recording.truth is not None
    return float(flags.sum() / max((recording.truth.measurement_vt >= 0).sum(), 1))
