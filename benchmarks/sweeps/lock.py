"""A folder has one writer: the lock, and the refusal of network disks."""

from __future__ import annotations

import fcntl
import json
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from cellslam.sim.errors import InputError

LOCK = "lock"
NETWORK = frozenset(
    (
        *("nfs", "nfs4", "cifs", "smb", "smb2", "smb3", "smbfs", "ncpfs", "afs", "davfs", "9p"),
        *("lustre", "gpfs", "beegfs", "ceph", "glusterfs", "panfs", "pvfs2", "orangefs"),
        *("fuse.sshfs", "fuse.glusterfs", "fuse.ceph", "fuse.s3fs", "fuse.rclone", "fuse.davfs2"),
    )
)


@contextmanager
def only_writer(folder: Path, command: str) -> Iterator[None]:
    """Hold `folder` for this process; the system lets go of it however the process ends.

    Raises InputError naming the process that holds it.
    """
    try:
        file = (folder / LOCK).open("a+", encoding="utf-8")
    except OSError as error:
        raise InputError(f"--out {folder}: cannot be written ({error.strerror}); give another --out") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(
                f"--out {folder}: in use by {_holder(folder)}; wait for it or give another --out"
            ) from error
        holder = {"pid": os.getpid(), "host": platform.node(), "since": time.strftime("%F %T"), "command": command}
        _replace(file, json.dumps(holder) + "\n")
        try:
            yield
        finally:
            _replace(file, "")


def check_local(folder: Path, mounts: str | None = None) -> None:
    """Raise InputError if `folder` is on a network file system; `mounts` is the text of /proc/mounts.

    SQLite's locks and shared memory do not work there. Where the system has no such file nothing is checked.
    """
    if mounts is None:
        try:
            mounts = Path("/proc/mounts").read_text("utf-8", "surrogateescape")
        except OSError:
            return
    kind = _file_system(folder.absolute().resolve(), mounts)
    if kind in NETWORK:
        raise InputError(
            f"--out {folder}: is on a network file system ({kind}), where the database could be damaged; give a folder "
            "on a local disk: workers elsewhere need not see it, they send their rows to this process"
        )


def _file_system(path: Path, mounts: str) -> str:
    """Return the type of the file system that holds an absolute path."""
    fields = (line.split() for line in mounts.splitlines())
    places = [(Path(_unescaped(f[1])), f[2]) for f in fields if len(f) >= 3]
    holding = [
        (len(place.parts), index, kind) for index, (place, kind) in enumerate(places) if path.is_relative_to(place)
    ]
    return max(holding)[2] if holding else ""


def _unescaped(text: str) -> str:
    for code, character in (("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")):
        text = text.replace(code, character)
    return text


def _holder(folder: Path) -> str:
    try:
        held = json.loads((folder / LOCK).read_text("utf-8"))
        return f"process {held['pid']} on {held['host']} since {held['since']} ({held['command']})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another process"


def _replace(file: TextIO, text: str) -> None:
    """Put `text` in place of what is in the file; a full disk only costs the name of the holder."""
    with suppress(OSError):
        file.truncate(0)
        file.write(text)
        file.flush()
