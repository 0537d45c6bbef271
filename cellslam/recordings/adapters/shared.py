"""What adapters share: text files of numbers and tables, TUM trajectories, anchors, odometry where there is none."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.recordings.importing.tables import TableFile
from cellslam.sim.errors import InputError
from cellslam.sim.frames import mean_velocity
from cellslam.sim.recording import COMPONENTS, Floats

TUM = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
Names = Mapping[str, float]  # what a column may be called, and what its unit is in ours


def matrix(path: Path, columns: tuple[str, ...]) -> Floats:
    """Return a text file's rows (N, C) of numbers between white space, in file order; # begins a comment.

    `columns` are what its C columns hold, for the message. Raises InputError where it is something else.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; download it into this folder")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of an empty file
            rows = np.loadtxt(path, ndmin=2)
    except (ValueError, OSError) as error:
        why = " ".join(str(error).split())
        raise InputError(f"{path}: not a table of numbers ({why}); download it again") from error
    if not rows.size:
        raise InputError(f"{path}: has no row; download it again")
    if rows.shape[1] != len(columns):
        raise InputError(f"{path}: has {rows.shape[1]} columns, expected {len(columns)}: {', '.join(columns)}")
    return rows


def only(folder: Path, *patterns: str) -> Path:
    """Return the one file of a folder that one of the patterns fits. Raises InputError where there is none, or more."""
    found, kind = sorted(path for pattern in patterns for path in folder.glob(pattern)), " or ".join(patterns)
    if not found:
        raise InputError(f"{folder}: holds no file {kind}; download one drive into it")
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise InputError(f"{folder}: holds more than one file {kind} ({names}): leave that of one drive in it")
    return found[0]


def is_known(name: str, value: str) -> bool:
    """Return whether an option that is "known" or "unknown" is known. Raises InputError for another value."""
    if value not in ("unknown", "known"):
        raise InputError(f"{name} = '{value}': give 'unknown' or 'known'")
    return value == "known"


def increasing(rows: Floats) -> Floats:
    """Return the rows (N, C) in the order of their first column, a time in s, and one of those that share it."""
    kept: Floats = rows[np.unique(rows[:, 0], return_index=True)[1]]
    return kept


def named(path: Path, columns: Mapping[str, Names], optional: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return columns (N,) of a text file by our names, in our units; that called "id" as text.

    `columns`: under which names of the file each may stand, with units. Raises InputError where one that is not
    `optional` is missing.
    """
    table, found = TableFile(path), dict[str, Any]()
    for own, names in columns.items():
        name = next((each for each in names if each in table.names), None)
        if name is not None:
            found[own] = np.array(table.labels(name)) if own == "id" else table.numbers(name) * names[name]
        elif own not in optional:
            has = ", ".join(table.names)
            raise InputError(f"{path}: has no column {' or '.join(names)} (it has: {has}); rename the one that it is")
    return found


def anchors(folder: Path, columns: Mapping[str, Names]) -> dict[str, Floats]:
    """Return the places (3,) in m of the anchors in `anchors.csv` by their "id"; columns as for `named`."""
    table = named(folder / "anchors.csv", columns)
    return dict(zip(table["id"].tolist(), np.column_stack([table[axis] for axis in "xyz"]), strict=True))


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
        raise InputError(f"anchor '{missing[0]}' has ranges but no position (known: {known}): give one or leave it out")
    return {name: places[name].tolist() for name in names}


def planar(place_m: Floats, yaw_rad: Floats) -> Floats:
    """Return poses (N, 6) in m and rad of places (N, 2) and yaws (N,) in the plane."""
    nothing = np.zeros(len(yaw_rad))
    return np.column_stack([place_m, nothing, yaw_rad, nothing, nothing])


def simulated_odometry(
    time_s: Floats, place_m: Floats, yaw_rad: Floats, noise_density: Sequence[float]
) -> OdometryTable:
    """Return velocities in the plane between poses at times (T,): places (T, 2), yaws (T,), and white noise of a fixed
    seed. Who uses it says so.

    `noise_density` (6,) in m/s and rad/s times root second, as of a data sheet.
    """
    lasts, poses = np.diff(time_s), planar(place_m, yaw_rad)
    u = mean_velocity(poses[:-1], poses[1:], lasts)
    u += np.asarray(noise_density) / np.sqrt(lasts)[:, None] * np.random.default_rng(0).standard_normal(u.shape)
    u = np.vstack([np.zeros(6), u])
    return OdometryTable(time_s, {"u_x": u[:, 0], "u_y": u[:, 1], "u_psi": u[:, 3]}, hold="before")
