"""Estimators with one planted defect each, for the tests of the conformance kit."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from cellslam.sim.recording import Floats
from cellslam.slam.api import Estimate, Setup, Snapshot
from cellslam.slam.dead_reckoning import DeadReckoning


class Sound(DeadReckoning):
    """Dead reckoning with a generator; no defect."""

    name: ClassVar[str] = "sound"

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        super().start(setup, rng)
        self._rng = rng


class GlobalRandom(Sound):
    """Jitters with the global generator."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        answer = super().step(dt_s, odometry, snapshot)
        return replace(answer, pose=answer.pose + 1e-3 * np.random.normal(size=6))  # noqa: NPY002


class OwnSeed(Sound):
    """Jitters with a generator seeded by the time."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        answer = super().step(dt_s, odometry, snapshot)
        jitter = np.random.default_rng(time.perf_counter_ns()).normal(size=6)
        return replace(answer, pose=answer.pose + 1e-3 * jitter)


class NoFreshStart(Sound):
    """Goes on from where the last drive ended."""

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        if not hasattr(self, "_filter"):
            super().start(setup, rng)


class WritesInput(Sound):
    """Sorts the measurements in place."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        snapshot.distance_m.sort()
        return super().step(dt_s, odometry, snapshot)


class GivesItsOwnArrays(Sound):
    """Answers with arrays that the next step overwrites."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        answer = super().step(dt_s, odometry, snapshot)
        if not hasattr(self, "_out"):
            self._out = answer.pose.copy()
        self._out[:] = answer.pose
        return replace(answer, pose=self._out)


class NeedsMeasurements(Sound):
    """Takes the nearest path without asking whether there is one."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        np.argmin(np.nan_to_num(snapshot.distance_m))
        return super().step(dt_s, odometry, snapshot)


class SpreadsNan(Sound):
    """Lets the mean azimuth into the heading."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        answer = super().step(dt_s, odometry, snapshot)
        turn = 1e-9 * snapshot.azimuth_rad.sum()
        return replace(answer, pose=answer.pose + turn)


class TrustsTheOrder(Sound):
    """Takes the first measurement for the line of sight."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        answer = super().step(dt_s, odometry, snapshot)
        first = snapshot.distance_m[:1]
        return replace(answer, pose=answer.pose + 0.05 * np.nan_to_num(first).sum())


class FixedInterval(Sound):
    """Divides by how far the interval is from 0.075 s."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        if dt_s > 0.1:
            raise ValueError("snapshots are 75 ms apart")
        return super().step(dt_s, odometry, snapshot)


class NotPicklable(Sound):
    """Keeps a lambda."""

    def __init__(self, options: Any = None) -> None:
        self.weight = lambda x: x


class StateInTheClass(Sound):
    """Counts its steps in the class."""

    steps = 0

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        type(self).steps += 1
        answer = super().step(dt_s, odometry, snapshot)
        return replace(answer, pose=answer.pose + 1e-9 * type(self).steps)


class BadCovariance(Sound):
    """Subtracts a little too much."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        answer = super().step(dt_s, odometry, snapshot)
        return replace(answer, covariance=answer.covariance - 1e-6 * np.eye(6))


class ClaimsToKnow(Sound):
    """Claims no uncertainty at all."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        return replace(super().step(dt_s, odometry, snapshot), covariance=np.zeros((6, 6)))


class Leaks(Sound):
    """Keeps every snapshot of every drive."""

    seen: ClassVar[list[Snapshot]] = []

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        self.seen.append(snapshot)
        return super().step(dt_s, odometry, snapshot)


class Hoards(Sound):
    """Keeps a big matrix of each snapshot until the next start."""

    def start(self, setup: Setup, rng: np.random.Generator) -> None:
        super().start(setup, rng)
        self._history: list[Floats] = []

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        self._history.append(np.ones((100, 100)))
        return super().step(dt_s, odometry, snapshot)


class GoesAstray(Sound):
    """Turns the wrong way."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        return super().step(dt_s, odometry * [1, 1, 1, -1, 1, 1], snapshot)


class WrongShape(Sound):
    """Gives position and yaw only."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        answer = super().step(dt_s, odometry, snapshot)
        return replace(answer, pose=answer.pose[[0, 1, 3]])


class Nameless(DeadReckoning):
    """Has no name."""

    name: ClassVar[str] = ""


class Raises(Sound):
    """Fails when the drive has begun."""

    def step(self, dt_s: float, odometry: Floats, snapshot: Snapshot) -> Estimate:
        raise KeyError("map")
