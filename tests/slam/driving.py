"""Drives through recordings, for tests that look into an estimator afterwards."""

from __future__ import annotations

from typing import Any

import numpy as np

from cellslam.sim.recording import Recording
from cellslam.slam.api import Estimate, odometry_of, setup_of, snapshots_of


def driven(estimator: Any, recording: Recording, count: int | None = None, **setup: Any) -> list[Estimate]:
    """Start an estimator, with what else `setup` has, and return its answers to the first `count` snapshots."""
    estimator.start(setup_of(recording, **setup), np.random.default_rng(0))
    return go_on(estimator, recording, count)


def go_on(estimator: Any, recording: Recording, count: int | None = None) -> list[Estimate]:
    """Return the answers of an estimator that has been started."""
    dt_s = np.diff(recording.time_s, prepend=recording.time_s[0]).tolist()
    steps = list(zip(dt_s, odometry_of(recording), snapshots_of(recording), strict=True))
    return [estimator.step(*step) for step in steps[:count]]
