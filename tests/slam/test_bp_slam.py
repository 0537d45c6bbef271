"""BP-SLAM: message passing against enumeration, soft updates against the mixture they replace, existence, a drive."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from cellslam.slam.bp_slam.bp_slam import BpSlam
from cellslam.slam.conformance import EstimatorConformance
from cellslam.slam.ekf_slam.belief_kernel import pass_messages, soft_update
from cellslam.slam.ekf_slam.state_layout import BELIEF


def enumerated(beta: Any, xi: Any) -> tuple[float, Any]:
    """Return the normaliser and the marginals of all assignments, one by one."""
    rows, columns = beta.shape
    total, marginal = 0.0, np.zeros_like(beta)
    for choice in product(range(-1, columns), repeat=rows):
        used = [c for c in choice if c >= 0]
        if len(set(used)) < len(used):
            continue
        weight = np.prod([beta[r, c] for r, c in enumerate(choice) if c >= 0])
        weight *= np.prod([1.0 + xi[c] for c in range(columns) if c not in used])
        total += weight
        for r, c in enumerate(choice):
            if c >= 0:
                marginal[r, c] += weight
    return total, marginal / total


@pytest.fixture
def passed(one_filter: Any) -> Any:
    """Message passing: the log of the normaliser, and the marginals."""
    w = one_filter(3, mode=BELIEF).w

    def run(beta: Any, xi: Any) -> tuple[float, Any]:
        w.beta[:3, :3], w.xi[:3] = beta, xi
        return pass_messages(w, 3, 3), w.marginal[:3, :3]

    return run


def test_messages_are_exact_without_loops(passed: Any) -> None:
    beta, xi = np.array([[3.0, 0.5, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.2]]), np.array([0.05, 0.1, 0.0])
    value, marginal = passed(beta, xi)
    total, expected = enumerated(beta, xi)
    assert value == pytest.approx(np.log(total), rel=1e-9)
    np.testing.assert_allclose(marginal, expected, atol=1e-7)


def test_messages_are_close_with_loops(passed: Any) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        beta, xi = np.exp(rng.normal(0.0, 2.0, (3, 3))), np.full(3, 0.05)
        value, marginal = passed(beta, xi)
        total, expected = enumerated(beta, xi)
        assert value == pytest.approx(np.log(total), abs=0.25)
        np.testing.assert_allclose(marginal, expected, atol=0.2)
        assert (marginal.sum(axis=0) <= 1.0 + 1e-6).all()
        assert (marginal.sum(axis=1) <= 1.0 + 1e-6).all()


def test_soft_update_has_the_moments_of_the_mixture(one_filter: Any, kalman: Any) -> None:
    """Missed, or one of two measurements: mean and covariance of the three Kalman updates, weighed."""
    one, root = one_filter(1, mode=BELIEF), np.random.default_rng(1).normal(size=(10, 10)) * 0.02
    one.put([3.0, -2.0, 1.5, 0.7, 0.1, -0.2], 5.0, [80.0, 0.5, 0.2])
    one.f.p[:] = root @ root.T
    x, p, (expected, h) = one.f.x.copy(), one.f.p.copy(), one.model(0)
    e = np.array([[0.2, 0.01, -0.02], [-0.5, 0.03, np.nan]])
    q, weight = np.array([[0.3, 1e-4, 2e-4], [0.2, 3e-4, 1.0]]), np.array([0.2, 0.5, 0.3])
    means, covs, _ = zip((x, p, 0.0), *(kalman(x, p, h, *part) for part in zip(e, q, strict=True)), strict=True)
    mean = weight @ np.array(means)
    spread = np.array(means) - mean
    cov = np.tensordot(weight, np.array(covs), axes=1) + (spread * weight[:, None]).T @ spread
    z = expected + e + [[0.0, 2.0 * np.pi, 0.0], [0.0, -2.0 * np.pi, 0.0]]
    lack = soft_update(one.f, one.seen(z, q), 0, 0, weight[1:], one.w)
    np.testing.assert_allclose(one.f.x, mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.f.p, cov, rtol=1e-7, atol=1e-12)
    assert lack == pytest.approx(0.0, abs=1e-12)


class TestBpSlam(EstimatorConformance):
    @pytest.fixture
    def estimator(self) -> type[Any]:
        return BpSlam
