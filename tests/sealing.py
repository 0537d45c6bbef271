"""Files of cellslam's that a test changes and seals again, as one would who means what is in them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from cellslam.sim.recording.damage import sealed


@contextmanager
def resealed(path: Path) -> Iterator[h5py.File]:
    """Open a file for changes; on leaving it carries the digest of what it then holds."""
    with h5py.File(path, "r+") as file:
        yield file
    path.write_bytes(sealed(path.read_bytes()))
