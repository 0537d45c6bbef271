"""External estimators, each in a process of its own (`child_process`), and what that process does (`main`).

What the estimator's process writes comes from anyone's code and is data alone: messages of `answers.encoded`. So the
scoring process imports and unpickles nothing of theirs: numbers arrive, and are checked as every estimator's are.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials.answers import Columns, decoded, encoded, plain_remarks
from cellslam.benchmarks.trials.child_process import POLL_S, START_LIMIT_S, ChildProcess, Limits, connect, shares
from cellslam.benchmarks.trials.estimation import Answer, answers, collected, warm_up
from cellslam.benchmarks.trials.failures import ExternalError, LostError, details, explained
from cellslam.scenarios.estimator_options import Request, loaded
from cellslam.sim.errors import one_line
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording
from cellslam.slam.model.vt_map import VtMap

MOST_PROCESSES = 8  # at a time; beyond, the one that was started first makes room
MOST_ERROR = 10_000
STDERR = 2
PROCESS = "its process"
Replies = Generator[tuple[dict[str, Any], Columns]]


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
        with self._asked(request, None) as replies:
            next(replies)

    def estimate(
        self,
        recording: Recording,
        request: Request,
        rng: np.random.Generator,
        progress: Progress = silent,
        known: VtMap | None = None,
    ) -> TrialResult:
        """Return what an external estimator says about a recording. Raises ExternalError and BadAnswerError.

        It is sent the truth only if it declares to be an oracle. `known`: the map that it begins with.
        """
        shown = recording if request.oracle else replace(recording, truth=None, reference=None, provenance={})
        with self._asked(request, (shown, rng, known)) as replies:
            with progress(f"starting {request.name}", 1):
                next(replies)
            return collected(recording, request, _answers(replies), progress)

    @contextmanager
    def _asked(self, request: Request, drive: Any) -> Iterator[Replies]:
        """Ask for a drive. The process is ended where this does not end well, but for an error that it reported."""
        try:
            yield self._of(request).ask(request, drive)
        except BaseException as error:
            if type(error) is not ExternalError:
                self._end(request.name)
            raise

    def _of(self, request: Request) -> _Process:
        if request.name not in self._alive:
            if len(self._alive) >= MOST_PROCESSES:
                self._end(next(iter(self._alive)))
            self._alive[request.name] = _Process(request.name, self.limits, self.one_thread)
        return self._alive[request.name]

    def _end(self, name: str) -> None:
        self._alive.pop(name).end()


class _Process(ChildProcess):
    """The process of one estimator."""

    def __init__(self, name: str, limits: Limits, one_thread: bool) -> None:
        super().__init__(__name__, limits, one_thread, STDERR, PROCESS)
        self.send((name, sys.path))
        self._started = False

    def ask(self, request: Request, drive: Any) -> Replies:
        """Send options and drive; yield the replies, all within the limit of time. Raises ExternalError."""
        if not self._started:
            self._decoded(time.monotonic() + START_LIMIT_S, START_LIMIT_S)
            self._started = True
        options = None if request.options is None else request.options.model_dump(mode="json")
        self.send((json.dumps(options), drive))
        deadline = time.monotonic() + self.limits.seconds
        while True:
            yield self._decoded(deadline, self.limits.seconds)

    def _decoded(self, deadline: float, limit_s: float) -> tuple[dict[str, Any], Columns]:
        """Return the next reply. Raises ExternalError for an error that it reports, LostError where it is none."""
        message = self.reply(deadline)
        if message is None:
            raise LostError(f"no answer within the time limit of {limit_s:g} s")
        try:
            header, columns = decoded(message)
        except ValueError as error:
            raise LostError(f"{PROCESS} sent {error}") from error
        if "error" in header:
            raise ExternalError(one_line(header["error"], MOST_ERROR), str(header.get("details", "")))
        return header, columns


def _answers(replies: Replies) -> Iterator[Answer]:
    begin = time.perf_counter()
    for header, columns in replies:
        seconds, peak_memory_mb = header.get("seconds"), header.get("peak_memory_mb")
        if not (isinstance(seconds, float) and 0.0 < seconds <= time.perf_counter() - begin + POLL_S):
            raise LostError(f"{PROCESS} sent a time that cannot be")
        if not (isinstance(peak_memory_mb, float) and not peak_memory_mb < 0.0):
            raise LostError(f"{PROCESS} sent a size of memory that cannot be")
        yield Answer(seconds, columns, plain_remarks(header.get("remarks", [])), peak_memory_mb)


def main() -> None:
    """Serve one estimator: its name and the places of modules come first, then options and a drive, again and again."""
    requests, send = connect()

    def reply(header: dict[str, Any], columns: dict[str, Any]) -> None:
        send(encoded(header, columns))

    try:
        reply({}, {})
        name, path = pickle.load(requests)
        sys.path += [place for place in path if place and place not in sys.path]
        while True:
            options, drive = pickle.load(requests)
            _serve(name, options, drive, reply)
    finally:  # nothing that the estimator has left, a thread or a handler, keeps this process
        os._exit(1)


def _serve(name: str, options: str, drive: Any, reply: Callable[..., None]) -> None:
    """Reply when the estimator is compiled, then to each snapshot of a `drive` (recording, generator, map), if any."""
    try:
        request = _request(name, options)
        warm_up(request)
        reply({}, {})
        for answer in answers(drive[0], request, *drive[1:]) if drive is not None else ():
            header = {"seconds": answer.seconds, "remarks": answer.remarks, "peak_memory_mb": answer.peak_memory_mb}
            reply(header, answer.columns)
    except BaseException as error:
        reply({"error": explained(error), "details": details(error)}, {})


@lru_cache(maxsize=64)
def _request(name: str, options: str) -> Request:
    return loaded(name, json.loads(options) or {})
