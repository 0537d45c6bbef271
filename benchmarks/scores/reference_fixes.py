"""Which fixes of a reference are used: those within the drive that have a position, and are not far off the others.

Source: R. K. Pearson et al., Generalized Hampel filters, EURASIP Journal on Advances in Signal Processing, 2016:
samples far from the median of those around them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.recording import Floats, Recording, Reference

NEIGHBOURS = 3  # on each side
STEPS, TIMES, LEAST_M = 4.0, 6.0, 3.0


def within(recording: Recording, reference: Reference) -> NDArray[np.bool_]:
    """Return which fixes (R,) of a reference lie within the drive, and so can be compared with an estimate."""
    times: NDArray[np.bool_] = (reference.time_s >= recording.time_s[0]) & (reference.time_s <= recording.time_s[-1])
    return times


def usable(recording: Recording, reference: Reference) -> NDArray[np.bool_]:
    """Return which fixes (R,) can be compared with an estimate: within the drive, with a position, not outlying."""
    known = np.isfinite(reference.position_m[:, :2]).all(axis=1)
    return np.asarray(within(recording, reference) & known & ~outlying(reference))


def compared(recording: Recording, poses: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Return times (N,) in s, and the horizontal positions (N, 2) in m of poses (T, 6) and of what is known then.

    Against the truth that is at every snapshot, against a reference at its usable fixes. None without both.
    """
    if recording.truth is not None:
        return recording.time_s, poses[:, :2], recording.truth.poses[:, :2]
    reference = recording.reference
    if reference is None:
        return None
    rows = usable(recording, reference)
    at = reference.time_s[rows]
    there = np.column_stack([np.interp(at, recording.time_s, poses[:, i]) for i in range(2)])
    return at, there, reference.position_m[rows, :2]


def outlying(reference: Reference) -> NDArray[np.bool_]:
    """Return which fixes (R,) lie off the median of their three neighbours on each side as no vehicle drives.

    That is by more than four steps between such fixes, six times the 95 % quantile of all fixes, and 3 m.
    """
    out = np.zeros(len(reference), np.bool_)
    known = np.flatnonzero(np.isfinite(reference.position_m[:, :2]).all(axis=1))
    width = 2 * NEIGHBOURS + 1
    if len(known) <= width:
        return out
    position = reference.position_m[known, :2]
    padded = np.pad(position, ((NEIGHBOURS, NEIGHBOURS), (0, 0)), mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, width, axis=0)
    off = np.hypot(*(position - np.median(around, axis=-1)).T)
    step = np.median(np.hypot(*np.moveaxis(np.diff(around, axis=-1), 1, 0)), axis=-1)
    out[known] = off > np.maximum(np.maximum(STEPS * step, TIMES * np.quantile(off, 0.95)), LEAST_M)
    return out
