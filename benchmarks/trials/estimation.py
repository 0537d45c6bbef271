"""Driving one estimator over one recording: the runner takes the time, and checks every answer."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellslam.benchmarks.trials import compile_ahead as ahead
from cellslam.benchmarks.trials.trial_result import TrialResult
from cellslam.scenarios.estimator_options import Request
from cellslam.sim.progress import Progress, silent
from cellslam.sim.recording import Floats, Ints, Recording
from cellslam.slam.api import Estimate, Snapshot, VtEstimate, odometry_of, setup_of, snapshots_of

# Waiting OpenMP threads shall sleep: spinning ones made a drive seven times slower on a busy machine. Read when
# the first parallel kernel runs; who sets the variable decides.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

_warm: set[tuple[type[Any], str]] = set()


class BadAnswerError(ValueError):
    """An estimate that breaks the contract of `slam.api`: wrong shape, or not finite."""


def warm_up(request: Request, progress: Progress = silent) -> None:
    """Let an estimator compile, once a process for each class and options. Passes on whatever it raises."""
    key = (request.estimator, repr(request.options))
    if key in _warm:
        return
    estimator = request.estimator(request.options)
    compile_now = getattr(estimator, "warm_up", None)
    if callable(compile_now):
        with progress(f"compiling {request.name} (first use)", 1) as advance:
            ahead.finish(request.estimator)
            compile_now()
            advance(1)
    _warm.add(key)


def estimate(
    recording: Recording, request: Request, rng: np.random.Generator, progress: Progress = silent
) -> TrialResult:
    """Return what the requested estimator says about a recording.

    `estimate_seconds` covers start, steps and finish alone. Raises BadAnswerError, or whatever the estimator
    raises, with the snapshot added to its notes.
    """
    setup, snapshots = setup_of(recording, request.oracle), snapshots_of(recording)
    dt_s = np.diff(recording.time_s, prepend=recording.time_s[0])
    odometry = odometry_of(recording)
    estimator, log = request.estimator(request.options), _Log.of(recording)
    seconds = -time.perf_counter()
    estimator.start(setup, rng)
    seconds += time.perf_counter()
    with progress(request.name, len(snapshots)) as advance:
        for snapshot, dt, velocity in zip(snapshots, dt_s.tolist(), odometry, strict=True):
            try:
                begin = time.perf_counter()
                answer = estimator.step(dt, velocity, snapshot)
                seconds += time.perf_counter() - begin
                log.add(snapshot, answer)
            except Exception as error:
                error.add_note(f"snapshot {snapshot.index}")
                raise
            advance(1)
    begin = time.perf_counter()
    final = estimator.finish() if callable(getattr(estimator, "finish", None)) else None
    seconds += time.perf_counter() - begin
    return log.result(request, final, seconds)


@dataclass
class _Log:
    """The answers so far; optional columns begin when the estimator first gives them."""

    poses: Floats
    covariances: Floats
    measurements: int
    sites: int
    links: int
    association: Ints | None = None
    offset: Floats | None = None
    offset_variance: Floats | None = None
    vts: VtEstimate | None = field(default=None)

    @staticmethod
    def of(recording: Recording) -> _Log:
        count = len(recording.time_s)
        poses, covariances = np.full((count, 6), np.nan), np.full((count, 6, 6), np.nan)
        return _Log(poses, covariances, len(recording.measurements), len(recording.sites), len(recording.links))

    def add(self, snapshot: Snapshot, answer: Estimate) -> None:
        """Copy one answer, checked."""
        if not isinstance(answer, Estimate):
            raise BadAnswerError(f"step returned {type(answer).__name__}, expected cellslam.slam.api.Estimate")
        t = snapshot.index
        self.poses[t] = _checked("pose", answer.pose, (6,))
        self.covariances[t] = _checked("covariance", answer.covariance, (6, 6))
        if answer.association is not None:
            if self.association is None:
                self.association = np.full(self.measurements, -1, np.int64)
            self.association[snapshot.row] = _checked("association", answer.association, (len(snapshot),))
        if answer.clock_offset_m is not None:
            if self.offset is None:
                self.offset = np.full((len(self.poses), self.sites), np.nan)
            self.offset[t] = _checked("clock_offset_m", answer.clock_offset_m, (self.sites,))
        if answer.clock_offset_variance_m2 is not None:
            if self.offset_variance is None:
                self.offset_variance = np.full((len(self.poses), self.sites), np.nan)
            variance = answer.clock_offset_variance_m2
            self.offset_variance[t] = _checked("clock_offset_variance_m2", variance, (self.sites,))
        if answer.vts is not None:
            self.vts = answer.vts

    def result(self, request: Request, final: ArrayLike | None, seconds: float) -> TrialResult:
        """Return everything as one result; `final` replaces the poses."""
        poses = self.poses if final is None else _checked("finish(): poses", final, self.poses.shape)
        return TrialResult(
            estimator=request.name,
            poses=poses,
            covariances=self.covariances,
            association=self.association,
            clock_offset_m=self.offset,
            clock_offset_variance_m2=self.offset_variance,
            vts=None if self.vts is None else _checked_vts(self.vts, self.links),
            smoothed=final is not None,
            oracle=request.oracle,
            estimate_seconds=seconds,
        )


def _checked_vts(vts: VtEstimate, links: int) -> VtEstimate:
    count = len(vts.id)
    link = np.array(_checked("vts.link", vts.link, (count,)), np.int64)
    if ((link < 0) | (link >= links)).any():
        raise BadAnswerError(f"vts.link has a link that is not one of the {links} links")
    return VtEstimate(
        np.array(vts.id, np.int64),
        link,
        _checked("vts.position_m", vts.position_m, (count, 3)),
        _checked("vts.covariance", vts.covariance, (count, 3, 3)),
    )


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
    array = np.array(value)
    if array.shape != shape:
        raise BadAnswerError(f"{name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise BadAnswerError(f"{name} is not finite")
    return array
