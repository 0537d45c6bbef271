"""Estimators with one planted defect each, for the tests of the conformance kit."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.dead_reckoning import DeadReckoning


class Sound(DeadReckoning):
    """Dead reckoning; no defect."""

    name: ClassVar[str] = "sound"


Answering = Callable[[Any, Estimate, float, Snapshot], Estimate]


def spoilt(name: str, answering: Answering) -> type[Sound]:
    """Return an estimator whose answers this function spoils: it gets the estimator, the answer, dt_s and snapshot."""

    def step(self: Sound, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        return answering(self, super(made, self).step(dt_s, odometry, snapshot), dt_s, snapshot)

    # Pickled by its name in this module.
    made = type(name, (Sound,), {"step": step, "__module__": __name__, "steps": 0, "seen": []})
    return made


def moved(answer: Estimate, by: Any) -> Estimate:
    return replace(answer, pose=answer.pose + by)


def _own_arrays(self: Any, answer: Estimate, dt_s: float, snapshot: Snapshot) -> Estimate:
    """Overwrite what was given before."""
    self.__dict__.setdefault("out", answer.pose.copy())[:] = answer.pose
    return replace(answer, pose=self.out)


def _sorts(self: Any, answer: Estimate, dt_s: float, snapshot: Snapshot) -> Estimate:
    snapshot.distance_m.sort()
    return answer


def _counts(self: Any, answer: Estimate, dt_s: float, snapshot: Snapshot) -> Estimate:
    type(self).steps += 1
    return moved(answer, 1e-9 * type(self).steps)


def _keeps(self: Any, answer: Estimate, dt_s: float, snapshot: Snapshot) -> Estimate:
    self.seen.append(snapshot)
    return answer


def _needs(self: Any, answer: Estimate, dt_s: float, snapshot: Snapshot) -> Estimate:
    np.argmin(np.nan_to_num(snapshot.distance_m))
    return answer


def _fixed_interval(self: Any, answer: Estimate, dt_s: float, snapshot: Snapshot) -> Estimate:
    if dt_s > 0.1:
        raise ValueError("snapshots are 75 ms apart")
    return answer


def _raises(self: Any, answer: Estimate, dt_s: float, snapshot: Snapshot) -> Estimate:
    raise KeyError("map")


GlobalRandom = spoilt("GlobalRandom", lambda _, a, dt, s: moved(a, 1e-3 * np.random.normal(size=6)))  # noqa: NPY002
OwnSeed = spoilt(
    "OwnSeed", lambda _, a, dt, s: moved(a, 1e-3 * np.random.default_rng(time.perf_counter_ns()).normal(size=6))
)
WritesInput = spoilt("WritesInput", _sorts)
GivesItsOwnArrays = spoilt("GivesItsOwnArrays", _own_arrays)
NeedsMeasurements = spoilt("NeedsMeasurements", _needs)
SpreadsNan = spoilt("SpreadsNan", lambda _, a, dt, s: moved(a, 1e-9 * s.azimuth_rad.sum()))
TrustsTheOrder = spoilt("TrustsTheOrder", lambda _, a, dt, s: moved(a, 0.05 * np.nan_to_num(s.distance_m[:1]).sum()))
FixedInterval = spoilt("FixedInterval", _fixed_interval)
StateInTheClass = spoilt("StateInTheClass", _counts)
BadCovariance = spoilt("BadCovariance", lambda _, a, dt, s: replace(a, covariance=a.covariance - 1e-6 * np.eye(6)))
ClaimsToKnow = spoilt("ClaimsToKnow", lambda _, a, dt, s: replace(a, covariance=np.zeros((6, 6))))
Leaks = spoilt("Leaks", _keeps)
WrongShape = spoilt("WrongShape", lambda _, a, dt, s: replace(a, pose=a.pose[[0, 1, 3]]))
Raises = spoilt("Raises", _raises)
GoesAstray = spoilt("GoesAstray", lambda _, a, dt, s: moved(a, [0.5 * s.index, 0.0, 0.0, 0.0, 0.0, 0.0]))


class NoFreshStart(Sound):
    """Goes on from where the last drive ended."""

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        if not hasattr(self, "_filter"):
            super().start(setup, rng)


class NotPicklable(Sound):
    """Keeps a lambda."""

    def __init__(self, options: Any = None) -> None:
        self.weight = lambda x: x


class Hoards(Sound):
    """Keeps a big matrix of each snapshot until the next start."""

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        super().start(setup, rng)
        self._history: list[Floats] = []

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        self._history.append(np.ones((100, 100)))
        return super().step(dt_s, odometry, snapshot)


class Nameless(DeadReckoning):
    """Has no name."""

    name: ClassVar[str] = ""
