"""Driving one estimator over one recording: the runner takes the time, and checks every answer."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from cellslam.benchmarks.scores.trial_result import TrialResult
from cellslam.benchmarks.trials import memory
from cellslam.benchmarks.trials.answers import (
    BadAnswerError,
    Columns,
    Log,
    calibration_of,
    checked,
    numbers,
    plain,
    plain_calibration,
    plain_remarks,
)
from cellslam.scenarios.estimator_options import Request
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Recording
from cellslam.slam.api import Setup, Step, setup_of, steps_of
from cellslam.slam.model.vt_map import VtMap

# Waiting OpenMP threads shall sleep: spinning ones made a drive seven times slower on a busy machine. Read when
# the first parallel kernel runs; who sets the variable decides.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

_WARM_UP = "import importlib, sys; getattr(importlib.import_module(sys.argv[1]), sys.argv[2])().warm_up()"
_warm: set[tuple[type[Any], str]] = set()
_compiling: dict[type[Any], subprocess.Popen[bytes]] = {}


@dataclass(frozen=True)
class Answer:
    """Plain copies of one answer; `seconds`: what the estimator has taken since its start. The last is of the end, with
    the estimator's remarks, `peak_memory_mb` and the map that it leaves, which no other process sends."""

    seconds: float
    columns: Columns
    remarks: Sequence[str] = ()
    peak_memory_mb: float = float("nan")
    vt_map: VtMap | None = None


def compile_ahead(requests: Sequence[Request]) -> None:
    """Start to compile the first estimator that says, by `compiled()`, that nothing of it is in Numba's cache on disk.

    That takes a process of its own while this one makes the world. Whatever goes wrong there costs nothing but the time
    that was to be saved: `warm_up` waits for it, and compiles what it does not find.
    """
    if (os.cpu_count() or 1) < 2:
        return
    for estimator in (request.estimator for request in requests):
        compiled = getattr(estimator, "compiled", None)
        if callable(compiled) and not compiled():
            command = [sys.executable, "-P", "-c", _WARM_UP, estimator.__module__, estimator.__qualname__]
            quiet = subprocess.DEVNULL
            child = _compiling[estimator] = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
            atexit.register(child.kill)
            return


def warm_up(request: Request, progress: Progress = silent) -> None:
    """Let an estimator compile, once a process for each class and options. Passes on whatever it raises."""
    key = (request.estimator, repr(request.options))
    if key in _warm:
        return
    estimator = request.estimator(request.options)
    compile_now = getattr(estimator, "warm_up", None)
    if callable(compile_now):
        with progress(f"compiling {request.name}, once per machine", 1) as advance:
            if (child := _compiling.pop(request.estimator, None)) is not None:
                child.wait()
                atexit.unregister(child.kill)
            compile_now()
            advance(1)
    _warm.add(key)


def estimate(
    recording: Recording,
    request: Request,
    rng: np.random.Generator,
    progress: Progress = silent,
    known: VtMap | None = None,
) -> TrialResult:
    """Return what the requested estimator, compiled and driven in this process, says about a recording; `known`: the
    map that it begins with.

    `estimate_seconds` covers start, steps and finish alone, `peak_memory_mb` what is kept of the answers too. Raises
    BadAnswerError, or whatever the estimator raises, with the snapshot added to its notes.
    """
    warm_up(request, progress)
    setup = setup_of(recording, request.oracle, known, requires_future(request))
    return collected(recording, request, answers(setup, steps_of(recording), request, rng), progress)


def requires_future(request: Request) -> bool:
    """Return whether an estimator that is loaded in this process declares that it needs the whole drive beforehand."""
    return bool(getattr(request.estimator, "requires_future", False))


def answers(setup: Setup, steps: Iterable[Step], request: Request, rng: np.random.Generator) -> Iterator[Answer]:
    """Drive an estimator in this process: yield its answer to each step, then those of `finish`, `calibration`,
    `vt_map` and `remarks`, if any."""
    coming = iter(steps)
    first = next(coming)  # whatever goes wrong from here on is the answer to a step
    before = memory.begin()
    estimator = request.estimator(request.options)
    seconds = -time.perf_counter()
    estimator.start(setup, rng)
    seconds += time.perf_counter()
    for dt_s, odometry, snapshot in chain([first], coming):
        index = snapshot.index
        try:
            begin = time.perf_counter()
            answer = estimator.step(dt_s, odometry, snapshot)
            seconds += time.perf_counter() - begin
            columns = plain(answer)
        except BaseException as error:
            error.add_note(f"snapshot {index}")
            raise
        yield Answer(seconds, columns)
    begin = time.perf_counter()
    final = _optional(estimator, "finish")
    seconds += time.perf_counter() - begin
    columns = {} if final is None else {"finish": numbers("finish(): poses", final)}
    columns |= plain_calibration(_optional(estimator, "calibration"))
    lines, left = plain_remarks(_optional(estimator, "remarks", ())), _optional(estimator, "vt_map")
    yield Answer(seconds, columns, lines, memory.grown_mb(before), left)


def _optional(estimator: Any, method: str, otherwise: Any = None) -> Any:
    """Return what a method of an estimator returns that need not be there."""
    found = getattr(estimator, method, None)
    return found() if callable(found) else otherwise


def collected(
    recording: Recording, request: Request, given: Iterator[Answer], progress: Progress = silent
) -> TrialResult:
    """Return the answers to all snapshots as one result, checked. Raises BadAnswerError."""
    log = Log(recording)
    with progress(request.name, log.count) as advance:
        for t in range(log.count):
            answer = next(given)
            try:
                log.add(t, answer.columns)
            except BadAnswerError as error:
                error.add_note(f"snapshot {t}")
                raise
            advance(1)
    last = next(given)
    final, columns = last.columns.get("finish"), log.columns
    log.check()
    return TrialResult(
        estimator=request.name,
        poses=columns["pose"] if final is None else checked("finish(): poses", final, (log.count, 6)),
        covariances=columns["covariance"],
        association=columns.get("association"),
        clock_offset_m=columns.get("clock_offset_m"),
        clock_offset_variance_m2=columns.get("clock_offset_variance_m2"),
        **log.maps,
        smoothed=final is not None,
        oracle=request.oracle,
        calibration=calibration_of(last.columns),
        vt_map=last.vt_map,
        remarks=tuple(last.remarks),
        estimate_seconds=last.seconds,
        peak_memory_mb=last.peak_memory_mb,
    )
