"""BP-SLAM: message passing against enumeration; existence."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from cellslam.slam.joint.new_filters import NO_ERRORS
from cellslam.slam.joint.snapshot.association_kernel import FRESH, Messages, believe, pass_messages
from cellslam.slam.joint.state.layout import BELIEF, EXISTS


def enumerated(beta: Any, xi: Any) -> Any:
    """Return the marginals of all assignments, one by one."""
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
    return marginal / total


def passed(beta: Any, xi: Any) -> Any:
    """Return the marginals by message passing."""
    m = Messages(beta, np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), xi)
    pass_messages(m, 3, 3)
    return m.marginal


def test_messages_are_exact_without_loops() -> None:
    beta, xi = np.array([[3.0, 0.5, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.2]]), np.array([0.05, 0.1, 0.0])
    np.testing.assert_allclose(passed(beta, xi), enumerated(beta, xi), atol=1e-7)


def test_messages_are_close_with_loops() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        beta, xi = np.exp(rng.normal(0.0, 2.0, (3, 3))), np.full(3, 0.05)
        marginal = passed(beta, xi)
        np.testing.assert_allclose(marginal, enumerated(beta, xi), atol=0.2)
        assert (marginal.sum(axis=0) <= 1.0 + 1e-6).all()
        assert (marginal.sum(axis=1) <= 1.0 + 1e-6).all()


def test_existence_sinks_with_misses_and_comes_back_with_a_measurement(one_filter: Any) -> None:
    one = one_filter(mode=BELIEF, log_clutter=-12.0, stay=0.9, back=0.05, detection=0.8, drop=1e-3, birth=0.1)
    one.put([3.0, -2.0, 1.5, 0.7, 0.1, -0.2], 5.0, [80.0, 0.5, 0.2])
    one.f.vts.slots[0, 1], one.f.vts.anchor[0, 3:5] = 5, 1.0
    none = one.seen(np.zeros((0, 3)), np.zeros((0, 3)))
    believe(one.f, NO_ERRORS, none, 0, one.w.jacobian, one.w.pairs)
    assert one.f.vts.anchor[0, EXISTS] == pytest.approx(0.9 * 0.2 / (1.0 - 0.9 * 0.8))
    h, _ = one.model(0)
    seen = one.seen(np.array([h, h + np.array([40.0, 0.5, 0.0])]), np.tile([0.3, 1e-4, 2e-4], (2, 1)))
    believe(one.f, NO_ERRORS, seen, 0, one.w.jacobian, one.w.pairs)
    assert one.f.vts.anchor[0, EXISTS] > 0.99
    assert one.w.pairs.slot_of[:2].tolist() == [0, FRESH]
    assert one.w.pairs.exists[1] == pytest.approx(0.1 / 1.1)  # a new feature, or clutter
