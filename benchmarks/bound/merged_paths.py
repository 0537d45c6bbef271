"""Measurements that paths not told apart from theirs have moved: without them the bound is one that merging counts in.

A merged measurement lies between two paths. Taken as if it were of one, it misleads; taken for what it is, it tells of
two VTs at once, by shares of power that nobody knows. An estimator that recognises merged measurements can at least do
without them, and the bound of that is the upper one. The lower one counts them as if they had not merged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellslam.benchmarks.bound.bound_model import Flags
from cellslam.benchmarks.bound.cramer_rao import BoundResult, bound
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording

# A measurement is merged where it is moved by more than this share of its deviation.
LEAST_SHIFT = 0.5
# Where fewer are merged the upper bound is not computed: it takes as long as the lower one.
LEAST_SHARE = 0.05


def both_bounds(recording: Recording, progress: Progress = silent) -> BoundResult:
    """Return the bound of a recording with truth, and where many are merged the one without merged measurements, in m.

    Raises InputError as `bound` does.
    """
    lower = bound(recording, progress)
    if not merged_share(recording) > LEAST_SHARE:
        return lower
    return replace(lower, merged_m=bound(without_merged(recording), progress).position_rmse_m)


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


def without_merged(recording: Recording) -> Recording:
    """Return a recording whose truth takes merged measurements for clutter, as the bound then does."""
    flags, truth = merged(recording), recording.truth
    if flags is None or truth is None:
        return recording
    return replace(recording, truth=replace(truth, measurement_vt=np.where(flags, -1, truth.measurement_vt)))
