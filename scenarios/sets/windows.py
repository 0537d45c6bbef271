"""Batches of parts of drives, as arrays that `torch.from_numpy` and `jax.numpy.asarray` take as they are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellslam.scenarios.sets.reading import MEASURED, Drive, drives_of
from cellslam.sim.errors import InputError

Batch = dict[str, NDArray[Any]]


def windows(
    folder: str | Path, length: int, batch: int, shuffle: np.random.Generator | None = None, split: str = "train"
) -> Iterator[Batch]:
    """Yield all windows of `length` snapshots of a split once, `batch` (B) at a time; the last ones may be fewer.

    Windows of a drive follow one another, from its first snapshot; with `shuffle` from a random one, and in random
    order. What is left at the end of a drive is left out. Arrays, with P the most paths of a snapshot in the split:

        drive (B,), first (B,)       row of the drive in the split, first snapshot of the window
        dt_s (B, L)                  s since the snapshot before, 0 at the first of a drive
        odometry (B, L, 6)           mean body velocities, m/s and rad/s
        paths (B, L, P, 7)           distance_m, azimuth_rad, elevation_rad, snr_db, claimed deviations (m, rad, rad)
        link (B, L, P), mask (B, L, P)    link of each path; whether there is one: elsewhere all is 0
        pose (B, L, 6)               true pose, m and rad
        vt (B, L, P)                 true VT of each path, -1 none
        clock_offset_m (B, L, S)     true clock offsets

    The last three are not there in the split `test`. A component that was not measured is NaN. Raises InputError.
    """
    if length < 1 or batch < 1:
        raise InputError(f"length = {length}, batch = {batch}: both must be at least 1")
    drives = drives_of(folder, split)
    starts = _starts(drives, length, shuffle)
    if not len(starts):
        raise InputError(f"{folder}: no drive of '{split}' has {length} snapshots")
    most = max(drive.row.most_paths for drive in drives)
    for chosen in np.split(starts, range(batch, len(starts), batch)):
        yield _batch(drives, chosen, length, most)


def _starts(drives: list[Drive], length: int, shuffle: np.random.Generator | None) -> NDArray[np.int64]:
    """Return drive and first snapshot (N, 2) of each window, in the order in which they are given."""
    out = [np.empty((0, 2), np.int64)]
    for number, drive in enumerate(drives):
        begin = 0 if shuffle is None else int(shuffle.integers(drive.row.snapshots % length + 1))
        first = np.arange(begin, drive.row.snapshots - length + 1, length)
        out.append(np.stack([np.full(len(first), number), first], axis=1))
    starts = np.concatenate(out)
    return starts if shuffle is None else shuffle.permutation(starts)


def _batch(drives: list[Drive], starts: NDArray[np.int64], length: int, most: int) -> Batch:
    size, hidden = len(starts), "truth/poses" not in drives[starts[0, 0]]
    wide = (size, length, most)
    out: Batch = {
        "drive": starts[:, 0].copy(), "first": starts[:, 1].copy(), "dt_s": np.empty((size, length), np.float32),
        "odometry": np.empty((size, length, 6), np.float32), "paths": np.zeros((*wide, len(MEASURED)), np.float32),
        "link": np.zeros(wide, np.int32), "mask": np.zeros(wide, np.bool_),
    }  # fmt: skip
    if not hidden:
        sites = len(drives[starts[0, 0]]["truth/clock_offsets_m"].codes)
        out |= {
            "pose": np.empty((size, length, 6), np.float32), "vt": np.full(wide, -1, np.int32),
            "clock_offset_m": np.empty((size, length, sites), np.float32),
        }  # fmt: skip
    for k, (number, first) in enumerate(starts):
        _fill({name: array[k] for name, array in out.items()}, drives[number], slice(first, first + length))
    return out


def _fill(out: Batch, drive: Drive, snapshots: slice) -> None:
    """Write the snapshots of a window into its part of a batch."""
    begin = drive.rows[snapshots.start : snapshots.stop + 1]
    rows, count = slice(begin[0], begin[-1]), np.diff(begin)
    # Place of each row in the padded arrays (L, P), flat.
    place = np.arange(begin[-1] - begin[0]) + np.repeat(
        np.arange(len(count)) * out["mask"].shape[1] - begin[:-1] + begin[0], count
    )
    out["dt_s"][:], out["odometry"][:] = drive.dt_s[snapshots], drive["odometry"][snapshots]
    for column, name in enumerate(MEASURED):
        out["paths"].reshape(-1, len(MEASURED))[place, column] = drive[f"measurements/{name}"][rows]
    out["link"].reshape(-1)[place], out["mask"].reshape(-1)[place] = drive["measurements/link"][rows], True
    if "pose" in out:
        out["pose"][:], out["clock_offset_m"][:] = drive["truth/poses"][snapshots], drive.clock_offsets_m[snapshots]
        out["vt"].reshape(-1)[place] = drive["truth/measurement_vt"][rows]
