"""Verdicts, against worked numbers of others and against chance."""

from __future__ import annotations

import numpy as np
import pytest

from cellslam.benchmarks.scores.statistics import wilcoxon_p
from cellslam.benchmarks.scores.verdicts import POWER, critical_difference, holm, trials_needed, verdict

# Demsar, J. Machine Learning Research 7, 2006, table 6: AUC of C4.5 on 14 data sets, plain, with parameter m, with
# parameter cf, with both. A fifth decimal in the last but one breaks a tie as there, where ranks come from more digits.
NAMES = ("C4.5", "m", "cf", "m+cf")
AUC = np.array([
    (0.763, 0.768, 0.771, 0.798), (0.599, 0.591, 0.590, 0.569), (0.954, 0.971, 0.968, 0.967),
    (0.628, 0.661, 0.654, 0.657), (0.882, 0.888, 0.886, 0.898), (0.936, 0.931, 0.916, 0.931),
    (0.661, 0.668, 0.609, 0.685), (0.583, 0.583, 0.563, 0.625), (0.775, 0.838, 0.866, 0.875),
    (1.000, 1.000, 1.000, 1.000), (0.940, 0.962, 0.965, 0.962), (0.619, 0.666, 0.614, 0.669),
    (0.972, 0.981, 0.97501, 0.975), (0.957, 0.978, 0.946, 0.970),
])  # fmt: skip


def test_ranks_and_critical_difference_are_those_published() -> None:
    found = verdict({name: -column for name, column in zip(NAMES, AUC.T, strict=True)})
    assert found is not None and found.trials == 14
    assert dict(zip(found.names, found.mean_rank.round(3).tolist(), strict=True)) == {
        "m+cf": 1.964, "m": 2.0, "cf": 2.893, "C4.5": 3.143,
    }  # fmt: skip
    # There without ties 9.28, of three degrees of freedom; SciPy divides by 1 - 78 / 840 for the ties.
    from scipy.stats import chi2

    assert chi2.isf(found.friedman_p, 3) * (1 - 78 / 840) == pytest.approx(9.28, abs=0.005)
    # No more than "the post-hoc test is not powerful enough" there: 3.143 - 1.964 is below 1.25, above 1.12 (at 10 %).
    assert round(found.critical_difference, 2) == 1.25 and round(critical_difference(4, 14, 0.1), 2) == 1.12
    assert found.groups == ((0, 3),)


@pytest.mark.parametrize(
    ("count", "at_5", "at_10"),
    [(2, 1.960, 1.645), (3, 2.343, 2.052), (5, 2.728, 2.459), (7, 2.949, 2.693), (10, 3.164, 2.920)],
)
def test_critical_values_are_those_of_the_published_table(count: int, at_5: float, at_10: float) -> None:
    found = np.array([critical_difference(count, 25), critical_difference(count, 25, 0.1)])
    np.testing.assert_allclose(found / np.sqrt(count * (count + 1) / (6 * 25)), [at_5, at_10], atol=1.5e-3)


def test_holm_multiplies_the_least_by_all_and_never_falls() -> None:
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm([0.9, 0.5]), [1.0, 1.0])
    assert holm([]).tolist() == []


@pytest.mark.slow
def test_chance_tells_a_pair_apart_as_seldom_as_stated() -> None:
    drawn = np.random.default_rng(8)
    seen = [verdict({f"{i}": drawn.normal(size=20) for i in range(5)}) for _ in range(200)]
    wrong = sum(one is not None and one.pairs[0] > 0 for one in seen)
    assert 1 <= wrong <= 19  # 5 % or somewhat less; more than 19 of 200 has a probability of 0.003


def test_a_pair_that_differs_is_told_apart_and_a_failure_is_the_worst() -> None:
    drawn = np.random.default_rng(9)
    hard = drawn.gamma(4.0, size=20)
    scores = {"good": hard, "same": hard * np.exp(0.1 * drawn.normal(size=20)), "bad": 2.0 * hard}
    scores["bad"][:3] = np.inf
    found = verdict(scores)
    assert found is not None and found.names[-1] == "bad" and found.mean_rank[-1] == 3.0
    assert found.pairs == (2, 3) and found.groups == ((0, 1),)
    i, j = found.names.index("good"), found.names.index("bad")
    failed = 2 * max(2 * hard[3:].max(), scores["same"].max())  # twice the worst of all
    expected = np.median(hard - np.append([failed] * 3, 2 * hard[3:]))
    assert found.difference[i, j] == -found.difference[j, i] == pytest.approx(expected)
    assert found.p_value[i, j] == found.p_value[j, i] < 0.001 and found.differ[i, j]
    assert verdict({"good": hard}) is None
    assert verdict({"good": hard[:5], "bad": 2 * hard[:5]}) is None


def test_so_many_trials_find_a_difference_as_often_as_stated() -> None:
    """Of normal differences with a mean of 0.6 deviations; Noether's formula is told the share from many trials."""
    drawn = np.random.default_rng(3)
    needed = trials_needed(0.6 + drawn.normal(size=1500))
    assert 24 <= needed <= 27  # (1.96 + 0.84)^2 / (3 (Phi(0.6 sqrt(2)) - 0.5)^2) = 26
    found = [wilcoxon_p(0.6 + drawn.normal(size=int(needed))) < 0.05 for _ in range(400)]
    assert np.mean(found) == pytest.approx(POWER, abs=0.06)
    assert trials_needed(np.array([-1.0, 1.0])) == np.inf


def test_the_interval_of_a_median_holds_it_as_often_as_stated() -> None:
    drawn, held = np.random.default_rng(4), []
    for _ in range(400):
        found = verdict({"good": np.zeros(20), "bad": drawn.exponential(size=20)})
        assert found is not None
        held.append(found.low[1, 0] < np.log(2.0) < found.high[1, 0])
    assert np.mean(held) == pytest.approx(0.9586, abs=0.03)
    found = verdict({"good": drawn.normal(size=20), "bad": 1.0 + drawn.normal(size=20)})
    assert found is not None
    assert (found.low <= found.difference).all() and (found.difference <= found.high).all()
    np.testing.assert_array_equal(found.low, -found.high.T)
