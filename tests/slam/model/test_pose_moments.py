"""Moments of weighted poses."""

import numpy as np

from cellslam.sim.frames import wrap_angle
from cellslam.slam.model.pose_moments import pose_moments


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
