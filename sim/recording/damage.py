"""Whether a file is safe to give to the HDF5 library, which may crash or never end on damaged bytes.

A file that cellslam wrote carries a digest of itself in HDF5's user block: 512 bytes at the front that other readers
pass over. As long as it fits, the bytes are those that were written. Any other file, of another program or changed
since, is first read through by a process of its own.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

from cellslam.sim.errors import InputError

USER_BLOCK = 512
_TITLE = b"cellslam recording; SHA-256 of what follows this block: "
_PIECE = 1 << 20
LIMIT_S, LIMIT_S_PER_BYTE = 60.0, 2e-8  # far more than reading takes, on a machine with other work too
# Reads all there is, and goes on where something cannot be read: what is wrong, the reader itself will say. More than
# deflate can have packed into the file is damage, not data.
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
        member = tried(lambda: group[name])
        if isinstance(member, h5py.Group):
            visit(member)
        elif isinstance(member, h5py.Dataset):
            tried(lambda: dict(member.attrs))
            tried(lambda: member.nbytes <= most and member[()])
with h5py.File(sys.argv[1], "r") as file:
    visit(file)
"""


def seal(path: Path) -> None:
    """Write the digest of the rest of the file into its user block."""
    with path.open("r+b") as file:
        block = _TITLE + _digest(path) + b"\n"
        file.write(block.ljust(USER_BLOCK, b"\0"))


def check(path: Path, limit_s: float | None = None) -> None:
    """Return when the HDF5 library can read the file without harm. Raises InputError when it crashes or never ends."""
    if _is_sealed(path):
        return
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


def _is_sealed(path: Path) -> bool:
    with path.open("rb") as file:
        block = file.read(USER_BLOCK)
    return block.startswith(_TITLE) and block[len(_TITLE) :].split(b"\n")[0] == _digest(path)


def _digest(path: Path) -> bytes:
    """Return the SHA-256 of what follows the user block, in hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        file.seek(USER_BLOCK)
        while piece := file.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest().encode("ascii")
