"""A worker process: takes tasks from the pipe it was started with, answers with results, ends with its parent."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from multiprocessing.connection import Connection

from cellslam.benchmarks.trials.child_process import Limits, bind


@dataclass(frozen=True)
class Ready:
    """A worker has started, or has done its task."""


def main() -> None:
    """Serve the pipe whose number is the first argument; then come the limits: bytes of memory and milliseconds."""
    number, memory_bytes, milliseconds = (int(word) for word in sys.argv[1:])
    connection = Connection(number)
    bind(memory_bytes)
    from cellslam.benchmarks.sweeps.tasks import work
    from cellslam.benchmarks.trials.external_processes import ExternalProcesses

    try:
        with ExternalProcesses(Limits(1e-3 * milliseconds, memory_bytes), one_thread=True) as external:
            connection.send(Ready())
            while True:
                for message in work(connection.recv(), external):
                    connection.send(message)
                connection.send(Ready())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        # The parent is gone, or needs this worker no more.
        return


if __name__ == "__main__":
    main()
