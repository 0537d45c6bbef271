"""The assignment solver against every partial assignment."""

import itertools

import numpy as np
import pytest

from cellslam.slam.model.assignment_kernel import assign


def best_by_hand(score: np.ndarray) -> float:
    """Return the greatest total over all partial assignments, by trying each."""
    rows, columns = score.shape
    best = 0.0
    for size in range(min(rows, columns) + 1):
        for chosen in itertools.combinations(range(rows), size):
            for order in itertools.permutations(range(columns), size):
                best = max(best, sum(score[r, c] for r, c in zip(chosen, order, strict=True)))
    return best


def test_association_is_the_best_of_all():
    rng = np.random.default_rng(5)
    for _ in range(300):
        rows, columns = rng.integers(0, 5, 2)
        score = rng.normal(0, 3, (rows, columns))
        score[rng.random((rows, columns)) < 0.3] = -1e300
        row_of = np.empty(columns, np.int64)
        work = 4 * (rows + columns + 2)
        assign(score, rows, columns, row_of, np.empty(work), np.empty(work, np.int64))
        taken = row_of[row_of >= 0]
        assert len(set(taken)) == len(taken)
        total = sum(score[r, c] for c, r in enumerate(row_of) if r >= 0)
        assert total == pytest.approx(best_by_hand(score))
