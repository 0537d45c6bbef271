"""Quasi-random points."""

import numpy as np

from cellslam.sim.randomness import quasi_random


def test_quasi_random_points_fill_the_square_evenly():
    points = quasi_random(1024, 2, np.random.default_rng(0))
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=8, range=[[0, 1], [0, 1]])[0]
    assert counts.min() >= 8
    assert counts.max() <= 24
