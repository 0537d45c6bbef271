"""Files written under another name first."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from cellslam.sim.errors import InputError


def at_once(path: Path, write: Callable[[Path], None]) -> None:
    """Write a file under another name first, so that nothing half-written is left behind."""
    place = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        write(place)
        place.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        place.unlink(missing_ok=True)
