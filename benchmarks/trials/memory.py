"""The memory that this process holds, and how much an estimator makes it grow."""

from __future__ import annotations

import ctypes
import re
import resource
import sys
from pathlib import Path

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_CLEAR_PEAK = "5"  # to `clear_refs`: the peak becomes what is resident now (Linux, proc(5))


def peak_bytes() -> int:
    """Return the largest resident memory that this process has had, on Linux since the last `begin`.

    Linux tells it apart from that of a parent, which `ru_maxrss` starts at.
    """
    if _STATUS.exists() and (found := _status_bytes("VmHWM")) is not None:
        return found
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def begin() -> int | None:
    """Begin to watch the peak of this process's memory; return what is resident now, in bytes, for `grown_mb`.

    What was freed goes back to the system first, as memory that is used again would not be seen. None: this system
    cannot say (it is not Linux).
    """
    if sys.platform != "linux":
        return None
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    try:
        _CLEAR.write_text(_CLEAR_PEAK)
    except OSError:
        return None
    return _status_bytes("VmRSS")


def grown_mb(before: int | None) -> float:
    """Return by how many megabytes resident memory grew at the most since `begin`; NaN: not known.

    Compiled code and libraries that were loaded before do not count, nor does what libraries keep for themselves and
    use again: a small estimator may need none.
    """
    return float("nan") if before is None else max(0, peak_bytes() - before) / 1e6


def _status_bytes(key: str) -> int | None:
    found = re.search(rf"^{key}:\s*(\d+) kB", _STATUS.read_text(), re.MULTILINE)
    return None if found is None else int(found[1]) * 1024
