"""Statistics checked by their own statistics: fixed seeds, false alarms below 1e-5 unless said otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, norm

from cellslam.benchmarks.scores import statistics as s
from cellslam.sim.errors import InputError

SIGMA = 0.35
TRUTH = {
    "median": 1.0,
    "mean": np.exp(SIGMA**2 / 2),
    "rmse": np.exp(SIGMA**2),
    "q25": np.exp(norm.ppf(0.25) * SIGMA),
    "share>1.5": norm.sf(np.log(1.5) / SIGMA),
}


def coverage(name: str, count: int, repetitions: int, monkeypatch: pytest.MonkeyPatch) -> float:
    """Return how often the 95 % interval holds the truth: lognormal samples."""
    monkeypatch.setattr(s, "RESAMPLES", 499)
    rng, of = np.random.default_rng(11), s.statistic(name)
    inside = 0
    for _ in range(repetitions):
        low, high = s.interval(np.exp(SIGMA * rng.standard_normal(count)), of, 0.95)
        inside += low <= TRUTH[name] <= high
    return inside / repetitions


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUTH)
def test_bootstrap_intervals_cover(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Of 1000 intervals, 93 to 97 % hold the truth: an interval that covers 95 % fails this in 0.4 % of all seeds.
    assert 0.93 <= coverage(name, 100, 1000, monkeypatch) <= 0.97


def test_efficiency_ratio_is_of_mean_squares_and_its_interval_covers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors of few degrees of freedom about a bound: an efficient filter has 1, where its median ratio has 0.79."""
    assert s.efficiency_ratio(np.array([1.0, 3.0]), np.array([1.0, 2.0]), 0.95)[0] == pytest.approx(np.sqrt(2.0))
    assert np.isnan(s.efficiency_ratio(np.zeros(0), np.zeros(0), 0.95)).all()
    alike = np.linspace(0.5, 1.5, 10)  # as the bound to itself
    assert s.efficiency_ratio(alike, alike, 0.95) == pytest.approx((1.0, 1.0, 1.0))
    assert s.efficiency_ratio(3.0 * alike, alike, 0.95) == pytest.approx((3.0, 3.0, 3.0))
    monkeypatch.setattr(s, "RESAMPLES", 499)
    rng, inside, medians, repetitions = np.random.default_rng(14), 0, [], 400
    for _ in range(repetitions):
        bound = 0.6 + 0.1 * rng.random(60)
        error = bound * np.sqrt(rng.exponential(size=60))
        _, low, high = s.efficiency_ratio(error, bound, 0.95)
        inside += low <= 1.0 <= high
        medians.append(np.median(error / bound))
    assert 0.92 <= inside / repetitions <= 0.975
    assert 0.79 < np.mean(medians) < 0.87


@pytest.mark.slow
def test_paired_test_has_the_false_alarm_rate_it_states() -> None:
    rng, repetitions = np.random.default_rng(12), 2000
    alarms = 0
    for _ in range(repetitions):
        world = rng.normal(0, 5, 30)
        p_value = s.wilcoxon_p(world + rng.normal(size=30) - (world + rng.normal(size=30)))
        alarms += p_value < 0.05
    low, high = binom.ppf([5e-6, 1 - 5e-6], repetitions, 0.05)
    assert low <= alarms <= high


def test_paired_differences_see_what_means_hide() -> None:
    rng = np.random.default_rng(13)
    world = rng.normal(0, 50, 40)
    found = s.paired(world + 1 + 0.5 * rng.normal(size=40), world)
    assert found.pairs == 40 and found.median_difference == pytest.approx(1.0, abs=0.4)
    assert 0 < found.low < 1 < found.high
    assert found.p_value < 1e-6
    assert found.share_below < 0.1
    none, one = s.paired(np.empty(0), np.empty(0)), s.paired(np.array([2.0]), np.array([1.0]))
    assert none.pairs == 0 and np.isnan(none[1:]).all()
    assert (one.pairs, one.median_difference, one.p_value) == (1, 1.0, 1.0) and np.isnan(one.low)
    same = s.paired(np.arange(9.0), np.arange(9.0))
    assert same == (9, 0.0, 0.0, 0.0, 1.0, 0.0)


def test_statistics_against_numpy() -> None:
    values = np.random.default_rng(14).gamma(2.0, size=101)
    expected = {"rmse": np.sqrt((values**2).mean()), "min": values.min(), "max": values.max()}
    expected |= {"q2.5": np.quantile(values, 0.025), "share>1.5": (values > 1.5).mean(), "share>-1e-3": 1.0}
    for name, value in expected.items():
        of = s.statistic(name)
        assert float(of.of(values)) == value
        np.testing.assert_array_equal(of.of(np.stack([values, values]), axis=-1), [value, value])


def test_intervals_are_the_same_each_time_and_exact_where_nothing_varies() -> None:
    values, mean = np.random.default_rng(15).normal(size=50), s.statistic("mean")
    assert s.interval(values, mean, 0.95) == s.interval(values, mean, 0.95)
    narrow, wide = (s.interval(values, mean, c) for c in (0.5, 0.99))
    assert wide[0] < narrow[0] < values.mean() < narrow[1] < wide[1]
    assert s.interval(np.full(5, 3.0), mean, 0.95) == (3.0, 3.0)
    assert np.isnan(s.interval(np.arange(4.0), mean, 0.95)).all()  # too few
    low, high = s.interval(np.linspace(0, 1, 9), s.statistic("share>5"), 0.95)
    assert low == pytest.approx(0.0, abs=1e-12) and 0.2 < high < 0.4


@pytest.mark.parametrize("name", ["medain", "q0", "q100", "qx", "share>", "share>x", "share<1"])
def test_unknown_statistics_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="unknown statistic"):
        s.statistic(name)


def test_coverage_check_finds_a_wrong_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    real = s.interval
    monkeypatch.setattr(s, "interval", lambda values, of, confidence: real(values, of, 0.88))
    assert coverage("mean", 100, 400, monkeypatch) < 0.93
