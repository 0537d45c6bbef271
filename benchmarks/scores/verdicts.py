"""Which estimators differ in the same trials: ranks, their critical difference, and a test of every pair.

Sources: Demsar, "Statistical comparisons of classifiers over multiple data sets", J. Machine Learning Research 7, 2006
(Friedman's test, Nemenyi's critical difference); Holm, "A simple sequentially rejective multiple test procedure",
Scandinavian J. Statistics 6, 1979; Noether, "Sample size determination for some common nonparametric tests", J.
American Statistical Association 82, 1987; Wilcoxon's signed-rank test as in `statistics`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from cellslam.benchmarks.scores.statistics import wilcoxon_p
from cellslam.sim.recording import Floats

LEVEL = 0.05  # of all tests
LEAST_TRIALS = 6  # with five, no pair can differ at that level
POWER = 0.8  # with which a difference is to be found


@dataclass(frozen=True)
class Verdict:
    """How k estimators compare over n trials, the best mean rank first.

    `mean_rank` (k,): 1 is the best in every trial. `friedman_p`: of all being equally good; NaN below three estimators.
    `critical_difference`: what two mean ranks must differ by, by Nemenyi's test. `difference` (k, k): median of row
    minus column in the scores' unit, with its 95 % interval from `low` to `high` (k, k), between two order statistics:
    it holds for every distribution. `p_value` (k, k): Wilcoxon's
    test of the pair, corrected for all pairs by Holm's method; 1 on the diagonal. `trials_needed` (k, k): how many
    trials would show, with `POWER`, a pair that differs as it does here.
    """

    names: tuple[str, ...]
    trials: int
    mean_rank: Floats
    friedman_p: float
    critical_difference: float
    difference: Floats
    low: Floats
    high: Floats
    p_value: Floats
    trials_needed: Floats

    @property
    def differ(self) -> NDArray[np.bool_]:
        """Which pairs (k, k) differ significantly by Wilcoxon's tests."""
        return np.asarray(self.p_value < LEVEL)

    @property
    def pairs(self) -> tuple[int, int]:
        """How many pairs differ significantly, and how many there are."""
        return int(self.differ.sum()) // 2, math.comb(len(self.names), 2)

    @property
    def groups(self) -> tuple[tuple[int, int], ...]:
        """The first and last of each run of estimators whose mean ranks are within the critical difference."""
        far = self.mean_rank + self.critical_difference
        ends = [int(np.searchsorted(self.mean_rank, end, "right")) - 1 for end in far.tolist()]
        return tuple((i, end) for i, end in enumerate(ends) if end > i and (i == 0 or end > ends[i - 1]))


def verdict(scores: Mapping[str, Floats]) -> Verdict | None:
    """Return the verdict on the scores (n,) of each estimator in the same n trials, in any unit, the least the best.

    A score that is not finite, of a trial that failed, is worse than all others. None: fewer than two estimators or
    six trials, which cannot differ.
    """
    if len(scores) < 2 or len(next(iter(scores.values()))) < LEAST_TRIALS:
        return None
    from scipy.stats import friedmanchisquare, quantile_test, rankdata

    table = _failed_last(np.stack([np.asarray(column, np.float64) for column in scores.values()], axis=1))
    ranks = rankdata(table, axis=1).mean(axis=0)
    order = np.argsort(ranks, kind="stable")
    table, ranks = table[:, order], ranks[order]
    trials, count = table.shape
    between = [table[:, i] - table[:, j] for i, j in combinations(range(count), 2)]
    corrected = holm([wilcoxon_p(one) for one in between])
    p_value, needed = np.ones((count, count)), np.full((count, count), np.inf)
    difference, low, high = np.zeros((3, count, count))
    for (i, j), one, p in zip(combinations(range(count), 2), between, corrected, strict=True):
        p_value[i, j] = p_value[j, i] = p
        needed[i, j] = needed[j, i] = trials_needed(one)
        ends: Any = quantile_test(one).confidence_interval(1.0 - LEVEL)
        difference[i, j], low[i, j], high[i, j] = np.median(one), ends.low, ends.high
        difference[j, i], low[j, i], high[j, i] = -difference[i, j], -high[i, j], -low[i, j]
    friedman_p = float(friedmanchisquare(*table.T).pvalue) if count > 2 else float("nan")
    names = tuple(np.array(list(scores))[order].tolist())
    far = critical_difference(count, trials)
    return Verdict(names, trials, ranks, friedman_p, far, difference, low, high, p_value, needed)


def trials_needed(difference: Floats) -> float:
    """Return in how many trials Wilcoxon's test finds, with probability `POWER`, what differs as these do (n,), in any
    unit: by Noether's formula, from the share of pairs of trials whose mean difference is above zero."""
    i, j = np.triu_indices(len(difference), 1)
    above = np.mean(np.heaviside(difference[i] + difference[j], 0.5))
    quantiles = ndtri(1.0 - LEVEL / 2.0) + ndtri(POWER)
    return float(np.ceil(quantiles**2 / (3.0 * (above - 0.5) ** 2))) if above != 0.5 else math.inf


def critical_difference(count: int, trials: int, level: float = LEVEL) -> float:
    """Return by how much the mean ranks of two of `count` estimators over `trials` must differ (Nemenyi's test)."""
    from scipy.stats import studentized_range

    quantile = float(studentized_range.ppf(1.0 - level, count, np.inf)) / math.sqrt(2.0)
    return quantile * math.sqrt(count * (count + 1) / (6.0 * trials))


def holm(p_values: Sequence[float]) -> Floats:
    """Return p-values (m,) corrected for being m: below a level with a probability of that level, if all are chance."""
    p = np.asarray(p_values, np.float64)
    order = np.argsort(p)
    corrected = np.empty(len(p))
    corrected[order] = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return np.minimum(corrected, 1.0)


def _failed_last(table: Floats) -> Floats:
    fine = np.isfinite(table)
    worst = 2.0 * float(np.max(np.abs(table), where=fine, initial=1.0))
    return np.where(fine, table, worst)
