"""Dead reckoning's covariance."""

import numpy as np
import pytest

from cellslam.sim.recording import Links, OdometryModel, Sites
from cellslam.slam.api import Setup, Snapshot
from cellslam.slam.dead_reckoning import DeadReckoning


def test_dead_reckoning_covariance_follows_the_data_sheet():
    """Straight drive of 100 s: end deviations from bias and scale have closed forms."""
    zero, none = np.zeros(6), np.zeros(0, np.int64)
    model = OdometryModel(zero, np.array([0, 0, 0, 1e-4, 0, 0]), zero, np.array([0.01, 0, 0, 0, 0, 0]))
    setup = Setup(Links(none, none, none), Sites((), np.zeros(0), np.zeros(0)), model, zero, zero)
    estimator = DeadReckoning()
    estimator.start(setup, np.random.default_rng(0))
    for t in range(1001):
        estimate = estimator.step(
            0.1 if t else 0.0, np.array([1.0, 0, 0, 0, 0, 0]), Snapshot(t, none, none, *np.zeros((4, 0)))
        )
    assert np.sqrt(estimate.covariance[0, 0]) == pytest.approx(0.01 * 100, rel=1e-3)
    assert np.sqrt(estimate.covariance[1, 1]) == pytest.approx(1e-4 * 100**2 / 2, rel=1e-2)
    assert np.sqrt(estimate.covariance[3, 3]) == pytest.approx(1e-4 * 100, rel=1e-6)
