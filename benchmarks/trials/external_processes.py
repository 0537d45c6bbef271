"""External estimators, each in a process of its own (`child_process`), and what that process does (`main`).

What the estimator's process writes comes from anyone's code and is data alone: messages of `answers.encoded`. So the
scoring process imports and unpickles nothing of theirs: numbers arrive, and are checked as every estimator's are. A
snapshot is sent when the one before it has been answered, and its answer carries its number: that process does not hold
the future, and one answer too many is not taken for the next.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from typing import IO, Any

import numpy as np

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.answers import Columns, decoded, encoded, plain_remarks
from cellslam.benchmarks.trials.child_process import POLL_S, START_LIMIT_S, ChildProcess, Limits, connect, shares
from cellslam.benchmarks.trials.estimation import Answer, answers, collected, requires_future, warm_up
from cellslam.benchmarks.trials.failures import ExternalError, LostError, details, explained
from cellslam.scenarios.estimator_options import Request, loaded
from cellslam.sim import supervisor
from cellslam.sim.errors import one_line
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording
from cellslam.slam.api import Setup, Step, setup_of, steps_of
from cellslam.slam.model.vt_map import VtMap

MOST_PROCESSES = 8  # at a time; beyond, the one that was started first makes room
MOST_ERROR = 10_000
STDERR = 2
PROCESS = "its process"
MEMORY_CHECK_S = 1.0  # to look at the memory of a process and of all that it has started takes milliseconds


class ExternalProcesses:
    """The processes of external estimators, started when first needed. Leaving the context ends them.

    `one_thread`: their libraries keep to one thread.
    """

    def __init__(self, limits: Limits | None = None, one_thread: bool = False) -> None:
        self.limits, self.one_thread = limits or shares(1), one_thread
        self._alive: dict[str, _Process] = {}

    def __enter__(self) -> ExternalProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        for name in list(self._alive):
            self._end(name)

    def begin(self, requests: Sequence[Request]) -> None:
        """Start the process of the first external estimator, while a world is made."""
        for request in [r for r in requests if r.external][:1]:
            self._of(request)

    def warm_up(self, request: Request) -> None:
        """Let an external estimator start and compile. Raises ExternalError."""
        with self._asked(request) as process:
            process.begin(request, driven=False)

    def estimate(
        self,
        recording: Recording,
        request: Request,
        rng: np.random.Generator,
        progress: Progress = silent,
        known: VtMap | None = None,
    ) -> TrialResult:
        """Return what an external estimator says about a recording. Raises ExternalError and BadAnswerError.

        It is sent the truth only if it declares to be an oracle, and snapshots ahead of time only if it declares to
        need the future. `known`: the map that it begins with.
        """
        with self._asked(request) as process:
            with progress(f"starting {request.name}", 1):
                future = process.begin(request, driven=True)
            setup = setup_of(recording, request.oracle, known, future)
            return collected(recording, request, process.answers(setup, steps_of(recording), rng), progress)

    @contextmanager
    def _asked(self, request: Request) -> Iterator[_Process]:
        """Give the process. It is ended where this does not end well, but for an error that it reported."""
        try:
            yield self._of(request)
        except BaseException as error:
            if type(error) is not ExternalError:
                self._end(request.target)
            raise

    def _of(self, request: Request) -> _Process:
        if request.target not in self._alive:
            if len(self._alive) >= MOST_PROCESSES:
                self._end(next(iter(self._alive)))
            self._alive[request.target] = _Process(request.target, self.limits, self.one_thread)
        return self._alive[request.target]

    def _end(self, name: str) -> None:
        self._alive.pop(name).end()


class _Process(ChildProcess):
    """The process of one estimator."""

    def __init__(self, target: str, limits: Limits, one_thread: bool) -> None:
        super().__init__(__name__, limits, one_thread, STDERR, PROCESS)
        self.send((target, sys.path))
        self._started, self._memory_check = False, 0.0
        self._deadline, self._limit_s = time.monotonic() + START_LIMIT_S, START_LIMIT_S

    def begin(self, request: Request, driven: bool) -> bool:
        """Let the estimator be loaded and compiled; return whether it declares to need the future. Its time begins.

        `driven`: a drive follows. Raises ExternalError.
        """
        if not self._started:
            self._decoded()
            self._started = True
        self._deadline, self._limit_s = time.monotonic() + self.limits.seconds, self.limits.seconds
        options = None if request.options is None else request.options.model_dump(mode="json")
        self.send((json.dumps(options), driven))
        header, _ = self._decoded()
        return header.get("requires_future") is True

    def answers(self, setup: Setup, steps: Sequence[Step], rng: np.random.Generator) -> Iterator[Answer]:
        """Send a drive step by step, and yield the answer to each and that of the end. Raises ExternalError."""
        begin = time.perf_counter()
        self.send((setup, rng))
        for t, step in enumerate((*steps, None)):
            self.send(step)
            header, columns = self._decoded()
            if header.get("snapshot") != t:
                raise LostError(f"{PROCESS} sent an answer out of turn, where that of snapshot {t} was expected")
            seconds, peak_memory_mb = header.get("seconds"), header.get("peak_memory_mb")
            if not (isinstance(seconds, float) and 0.0 < seconds <= time.perf_counter() - begin + POLL_S):
                raise LostError(f"{PROCESS} sent a time that cannot be")
            if not (isinstance(peak_memory_mb, float) and not peak_memory_mb < 0.0):
                raise LostError(f"{PROCESS} sent a size of memory that cannot be")
            yield Answer(seconds, columns, plain_remarks(header.get("remarks", [])), peak_memory_mb)

    def _decoded(self) -> tuple[dict[str, Any], Columns]:
        """Return the next reply. Raises ExternalError for an error that it reports, LostError where it is none."""
        while (message := self.reply(min(self._deadline, time.monotonic() + MEMORY_CHECK_S))) is None:
            if time.monotonic() >= self._deadline:
                raise LostError(f"no answer within the time limit of {self._limit_s:g} s")
            self._check_memory()
        self._check_memory()
        try:
            header, columns = decoded(message)
        except ValueError as error:
            raise LostError(f"{PROCESS} sent {error}") from error
        if "error" in header:
            raise ExternalError(one_line(header["error"], MOST_ERROR), str(header.get("details", "")))
        return header, columns

    def _check_memory(self) -> None:
        """Raise LostError where the process and all that it has started hold more memory than they may."""
        if time.monotonic() < self._memory_check:
            return
        held, most = supervisor.memory_bytes(self.process.pid), self.limits.memory_bytes
        if held > most:
            gib = f"{held / 2**30:.2f} GiB of memory, the limit is {most / 2**30:.3g} GiB"
            raise LostError(f"{PROCESS} and what it has started hold {gib}")
        self._memory_check = time.monotonic() + MEMORY_CHECK_S


def main() -> None:
    """Serve one estimator: its target and the places of modules come first, then options and a drive, repeatedly."""
    requests, send = connect()

    def reply(header: dict[str, Any], columns: dict[str, Any]) -> None:
        send(encoded(header, columns))

    try:
        reply({}, {})
        target, path = pickle.load(requests)
        sys.path += [place for place in path if place and place not in sys.path]
        while True:
            options, driven = pickle.load(requests)
            _serve(target, options, requests if driven else None, reply)
    finally:  # nothing that the estimator has left, a thread or a handler, keeps this process
        os._exit(1)


def _serve(target: str, options: str, drive: IO[bytes] | None, reply: Callable[..., None]) -> None:
    """Reply when the estimator is compiled, then to each step of a `drive` as it comes: setup and generator first,
    None after the last."""
    try:
        request = _request(target, options)
        warm_up(request)
        reply({"requires_future": requires_future(request)}, {})
        if drive is None:
            return
        setup, rng = pickle.load(drive)
        steps = iter(partial(pickle.load, drive), None)
        for t, answer in enumerate(answers(setup, steps, request, rng)):
            header = {"seconds": answer.seconds, "remarks": answer.remarks, "peak_memory_mb": answer.peak_memory_mb}
            reply({"snapshot": t, **header}, answer.columns)
    except BaseException as error:
        reply({"error": explained(error), "details": details(error)}, {})


@lru_cache(maxsize=64)
def _request(target: str, options: str) -> Request:
    return loaded(target, {target: json.loads(options) or {}})
