"""How errors count that measurements have in common."""

import numpy as np
import pytest

from cellslam.slam.measurements.readings import crowd, repeats


def test_directions_that_crowd_share_their_error():
    """Two of one direction count double, the third half as close counts for its correlation, far ones not at all."""
    azimuth, elevation = np.radians([10.0, 10.0, 14.0, -170.0]), np.zeros(4)
    near = np.exp(-0.5)
    assert crowd(azimuth, elevation, np.radians(4.0)) == pytest.approx([2 + near, 2 + near, 1 + 2 * near, 1.0])
    assert crowd(np.radians([179.0, -179.0]), np.zeros(2), np.radians(2.0)) == pytest.approx([1 + near, 1 + near])
    assert crowd(np.full(3, np.nan), np.zeros(3), 0.1) == pytest.approx([1.0, 1.0, 1.0])


def test_a_repeated_mean_has_the_variance_that_draws_promises():
    """An error with correlation exp(-x^2 / (2 scale^2)): the mean of n samples varies as std^2 repeats / n."""
    rng = np.random.default_rng(5)
    step, scale, n, runs = 0.05, 0.15, 400, 2000
    lag = step * np.arange(n)
    root = np.linalg.cholesky(np.exp(-((lag[:, None] - lag) ** 2) / (2 * scale**2)) + 1e-9 * np.eye(n))
    means = (root @ rng.standard_normal((n, runs))).mean(axis=0)
    assert means.var() == pytest.approx(repeats(scale, step) / n, rel=0.1)
