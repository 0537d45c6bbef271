"""An estimator's kernels compiled ahead, in a process of their own, while this one makes the world.

What is compiled comes through Numba's cache on disk. Whatever goes wrong there costs nothing but the time that was to
be saved: the estimator's own `warm_up` compiles what it does not find.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
from collections.abc import Sequence

from cellslam.scenarios.estimator_options import Request

_WARM_UP = "import importlib, sys; getattr(importlib.import_module(sys.argv[1]), sys.argv[2])().warm_up()"
_running: dict[type, subprocess.Popen[bytes]] = {}


def begin(requests: Sequence[Request]) -> None:
    """Start compiling the first estimator that says, by `compiled()`, that nothing of it is in the cache yet."""
    if (os.cpu_count() or 1) < 2:
        return
    for estimator in (r.estimator for r in requests):
        compiled = getattr(estimator, "compiled", None)
        if callable(compiled) and not compiled():
            command = [sys.executable, "-P", "-c", _WARM_UP, estimator.__module__, estimator.__qualname__]
            quiet = subprocess.DEVNULL
            child = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
            _running[estimator] = child
            atexit.register(child.kill)
            return


def finish(estimator: type) -> None:
    """Wait until an estimator that `begin` has started is compiled."""
    child = _running.pop(estimator, None)
    if child is not None:
        child.wait()
        atexit.unregister(child.kill)
