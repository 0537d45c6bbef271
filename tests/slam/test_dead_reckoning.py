"""Dead reckoning's covariance."""

from dataclasses import replace

import numpy as np
import pytest

from cellslam.slam.dead_reckoning import DeadReckoning
from tests.slam.fastslam.test_fastslam import make_setup, make_snapshot


def test_dead_reckoning_covariance_follows_the_data_sheet():
    """Straight drive of 100 s: end deviations from bias and scale have closed forms."""
    setup = make_setup()
    model = replace(setup.odometry_model, noise_density=np.zeros(6))
    estimator = DeadReckoning()
    estimator.start(replace(setup, odometry_model=model), np.random.default_rng(0))
    for t in range(1001):
        estimate = estimator.step(0.1 if t else 0.0, np.array([1.0, 0, 0, 0, 0, 0]), make_snapshot(t, []))
    assert np.sqrt(estimate.covariance[0, 0]) == pytest.approx(0.01 * 100, rel=1e-3)
    assert np.sqrt(estimate.covariance[1, 1]) == pytest.approx(1e-4 * 100**2 / 2, rel=1e-2)
    assert np.sqrt(estimate.covariance[3, 3]) == pytest.approx(1e-4 * 100, rel=1e-6)
