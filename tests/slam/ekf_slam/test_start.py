"""The start of EKF-SLAM: components of an offset, moments of a Gaussian sum, the fusion of sites."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cellslam.slam.ekf_slam.start.fusion import join
from cellslam.slam.ekf_slam.start.fusion_kernel import fuse, likely, moments, root_of
from cellslam.slam.ekf_slam.start.offset_banks import components


def test_sites_fuse_as_in_one_kalman_filter(kalman: Any) -> None:
    """Two sites that see a static shared state c and their own map: exactly the joint posterior."""
    rng, q = np.random.default_rng(3), np.full(4, 0.5)
    root = rng.normal(size=(4, 3))
    mean, cov, parts = np.zeros(9), np.diag([0.0] * 4 + [9.0] * 2 + [4.0] * 3), []
    mean[:4], cov[:4, :4] = rng.normal(size=4), root @ root.T  # one direction of c is known
    prior_mean, prior_cov = mean, cov
    for rows in (np.r_[0:4, 4:6], np.r_[0:4, 6:9]):
        h, z = np.zeros((4, 9)), rng.normal(size=4)
        h[:, rows] = rng.normal(size=(4, len(rows)))
        own_mean, own_cov, own = prior_mean[rows], prior_cov[np.ix_(rows, rows)], h[:, rows]
        parts.append(kalman(own_mean, own_cov, own, z - own @ own_mean, q)[:2])
        mean, cov, _ = kalman(mean, cov, h, z - h @ mean, q)
    means, covs = np.array([m[:4] for m, _ in parts]), np.array([c[:4, :4] for _, c in parts])
    shared = fuse(prior_mean[:4], prior_cov[:4, :4], means, covs)
    np.testing.assert_allclose(shared[0], mean[:4], atol=1e-8)
    np.testing.assert_allclose(shared[1], cov[:4, :4], atol=1e-8)
    for got, expected in zip(join(shared, parts), (mean, cov), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-8)


def test_root_keeps_uncertain_directions_alone() -> None:
    cov = np.diag([4.0, 0.0, 1e-8, 1.0])[:3, :3]
    root, left = root_of(cov)
    assert root.shape == (3, 2)
    np.testing.assert_allclose(root @ root.T, cov, atol=1e-15)
    np.testing.assert_allclose(left @ root, np.eye(2), atol=1e-12)


def test_moments_and_choice_of_a_gaussian_sum() -> None:
    rng, weight = np.random.default_rng(4), np.array([0.7, 0.299, 0.001])
    x, p, logs = rng.normal(size=(3, 4)), rng.normal(size=(3, 4, 4)), np.log(weight) + 5.0
    p = p @ p.transpose(0, 2, 1)
    mean, cov = moments(logs, x, p, 1, 2)
    want = weight @ x[:, 1:3]
    np.testing.assert_allclose(mean, want, rtol=1e-12)
    second = sum(w * (q[1:3, 1:3] + np.outer(c[1:3], c[1:3])) for w, q, c in zip(weight, p, x, strict=True))
    np.testing.assert_allclose(cov, second - np.outer(want, want), rtol=1e-10)
    x[:, 0], p[:, 0, 0] = [0.0, 10.0, 20.0], 1.0
    assert likely(logs, x, p, 0, np.log(1e-2)).tolist() == [0, 1]
    assert likely(logs, x, p, 0, np.log(1e-4)).tolist() == [0, 1, 2]
    x[:, 0] = [10.2, 10.0, 20.0]
    assert likely(logs, x, p, 0, np.log(1e-4)).tolist() == [0, 2]  # the second is a double of the likelier first


def test_components_add_up_to_the_prior() -> None:
    means, logs, std = components(150.0, 20.0, 1.25)
    weight = np.exp(logs)
    assert std == 20.0
    assert weight.sum() == pytest.approx(1.0)
    assert np.sqrt(weight @ means**2 + std**2) == pytest.approx(150.0, rel=0.02)
    grid = np.linspace(-300, 300, 61)
    mixture = np.exp(-0.5 * ((grid[:, None] - means) / std) ** 2) @ weight / std
    np.testing.assert_allclose(mixture, np.exp(-0.5 * (grid / 150.0) ** 2) / 150.0, rtol=0.08)
    assert len(components(10.0, 20.0, 1.25)[0]) == 1
