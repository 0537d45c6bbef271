"""What adapters share: text files of numbers without names, and odometry for campaigns that have none."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cellslam.recordings.importing.odometry import OdometryTable
from cellslam.sim.errors import InputError
from cellslam.sim.frames import mean_velocity
from cellslam.sim.recording import Floats


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


def is_known(name: str, value: str) -> bool:
    """Return whether an option that is "known" or "unknown" is known. Raises InputError for another value."""
    if value not in ("unknown", "known"):
        raise InputError(f"{name} = '{value}': give 'unknown' or 'known'")
    return value == "known"


def increasing(rows: Floats) -> Floats:
    """Return the rows (N, C) in the order of their first column, a time in s, and one of those that share it."""
    kept: Floats = rows[np.unique(rows[:, 0], return_index=True)[1]]
    return kept


def simulated_odometry(
    time_s: Floats, place_m: Floats, yaw_rad: Floats, noise_density: Sequence[float]
) -> OdometryTable:
    """Return velocities in the plane between poses at times (T,): places (T, 2), yaws (T,), and white noise of a fixed
    seed. Who uses it says so.

    `noise_density` (6,) in m/s and rad/s times root second, as of a data sheet.
    """
    nothing = np.zeros(len(yaw_rad))
    poses = np.column_stack([place_m, nothing, yaw_rad, nothing, nothing])
    lasts = np.diff(time_s)
    u = mean_velocity(poses[:-1], poses[1:], lasts)
    u += np.asarray(noise_density) / np.sqrt(lasts)[:, None] * np.random.default_rng(0).standard_normal(u.shape)
    u = np.vstack([np.zeros(6), u])
    return OdometryTable(time_s, {"u_x": u[:, 0], "u_y": u[:, 1], "u_psi": u[:, 3]}, hold="before")
