"""What adapters of ranges to anchors share: tables with the units in their column names, TUM trajectories, anchors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cellslam.recordings.adapters.shared import increasing, matrix
from cellslam.recordings.importing.manifest import FileTable
from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.recordings.importing.tables import Head, TableFile
from cellslam.sim.errors import InputError
from cellslam.sim.frames import mean_velocity
from cellslam.sim.recording import COMPONENTS, Floats

TUM = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
Names = Mapping[str, float]  # what a column may be called, and what its unit is in ours


def named(path: Path, columns: Mapping[str, Names], optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return columns (N,) of a text file by our names, in our units; that called "id" as text.

    `columns`: under which names of the file each may stand, with units. Raises InputError where one that is not
    `optional` is missing.
    """
    table, head = TableFile(path.parent, FileTable(file=path.name, columns={})), Head.of(path, "")
    found: dict[str, Any] = {}
    for own, names in columns.items():
        name = next((each for each in names if each in head.names), None)
        if name is not None:
            found[own] = np.array(table.labels(name)) if own == "id" else table.numbers(name) * names[name]
        elif own not in optional:
            has = ", ".join(head.names)
            raise InputError(f"{path}: has no column {' or '.join(names)} (it has: {has}); rename the one that it is")
    return found


def trajectory(path: Path) -> tuple[Floats, Floats]:
    """Return times (N,) in s and poses (N, 6) in m and rad of a TUM file: time, place, quaternion body to world."""
    rows = increasing(matrix(path, TUM))
    return rows[:, 0], poses_of(path, rows[:, 1:4], rows[:, 4:])


def poses_of(path: Path, place_m: Floats, quaternion: Floats) -> Floats:
    """Return poses (N, 6) in m and rad of places (N, 3) and quaternions (N, 4) x, y, z, w of the file at `path`."""
    zero = np.flatnonzero(~(np.linalg.norm(quaternion, axis=1) > 0.0))
    if len(zero):
        raise InputError(f"{path}: row {zero[0]} has no quaternion; write 0 0 0 1 where the attitude is unknown")
    return np.column_stack([place_m, Rotation.from_quat(quaternion).as_euler("ZYX")])


def pose_odometry(time_s: Floats, poses: Floats) -> OdometryTable:
    """Return the velocities between poses (N, 6) of a frame of the odometry's own, at times (N,) in s."""
    u = mean_velocity(poses[:-1], poses[1:], np.diff(time_s))
    return OdometryTable(time_s[1:], dict(zip(COMPONENTS, u.T, strict=True)), "before")


def surveyed(names: Iterable[str], places: Mapping[str, Floats]) -> dict[str, Sequence[float]]:
    """Return where the sites of these names stand, for a campaign. Raises InputError for a site without a place."""
    missing = [name for name in names if name not in places]
    if missing:
        known = ", ".join(places)
        raise InputError(f"anchor '{missing[0]}' has ranges but no place (known: {known}): survey it, or leave it out")
    return {name: places[name].tolist() for name in names}
