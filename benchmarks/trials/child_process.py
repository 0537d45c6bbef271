"""What worker processes and estimators' own processes share: limits, how they start, and how they end."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO

# Every library keeps to one thread; set before Python starts, as libraries read it when imported.
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
# Generous: the first start of a day reads everything from the disk.
START_LIMIT_S = 300.0
POLL_S = 0.5
PARENT_CHECK_S = 1.0
TIME_LIMIT_S = 3600.0
LEAST_MEMORY_BYTES = 2 * 2**30
SHARE_OF_MEMORY = 0.9
_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of Linux


@dataclass(frozen=True)
class Limits:
    """What one job may take, its world not counted: seconds, and bytes of memory in its process."""

    seconds: float
    memory_bytes: int


def shares(jobs: int, seconds: float = TIME_LIMIT_S) -> Limits:
    """Return the limits of each of `jobs` processes: a fair share of this machine's memory, at least 2 GiB."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return Limits(seconds, max(LEAST_MEMORY_BYTES, int(SHARE_OF_MEMORY * total / jobs)))


def started(
    module: str, arguments: Sequence[int], fds: Sequence[int], output: IO[bytes] | int, one_thread: bool
) -> subprocess.Popen[bytes]:
    """Start `main()` of a module in a fresh Python; what it prints goes to `output`."""
    # -P: a file of the current directory must not hide a module.
    code = f"from {module} import main; main()"
    return subprocess.Popen(
        [sys.executable, "-P", "-X", "faulthandler", "-c", code, *(str(a) for a in arguments)],
        pass_fds=fds,
        stdin=subprocess.DEVNULL,
        stdout=output,
        stderr=output,
        env={**os.environ, **(ONE_THREAD if one_thread else {}), "OMP_WAIT_POLICY": "PASSIVE"},
        start_new_session=True,
    )


def bind(limit_bytes: int) -> None:
    """Give this process a limit of memory, leave Ctrl-C to its parent, and let it end with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, limit_bytes))
    parent = os.getppid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def ending(process: subprocess.Popen[bytes], what: str) -> str:
    """Return how a process ended that has closed its pipe; one that goes on without is killed."""
    try:
        status = process.wait(timeout=POLL_S)
    except subprocess.TimeoutExpired:
        process.kill()
        return f"{what} closed the connection"
    if status >= 0:
        return f"{what} ended with exit status {status}"
    name = signal.Signals(-status).name
    hint = " (out of memory?)" if name == "SIGKILL" else ""
    return f"{what} was killed by {name}{hint}"


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(PARENT_CHECK_S)
    os._exit(1)
