"""Moments of weighted poses, and what several estimates know together."""

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.slam.model.pose_moments import known_together, pose_moments


def test_moments_across_the_cut_of_the_angles_are_those_of_the_poses_turned_away_from_it():
    rng = np.random.default_rng(4)
    poses = rng.normal(size=(50, 6)) * [30.0, 30.0, 1.0, 0.3, 0.05, 0.05]
    weights = rng.random(50)
    weights /= weights.sum()
    mean, covariance = pose_moments(poses, weights, poses[7])
    assert np.allclose(mean, np.average(poses, axis=0, weights=weights))
    assert np.allclose(covariance, np.cov(poses.T, aweights=weights, bias=True))
    turned = poses + np.array([0, 0, 0, np.pi, 0, 0])
    turned[:, 3:] = wrap_angle(turned[:, 3:])
    other, same = pose_moments(turned, weights, turned[7])
    assert abs(wrap_angle(other[3] - mean[3] - np.pi)) < 1e-12
    assert -np.pi < other[3] <= np.pi
    assert np.allclose(same, covariance)


def drawn(rng: np.random.Generator, rows: int) -> np.ndarray:
    root = rng.normal(size=(rows, 4))
    return root.T @ root


def test_estimates_from_one_prior_know_together_what_all_measurements_tell():
    rng = np.random.default_rng(6)
    prior, told = drawn(rng, 9), [drawn(rng, rows) for rows in (4, 2, 1)]  # the last ones tell a part of it alone
    each = np.array([np.linalg.inv(np.linalg.inv(prior) + one) for one in told])
    whole = np.linalg.inv(np.linalg.inv(prior) + sum(told))
    np.testing.assert_allclose(known_together(each, prior), whole, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(known_together(np.array([prior, prior]), prior), prior, rtol=1e-6, atol=1e-8)


def test_what_an_estimate_lacks_of_the_prior_counts_for_one_part_in_all():
    rng = np.random.default_rng(7)
    prior, told = drawn(rng, 9), drawn(rng, 4)
    each = np.array([np.linalg.inv(np.linalg.inv(prior) + told), 3.0 * prior])
    whole = np.linalg.inv(np.linalg.inv(each[0]) - (1.0 - 1.0 / 3.0) / 2.0 * np.linalg.inv(prior))
    np.testing.assert_allclose(known_together(each, prior), whole, rtol=1e-6, atol=1e-8)
    ignorant = known_together(np.repeat(1e9 * prior[None], 5, axis=0), prior)
    assert np.all(np.linalg.eigvalsh(ignorant) > 0.0)
