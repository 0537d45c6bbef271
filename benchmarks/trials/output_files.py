"""Files and folders of results: whether they can be written, their names, writing at once."""

from __future__ import annotations

import os
import re
from pathlib import Path

from cellslam.sim.errors import InputError


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


def write_text(path: Path, text: str) -> None:
    """Write a text file at once, whatever the text: first a temporary one beside it, which then takes its place."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, "utf-8", "backslashreplace")
    temporary.replace(path)
