"""Which fixes of a reference are used, and what an estimate says at their times.

Used are fixes within the drive that have a position, are not far off the others, and to which the odometry leads from
the snapshot before. From there it carries the estimate to the fix: a straight line to the next snapshot is not what a
vehicle drives in a pause of the measurements.

Source: R. K. Pearson et al., Generalized Hampel filters, EURASIP Journal on Advances in Signal Processing, 2016:
samples far from the median of those around them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.frames import integrate_pose, pose_jacobians
from cellslam.sim.recording import Floats, Recording, Reference

SHORTEST_S = 1e-6  # between a snapshot and a fix: there is no less than nothing
NEIGHBOURS = 3  # on each side
STEPS, TIMES, LEAST_M = 4.0, 6.0, 3.0


def within(recording: Recording, reference: Reference) -> NDArray[np.bool_]:
    """Return which fixes (R,) of a reference lie within the drive, and so can be compared with an estimate."""
    times: NDArray[np.bool_] = (reference.time_s >= recording.time_s[0]) & (reference.time_s <= recording.time_s[-1])
    return times


def usable(recording: Recording, reference: Reference) -> NDArray[np.bool_]:
    """Return which fixes (R,) can be compared with an estimate: within the drive, with a position, not outlying, and
    not where the odometry pauses."""
    known = np.isfinite(reference.position_m[:, :2]).all(axis=1)
    return np.asarray(within(recording, reference) & known & ~outlying(reference) & ~unled(recording, reference))


def unled(recording: Recording, reference: Reference) -> NDArray[np.bool_]:
    """Return which fixes (R,) within the drive lie in a pause of an odometry that the recording otherwise has."""
    if reference.odometry is None:
        return np.zeros(len(reference), np.bool_)
    moving = ~np.isnan(reference.odometry).all(axis=0)
    missing = np.isnan(reference.odometry[:, moving]).any(axis=1)
    return np.asarray(within(recording, reference) & missing)


def at_fixes(recording: Recording, reference: Reference, rows: NDArray[np.bool_], poses: Floats) -> Floats:
    """Return the poses (N, 6) of an estimate (T, 6) at the fixes `rows` (R,), which are within the drive.

    The odometry carries the pose from the snapshot before; where a recording has none, poses are interpolated.
    """
    times, at = recording.time_s, reference.time_s[rows]
    if reference.odometry is None:
        turns = np.unwrap(poses[:, 3:], axis=0)
        return np.column_stack([np.interp(at, times, column) for column in (*poses[:, :3].T, *turns.T)])
    before = np.searchsorted(times, at, side="right") - 1
    return integrate_pose(poses[before], np.nan_to_num(reference.odometry[rows]), at - times[before])


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
    there = at_fixes(recording, reference, rows, poses)[:, :2]
    return reference.time_s[rows], there, reference.position_m[rows, :2]


def covariances_at_fixes(
    recording: Recording, reference: Reference, rows: NDArray[np.bool_], poses: Floats, covariances: Floats
) -> Floats:
    """Return the covariances (N, 6, 6) of an estimate (T, 6), (T, 6, 6) at the fixes `rows` (R,), within the drive.

    The covariance of the snapshot before grows by what the odometry's data sheet says of its errors since then.
    """
    times, at, model = recording.time_s, reference.time_s[rows], recording.odometry_model
    before = np.searchsorted(times, at, side="right") - 1
    if reference.odometry is None:
        return covariances[before]
    dt, velocity = at - times[before], np.nan_to_num(reference.odometry[rows])
    F, G = pose_jacobians(poses[before], velocity, dt)
    lasting = model.bias**2 + (model.scale * velocity) ** 2
    variance = lasting + model.noise_density**2 / np.maximum(dt, SHORTEST_S)[:, None]
    grown: Floats = F @ covariances[before] @ np.swapaxes(F, 1, 2) + (G * variance[:, None]) @ np.swapaxes(G, 1, 2)
    return grown


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
