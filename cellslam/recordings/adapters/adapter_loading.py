"""From a campaign's own files to a recording, through a Python function that reads them."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cellslam.recordings.importing.campaign import Campaign, build
from cellslam.sim.errors import InputError, nearest_name, one_line
from cellslam.sim.own_code import seek_here
from cellslam.sim.recording import Recording
from cellslam.slam.registry import own_traceback

ADAPTERS = ("victoria-park", "tampere-60ghz", "mrclam", "plaza", "tui", "uwb", "rtt")  # each a module beside this one


def import_adapter(folder: Path, name: str, options: Mapping[str, Any] | None = None) -> Recording:
    """Return what the adapter `name`, a built-in one or `module:function`, makes of `folder`.

    `options` are its keyword-only parameters by name. The current directory is appended to the import path, last.
    Raises InputError with the place in the adapter where it failed.
    """
    function = _adapter(name)
    _known_options(name, function, options or {})
    if not folder.exists():
        raise InputError(f"{folder}: no such folder; give the one with the campaign's files")
    try:
        made = function(folder, **(options or {}))
    except InputError:
        raise
    except Exception as error:
        text = f"{type(error).__name__}: {one_line(error)}{own_traceback(error)}"
        raise InputError(f"adapter '{name}' failed on {folder}: {text}") from error
    recording = build(made) if isinstance(made, Campaign) else made
    if not isinstance(recording, Recording):
        raise InputError(f"adapter '{name}' returned {type(made).__name__}: return a Campaign or a Recording")
    return recording


def _known_options(name: str, function: Callable[..., Any], options: Mapping[str, Any]) -> None:
    parameters = inspect.signature(function).parameters.values()
    known = [parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
    for key in options:
        if key not in known:
            has = f"known: {', '.join(known)}" if known else "it has none"
            raise InputError(f"adapter '{name}' has no option '{key}'{nearest_name(key, known)} ({has})")


def _adapter(name: str) -> Callable[..., Any]:
    built_in = f"cellslam.recordings.adapters.{name.replace('-', '_')}:load"
    module_name, _, function_name = (built_in if name in ADAPTERS else name).partition(":")
    if not (module_name and function_name):
        near = nearest_name(name, ADAPTERS)
        raise InputError(f"unknown adapter '{name}'{near} (known: {', '.join(ADAPTERS)}; your own as module:function)")
    seek_here()
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        text = f"{type(error).__name__}: {one_line(error)}"
        raise InputError(f"adapter '{name}': its module cannot be imported: {text}") from error
    function = getattr(module, function_name, None)
    if not callable(function):
        raise InputError(f"adapter '{name}': {module_name} has no function '{function_name}'")
    return function  # type: ignore[no-any-return]
