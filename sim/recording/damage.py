"""HDF5 files that are written whole, and read only where that does no harm and gives what was written.

A file that cellslam wrote carries the SHA-256 of the rest of it in HDF5's user block: 512 bytes at the front that other
readers pass over. Where it does not fit, something was changed since, and the file is refused unless that is accepted.
A file without user block is of another program. What is not sealed is first read through by a process of its own, as
the HDF5 library may crash on damaged bytes, or never end.

The seal finds damage, not malice: who changes a file can seal it again. So a sealed file, too, is refused where parts
of it would be read from other files.
"""

from __future__ import annotations

import hashlib
import io
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from cellslam.sim.errors import InputError
from cellslam.sim.files import write_durably

USER_BLOCK = 512
# Maps and calibrations carry the same title.
_TITLE = b"cellslam recording; SHA-256 of what follows this block: "
_SIGNATURE = b"\x89HDF\r\n\x1a\n"  # how HDF5 begins, after the user block
LIMIT_S, LIMIT_S_PER_BYTE = 60.0, 2e-8  # far more than reading takes, on a machine with other work too
# Reads all there is, and goes on where something cannot be read: what is wrong, the reader itself will say. More than
# deflate can have packed into the file is damage, not data. What is in other files is not touched.
_READ_THROUGH = """
import os, sys, h5py
most = 2000 * os.path.getsize(sys.argv[1])
def tried(action):
    try:
        return action()
    except Exception:
        return None
def visit(group):
    tried(lambda: dict(group.attrs))
    for name in tried(lambda: list(group)) or ():
        if not isinstance(tried(lambda: group.get(name, getlink=True)), h5py.HardLink):
            continue
        member = tried(lambda: group[name])
        if isinstance(member, h5py.Group):
            visit(member)
        elif isinstance(member, h5py.Dataset) and tried(lambda: bool(member.is_virtual or member.external)) is False:
            tried(lambda: dict(member.attrs))
            tried(lambda: member.nbytes <= most and member[()])
with h5py.File(sys.argv[1], "r") as file:
    visit(file)
"""


def write(path: Path, fill: Callable[[h5py.File], None]) -> None:
    """Write the HDF5 file that `fill` fills, all of it or nothing, sealed.

    It is made in memory, as the HDF5 library crashes where a disk becomes full. Raises OSError.
    """
    memory = io.BytesIO()
    with h5py.File(memory, "w", libver=("v108", "v108"), userblock_size=USER_BLOCK) as file:
        fill(file)
    write_durably(path, sealed(memory.getvalue()))


def sealed(content: bytes) -> bytes:
    """Return the bytes of an HDF5 file with a user block, with the digest of the rest in it."""
    body = content[USER_BLOCK:]
    return _block(hashlib.sha256(body).hexdigest()) + body


@contextmanager
def opened(path: Path, accept_changed: bool = False) -> Iterator[h5py.File]:
    """Open a file of cellslam's for reading, once it is checked. Raises InputError, and what h5py raises."""
    check(path, accept_changed)
    with h5py.File(path, "r") as file:
        refuse_elsewhere(file)
        yield file


def check(path: Path, accept_changed: bool = False, limit_s: float | None = None) -> None:
    """Return when a file holds what was written, and the HDF5 library can read it without harm.

    Raises InputError where it was changed since, unless that is accepted, and where the library crashes or never ends.
    """
    with path.open("rb") as file:
        block, begin = file.read(USER_BLOCK), file.read(len(_SIGNATURE))
        file.seek(USER_BLOCK)
        if block == _block(hashlib.file_digest(file, "sha256").hexdigest()):
            return
    was_sealed = block.startswith(_TITLE) or (begin == _SIGNATURE and not block.startswith(_SIGNATURE))
    if was_sealed and not accept_changed:
        raise InputError(
            "damaged, truncated, or changed since cellslam wrote it: its SHA-256 is not the one that it carries; copy "
            "it again (a recording that was changed on purpose is read with --accept-changed)"
        )
    _read_through(path, limit_s)


def refuse_elsewhere(member: h5py.Group | h5py.Dataset) -> None:
    """Raise InputError where a part of a group or data set would be read from another file."""
    seen, todo = set[Any](), [member]
    while todo:
        one = todo.pop()
        if isinstance(one, h5py.Dataset) and (one.is_virtual or one.external):
            kind = "a virtual data set" if one.is_virtual else "in external storage"
            raise InputError(f"'{one.name}' is {kind}: its values are in other files; write them into this one")
        if not isinstance(one, h5py.Group) or one in seen:
            continue
        seen.add(one)
        for name in one:
            link = one.get(name, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                where = f"'{one.name.rstrip('/')}/{name}' is a link into the file '{link.filename}'"
                raise InputError(f"{where}; write what it leads to into this one")
            if isinstance(link, h5py.HardLink):
                todo.append(one[name])


def _block(digest: str) -> bytes:
    return (_TITLE + digest.encode("ascii") + b"\n").ljust(USER_BLOCK, b"\0")


def _read_through(path: Path, limit_s: float | None) -> None:
    limit = LIMIT_S + LIMIT_S_PER_BYTE * path.stat().st_size if limit_s is None else limit_s
    command = [sys.executable, "-P", "-c", _READ_THROUGH, str(path)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"damaged: the HDF5 library did not get through it in {limit:.0f} s; record or copy it again"
        ) from error
    if done.returncode not in (0, 1):
        raise InputError(
            f"damaged: the HDF5 library crashes on it (exit status {done.returncode}); record or copy it again"
        )
