"""A supervisor of a child that runs anyone's code: what the child starts ends with it, and it prints only so much.

`supervise` splits a fresh Python in two. The child goes on; the other half, its supervisor, adopts whatever the child
starts and leaves (prctl(2), PR_SET_CHILD_SUBREAPER), passes on what they print, ends them all when the child has ended
or when it is terminated, and then ends as the child did. That is for Linux; elsewhere `end` ends the process group.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

MOST_PRINTED = 2**20  # bytes, some ten thousand lines: nobody reads more, and a disk holds it for each process
LAST_PRINTED = 4_000  # bytes: of more than that the end is passed on too, where a process says why it ended
END_S = 5.0  # for so long processes are killed that start others as fast
_SUBREAPER, _DEATH_SIGNAL = 36, 1  # PR_SET_CHILD_SUBREAPER, PR_SET_PDEATHSIG
_LINUX = sys.platform == "linux"


class _TerminatedError(BaseException):
    pass


def supervise(*pipes: int) -> None:
    """Return in a child of this process, which stays as its supervisor; `pipes` are the child's alone.

    To be called first of all, before there are threads. When this process is killed, its child is, too.
    """
    if not _LINUX:
        return
    prctl = ctypes.CDLL(None).prctl
    prctl(_SUBREAPER, 1, 0, 0, 0)
    prctl(_DEATH_SIGNAL, signal.SIGTERM)
    printed, printing = os.pipe()
    child = os.fork()
    if child == 0:
        prctl(_DEATH_SIGNAL, signal.SIGKILL)
        os.dup2(printing, 2)
        os.close(printed)
        os.close(printing)
        return
    for end in (*pipes, printing):
        os.close(end)
    faulthandler.disable()  # the child has printed its own fault
    passing = threading.Thread(target=_pass_on, args=(printed,), daemon=True)
    passing.start()
    status: int = signal.SIGKILL
    with suppress(_TerminatedError):
        signal.signal(signal.SIGTERM, _terminated)
        while (ended := os.wait())[0] != child:
            pass
        status = ended[1]
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    _end_descendants()
    passing.join(1.0)
    _end_as(os.waitstatus_to_exitcode(status))


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process that supervises, and all that its child has started; it leads a process group of its own."""
    if _LINUX:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(2.0 * END_S)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def memory_bytes(supervisor: int) -> int:
    """Return the memory that a supervisor's child and all that it has started hold, in bytes; 0: not known (no Linux).

    Files that are mapped do not count, and what several processes share counts once.
    """
    total = 0
    for pid in descendants(supervisor):
        with suppress(OSError):
            text = Path(f"/proc/{pid}/smaps_rollup").read_text("ascii")
            total += 1024 * sum(
                int(size) for size in re.findall(r"^Pss_(?:Anon|Shmem):\s*(\d+) kB", text, re.MULTILINE)
            )
    return total


def descendants(root: int) -> list[int]:
    """Return the processes that a process has started, and those that these have; none but on Linux."""
    children: dict[int, list[int]] = {}
    for place in Path("/proc").iterdir() if _LINUX else ():
        with suppress(OSError, IndexError, ValueError):
            pid = int(place.name)
            parent = int((place / "stat").read_bytes().rpartition(b")")[2].split()[1])
            children.setdefault(parent, []).append(pid)
    found = [root]
    for one in found:  # which grows meanwhile
        found += children.get(one, [])
    return found[1:]


def _terminated(*_: object) -> None:
    raise _TerminatedError


def _pass_on(printed: int) -> None:
    """Pass on what the child prints, of more than `MOST_PRINTED` bytes the beginning and the end."""
    passed, left_out, last = 0, 0, b""
    while chunk := os.read(printed, 2**16):
        now = chunk[: MOST_PRINTED - passed]
        with suppress(OSError):
            os.write(2, now)
        passed += len(now)
        left_out += len(chunk) - len(now)
        last = (last + chunk[len(now) :])[-LAST_PRINTED:]
    if left_out:
        with suppress(OSError):
            os.write(2, b"\n... (%d bytes more were printed; the last:)\n" % left_out + last)


def _end_descendants() -> None:
    deadline = time.monotonic() + END_S
    while (left := descendants(os.getpid())) and time.monotonic() < deadline:
        for pid in left:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass


def _end_as(exit_code: int) -> None:
    if exit_code < 0:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if -exit_code != signal.SIGKILL:
            signal.signal(-exit_code, signal.SIG_DFL)
        os.kill(os.getpid(), -exit_code)
    os._exit(exit_code)
