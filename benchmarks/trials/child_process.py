"""Processes that this one starts: the workers of a sweep, and those of external estimators.

`ChildProcess` is the end that starts, limits and ends one; `connect` is the child's own end. Requests come from
cellslam and go to the child pickled. What the child replies may be made by anyone's code: messages of bytes, each after
its length in eight bytes; the caller knows what they mean. A buffer holds a message that has arrived in part, since to
wait for the rest could take longer than the limit of time.
"""

from __future__ import annotations

import os
import pickle
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import IO, Any

from cellslam.benchmarks.trials.failures import LostError
from cellslam.sim import supervisor

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
MOST_BYTES = 2**26  # of one message
MOST_READ = 2**20


@dataclass(frozen=True)
class Limits:
    """What one job may take, its world not counted: seconds, and bytes of memory in its process and all that this
    starts."""

    seconds: float
    memory_bytes: int


def shares(jobs: int, seconds: float = TIME_LIMIT_S) -> Limits:
    """Return the limits of each of `jobs` processes: a fair share of this machine's memory, at least 2 GiB."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return Limits(seconds, max(LEAST_MEMORY_BYTES, int(SHARE_OF_MEMORY * total / jobs)))


class ChildProcess:
    """A fresh Python that runs `main()` of a module, supervised; what it prints goes to `output`, `name` is for
    messages."""

    def __init__(self, module: str, limits: Limits, one_thread: bool, output: IO[bytes] | int, name: str) -> None:
        self.limits, self.name = limits, name
        self._arrived, self._writing = bytearray(), threading.Thread()
        requests, self._requests = os.pipe()
        self._replies, replies = os.pipe()
        supervised = f"from cellslam.sim.supervisor import supervise; supervise({requests}, {replies})"
        self.process = subprocess.Popen(
            # -P: a file of the current directory must not hide a module.
            [sys.executable, "-P", "-X", "faulthandler", "-c", f"{supervised}; from {module} import main; main()",
             str(requests), str(replies), str(limits.memory_bytes)],
            stdin=subprocess.DEVNULL, stdout=output, stderr=output, pass_fds=(requests, replies),
            env={**os.environ, **(ONE_THREAD if one_thread else {}), "OMP_WAIT_POLICY": "PASSIVE"},
            start_new_session=True,
        )  # fmt: skip
        os.close(requests)
        os.close(replies)

    def fileno(self) -> int:
        """Return the pipe of the replies, to wait for several processes."""
        return self._replies

    def send(self, request: Any) -> None:
        """Send a request, once the one before it is sent. That the process has ended is noticed by its `reply`."""
        if self._writing.ident is not None:
            self._writing.join()
        message = pickle.dumps(request)
        if len(message) <= select.PIPE_BUF and select.select([], [self._requests], [], 0.0)[1]:  # the pipe has room
            _write(self._requests, message)
            return
        # In a thread: a process that does not read must not keep this one.
        self._writing = threading.Thread(target=_write, args=(self._requests, message), daemon=True)
        self._writing.start()

    def reply(self, deadline: float) -> bytes | None:
        """Return the next reply, None where it has not arrived by `deadline` on the monotonic clock.

        Raises LostError where the process has ended, or sends what is no message.
        """
        while (message := self._message()) is None:
            left, ended = deadline - time.monotonic(), self.process.poll() is not None
            if wait([self._replies], min(max(left, 0.0), POLL_S)):
                chunk = os.read(self._replies, MOST_READ)
                if not chunk:
                    raise LostError(self._ending())
                self._arrived += chunk
            elif ended:  # a process that it has started holds the pipe
                raise LostError(self._ending())
            if left <= 0.0:
                return self._message()
        return message

    def end(self) -> None:
        """End the process at once, and all that it has started."""
        supervisor.end(self.process)
        os.close(self._replies)
        if self._writing.ident is not None:
            self._writing.join(POLL_S)
        if not self._writing.is_alive():
            os.close(self._requests)

    def _message(self) -> bytes | None:
        """Return the next message, None where it has not arrived whole."""
        size = int.from_bytes(self._arrived[:8], "little")
        if size > MOST_BYTES:
            raise LostError(f"{self.name} sent what is no answer, or one of more than {MOST_BYTES} bytes")
        if len(self._arrived) < 8 + size:
            return None
        message = bytes(self._arrived[8 : 8 + size])
        del self._arrived[: 8 + size]
        return message

    def _ending(self) -> str:
        """Return how the process ended that has closed its pipe; one that goes on without is killed."""
        try:
            status = self.process.wait(timeout=POLL_S)
        except subprocess.TimeoutExpired:
            self.process.terminate()
            return f"{self.name} closed the connection"
        if status >= 0:
            return f"{self.name} ended with exit status {status}"
        signalled = signal.Signals(-status).name
        hint = " (out of memory?)" if signalled == "SIGKILL" else ""
        return f"{self.name} was killed by {signalled}{hint}"


def _write(pipe: int, message: bytes) -> None:
    rest = memoryview(message)
    with suppress(OSError):
        while rest:
            rest = rest[os.write(pipe, rest) :]


def connect() -> tuple[IO[bytes], Callable[[bytes], None]]:
    """Return the requests of this process, a child, and a function that replies.

    It gets its limit of memory, leaves Ctrl-C to its parent, and ends with its parent.
    """
    requests, replies = os.fdopen(int(sys.argv[1]), "rb"), os.fdopen(int(sys.argv[2]), "wb")
    limit_bytes, parent = int(sys.argv[3]), os.getppid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, limit_bytes))
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()

    def reply(message: bytes) -> None:
        replies.write(len(message).to_bytes(8, "little") + message)
        replies.flush()

    return requests, reply


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(PARENT_CHECK_S)
    os._exit(1)
