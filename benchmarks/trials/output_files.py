"""Files and folders of results: whether they can be written, their names, writing at once; trajectories (TUM)."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from cellslam.sim.errors import InputError
from cellslam.sim.files import write_durably

if TYPE_CHECKING:
    from cellslam.sim.recording import Floats


def check_folder(path: Path, option: str = "--out") -> None:
    """Raise InputError unless a folder `path` exists or can be made, and can be written. Makes nothing."""
    existing = next(place for place in (path, *path.absolute().parents) if place.exists())
    if not existing.is_dir():
        raise InputError(f"{option} {path}: {existing} is a file, not a folder; give another {option}")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(f"{option} {path}: no permission to write in {existing}; give another {option}")


def check_file(path: Path, option: str = "--out") -> None:
    """Raise InputError unless a file `path` can be written in a folder that exists. Makes nothing."""
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; give the name of a file in it")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}; create it first")
    check_folder(path.absolute().parent, option)


def file_name(estimator: str) -> str:
    """Return an estimator's name as a part of a file name."""
    return re.sub(r"[^\w.-]", "_", estimator)


@contextmanager
def writing(path: Path, remedy: str = "give another path") -> Iterator[None]:
    """Raise InputError, with a remedy, where the disk refuses what is written to `path` in this context."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); {remedy}") from error


@contextmanager
def at_once(path: Path) -> Iterator[Path]:
    """Give another name for the file or folder `path`: what is written there becomes `path` when all went well, and
    disappears when not. Raises InputError where the disk refuses it.
    """
    place = path.absolute().with_name(f".{os.getpid()}.{path.name}")
    try:
        with writing(path):
            yield place
            place.replace(path)
    finally:
        if place.is_dir():
            shutil.rmtree(place, ignore_errors=True)
        else:
            place.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, all or nothing, whatever the text. Raises InputError."""
    with writing(path):
        write_durably(path, text.encode("utf-8", "backslashreplace"))


def write_tum(path: str | Path, time_s: Floats, poses: Floats) -> None:
    """Write poses (T, 6) at `time_s` (T,) in seconds: positions in metres, quaternions body to world.

    The TUM format, which evo and most SLAM tools read: `timestamp tx ty tz qx qy qz qw`.
    """
    import numpy as np

    table = np.column_stack([time_s, poses[:, :3], quaternions(poses)])
    np.savetxt(path, table, fmt=["%.6f", *["%.6f"] * 3, *["%.9f"] * 4], header="timestamp tx ty tz qx qy qz qw")


def quaternions(poses: Floats) -> Floats:
    """Return the unit quaternions (T, 4) = [qx, qy, qz, qw], qw >= 0, of poses (T, 6) in m and rad, body to world."""
    from scipy.spatial.transform import Rotation

    quaternions: Floats = Rotation.from_euler("ZYX", poses[:, 3:]).as_quat(canonical=True)
    return quaternions
