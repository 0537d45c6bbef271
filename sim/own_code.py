"""Code of the user's own that a scenario names as module:name, in the place of a part of the world, and its files.

A recording or a store of results is data: code that these name is not loaded, and the file of a detector's constants
not read, unless the user names it again.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from cellslam.sim.errors import InputError, one_line

OWN = r"[\w.]+:\w+"  # how a key names it
FILES = ("radio.statistics_file",)  # keys of files
_LOADED: dict[str, Any] = {}  # what this process was asked for, by name
_READ: set[str] = set()  # files that this process was asked for


def load_own(key: str, name: str) -> Any:
    """Return the object that `name`, module:name, stands for in a scenario's `key`: its module is imported, also from
    the current directory. Raises InputError.
    """
    if name not in _LOADED:
        module, _, attribute = name.partition(":")
        seek_here()
        try:
            _LOADED[name] = getattr(import_module(module), attribute)
        except Exception as error:
            raise InputError(f"{key} '{name}' cannot be loaded: {one_line(error)}") from error
    return _LOADED[name]


def is_loaded(name: str) -> bool:
    """Return whether what a key names is cellslam's own, or was loaded by this process before."""
    return ":" not in name or name in _LOADED


def allow(key: str, name: str) -> None:
    """Load the code that a key names, or let its file be read, as the user asked for it. Raises InputError."""
    if key in FILES:
        _READ.add(name)
    elif ":" in name:
        load_own(key, name)


def is_allowed(key: str, name: str) -> bool:
    """Return whether what a key names is no one's own, or this process was asked for it."""
    return name in _READ or not name if key in FILES else is_loaded(name)


def seek_here() -> None:
    """Let modules of the current directory be found, too, after all others."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)
