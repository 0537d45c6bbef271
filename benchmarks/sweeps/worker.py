"""A worker process: takes tasks from the pipe it was started with, answers with results, ends with its parent."""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

# In a worker every library keeps to one thread; set before Python starts, as libraries read it when imported.
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
PARENT_CHECK_S = 1.0


@dataclass(frozen=True)
class Ready:
    """A worker has started, or has done its task."""


def main() -> None:
    """Serve the pipe whose number is the first argument; the second is the limit of memory in bytes."""
    connection, limit_bytes = Connection(int(sys.argv[1])), int(sys.argv[2])
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, limit_bytes))
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    from cellslam.benchmarks.sweeps.tasks import work

    try:
        connection.send(Ready())
        while True:
            for message in work(connection.recv()):
                connection.send(message)
            connection.send(Ready())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        # The parent is gone, or needs this worker no more.
        return


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(PARENT_CHECK_S)
    os._exit(1)


if __name__ == "__main__":
    main()
