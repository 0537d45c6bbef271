"""Files that are written whole or not at all, and stay written when the machine loses power; folders of one user."""

from __future__ import annotations

import os
import secrets
import stat
import tempfile
from pathlib import Path


def write_durably(path: Path, content: bytes) -> None:
    """Put `content` in place of the file `path`, all of it or nothing: first into a temporary file beside it.

    On return both the content and its name are on the disk. Raises OSError; the temporary file never stays.
    """
    # On a network disk processes of other machines may have the same number.
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the name, too
    finally:
        os.close(folder)


def private_folder(name: str) -> Path | None:
    """Return this user's folder `name` in the system's temporary folder; None where others could write into it.

    The name can be guessed: a folder that is another user's, or a link, or that others may write into or rename, is
    not used.
    """
    shared = Path(tempfile.gettempdir())
    own = shared / f"cellslam-{os.getuid()}"
    try:
        mode = shared.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            return None
        for folder in (own, own / name):
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
            if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
                return None
            if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                return None
    except OSError:
        return None
    return own / name
