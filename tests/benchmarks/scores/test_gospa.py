"""GOSPA by worked numbers, against brute force over all assignments, and as a metric."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from cellslam.benchmarks.scores.map_scores import CUTOFF_M, gospa


def brute_force(truth: np.ndarray, estimate: np.ndarray) -> float:
    """The definition: the best over every subset of pairs, matched or left out."""
    if len(truth) > len(estimate):
        truth, estimate = estimate, truth
    best = np.inf
    for chosen in itertools.permutations([*range(len(estimate)), *[-1] * len(truth)], len(truth)):
        matched = [(i, j) for i, j in enumerate(chosen) if j >= 0]
        unmatched = len(truth) + len(estimate) - 2 * len(matched)
        cost = sum(np.linalg.norm(truth[i] - estimate[j]) ** 2 for i, j in matched)
        best = min(best, cost + CUTOFF_M**2 / 2 * unmatched)
    return best**0.5


@pytest.mark.parametrize("sizes", [(0, 0), (0, 3), (2, 0), (1, 1), (2, 4), (4, 3), (4, 4)])
def test_equals_the_best_of_all_assignments(sizes):
    rng = np.random.default_rng(sum(sizes))
    for _ in range(8):
        truth, estimate = (rng.uniform(0, 40, (n, 3)) for n in sizes)
        assert gospa(cdist(truth, estimate))[0] == pytest.approx(brute_force(truth, estimate), abs=1e-12)


def test_worked_numbers():
    truth = np.array([[0.0, 0, 0], [100, 0, 0], [200, 0, 0]])
    estimate = np.array([[3.0, 4, 0], [100, 12, 0], [230, 0, 0]])
    # 5^2 + 12^2, and the pair 30 m apart counts as one missed and one false: 2 x 20^2 / 2.
    assert gospa(cdist(truth, estimate))[0] == pytest.approx(np.sqrt(25 + 144 + 400))
