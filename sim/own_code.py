"""Code of the user's own that a scenario names as module:name, in the place of a part of the world.

A recording or a store of results is data: code that these name is not loaded, unless the user names it again.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from cellslam.sim.errors import InputError, one_line

OWN = r"[\w.]+:\w+"  # how a key names it
_LOADED: dict[str, Any] = {}  # what this process was asked for, by name


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


def seek_here() -> None:
    """Let modules of the current directory be found, too, after all others."""
    here = str(Path.cwd())
    if here not in sys.path and "" not in sys.path:
        sys.path.append(here)
