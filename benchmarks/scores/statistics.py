"""Statistics over trials: location, spread, bootstrap intervals, paired differences.

Sources: Efron and Tibshirani, "An introduction to the bootstrap", 1993, chapters 12 (bootstrap-t) and 13 (percentiles);
Wilson, "Probable inference, the law of succession, and statistical inference", J. American Statistical Association 22,
1927; Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1, 1945.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellslam.sim.errors import InputError
from cellslam.sim.recording import Floats

RESAMPLES = 1999
DRAWS = 9999  # of an upper limit, the most
LEAST_VALUES = 5
NAMES = "median, mean, rmse, min, max, q5 to q99.9, share>VALUE"
# Elements of one batch of resamples: bounds the memory, not the result.
_BATCH = 4_000_000


@dataclass(frozen=True)
class Statistic:
    """A number that sums up a sample: `of(values, axis)`, and the kind of its bootstrap interval.

    Means and root mean squares have studentised intervals (bootstrap-t, Efron, 1982; for root mean squares on the
    logarithm): errors over trials are skewed, and BCa intervals then cover too little. Quantiles have percentile
    intervals, shares Wilson's (1927), since resampling cannot leave 0 or 100 %.
    """

    name: str
    of: Callable[..., Any]
    method: Literal["mean", "mean square", "share", "percentile"] = "percentile"


class Paired(NamedTuple):
    """Differences of two estimators over the same worlds: their median with an interval, and a test; NaN without pairs.

    `p_value`: Wilcoxon's signed-rank test of no difference (1945). `share_below`: in how many pairs the first is below
    the second.
    """

    pairs: int
    median_difference: float
    low: float
    high: float
    p_value: float
    share_below: float


def statistic(name: str) -> Statistic:
    """Return the statistic of that name: median, mean, rmse, min, max, q90 (a quantile), share>2 (of values above).

    Raises InputError for any other.
    """
    plain = {
        "median": Statistic(name, np.median),
        "mean": Statistic(name, np.mean, "mean"),
        "rmse": Statistic(name, _rms, "mean square"),
        "min": Statistic(name, np.min),
        "max": Statistic(name, np.max),
    }
    if name in plain:
        return plain[name]
    if (quantile := re.fullmatch(r"q(\d+(\.\d+)?)", name)) and 0 < float(quantile[1]) < 100:
        share = float(quantile[1]) / 100
        return Statistic(name, lambda values, axis=-1: np.quantile(values, share, axis=axis))
    if above := re.fullmatch(r"share>(-?\d+(\.\d+)?(e-?\d+)?)", name):
        threshold = float(above[1])
        return Statistic(name, lambda values, axis=-1: np.mean(np.asarray(values) > threshold, axis=axis), "share")
    raise InputError(f"unknown statistic '{name}' (known: {NAMES})")


def interval(values: Floats, of: Statistic, confidence: float) -> tuple[float, float]:
    """Return the interval of a statistic of `values` (n,), by resampling but for shares; NaN below five values.

    The draws are always the same, and so is the interval.
    """
    from scipy.stats import bootstrap

    if len(values) < LEAST_VALUES:
        return float("nan"), float("nan")
    if of.method == "share":
        return wilson(round(float(of.of(values)) * len(values)), len(values), confidence)
    if np.ptp(values) == 0.0:
        value = float(of.of(values))
        return value, value
    if of.method == "mean":
        return _bootstrap_t(_mean_and_error, (values,), confidence)
    if of.method == "mean square":
        return _root_ratio(np.square(values), np.ones(len(values)), confidence)
    found = bootstrap(
        (values,),
        of.of,
        confidence_level=confidence,
        n_resamples=RESAMPLES,
        vectorized=True,
        method="percentile",
        batch=max(1, _BATCH // len(values)),
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(found.low), float(found.high)


def wilson(successes: int, trials: int, confidence: float) -> tuple[float, float]:
    """Return Wilson's interval (1927) of a probability, from how many of independent trials were successes."""
    from scipy.stats import binomtest  # which takes a second to load

    found = binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(found.low), float(found.high)


def upper_limit(shares: Floats, confidence: float) -> float:
    """Return the upper confidence limit of the mean of independent shares (n,), each 0 to 1; NaN without any.

    It needs to know no distribution. Where all are 0 or 1 it is that of Clopper and Pearson (1934): n shares of zero
    leave 1 - (1 - confidence)^(1 / n). Sources: Gaffke, "Three test statistics for a nonparametric one-sided hypothesis
    on the mean of a nonnegative variable", Mathematical Methods of Statistics 14, 2005; Phan, Thomas and
    Learned-Miller, "Towards practical mean bounds for small samples", ICML 2021, section 2.
    """
    if not len(shares):
        return float("nan")
    steps = np.diff(np.sort(shares), append=1.0)
    return float(np.quantile(1.0 - _uniform(len(shares)) @ steps, confidence))


@lru_cache(maxsize=1)
def _uniform(count: int) -> Floats:
    """Return sorted uniform draws (k, count)."""
    draws = max(RESAMPLES, min(DRAWS, _BATCH // count))
    return np.sort(np.random.default_rng(0).random((draws, count)), axis=1)


def share_interval(shares: Floats, confidence: float) -> tuple[float, float]:
    """Return the interval of the mean of independent shares (n,), by `upper_limit` on both sides; NaN below five."""
    if len(shares) < LEAST_VALUES:
        return float("nan"), float("nan")
    one_sided = (1.0 + confidence) / 2.0
    return 1.0 - upper_limit(1.0 - shares, one_sided), upper_limit(shares, one_sided)


def efficiency_ratio(error: Floats, bound: Floats, confidence: float) -> tuple[float, float, float]:
    """Return the efficiency ratio sqrt(mean error^2 / mean bound^2) of drives (n,), in m, and the ends of its interval.

    1 is the least that any filter can have on average. The interval is NaN below five drives, the ratio without any;
    drives are resampled, error and bound together. Median errors over bounds would mislead: a drive's error has few
    degrees of freedom, and an efficient filter has 0.8.
    """
    squares, least = np.square(error), np.square(bound)
    if not len(squares) or np.sum(least) == 0.0:
        return float("nan"), float("nan"), float("nan")
    ratio = math.sqrt(np.sum(squares) / np.sum(least))
    few = len(squares) < LEAST_VALUES or np.ptp(squares) == 0.0
    return (ratio, float("nan"), float("nan")) if few else (ratio, *_root_ratio(squares, least, confidence))


def geometric_mean_ratio(first: Floats, second: Floats, confidence: float) -> tuple[float, float, float]:
    """Return the geometric mean of `first` / `second` (n,), both positive and of the same unit, drive by drive, and the
    ends of its interval: NaN below five drives, the ratio without any."""
    logs = np.log(np.asarray(first) / np.asarray(second))
    if not len(logs):
        return float("nan"), float("nan"), float("nan")
    low, high = interval(logs, statistic("mean"), confidence)
    return math.exp(float(np.mean(logs))), math.exp(low), math.exp(high)


def paired(first: Floats, second: Floats, confidence: float = 0.95) -> Paired:
    """Return how `first` (n,) differs from `second` (n,), of the same unit, trial by trial."""
    difference = np.asarray(first) - np.asarray(second)
    if not len(difference):
        return Paired(0, *[math.nan] * 5)
    ends = interval(difference, statistic("median"), confidence)
    below = float(np.mean(difference < 0.0))
    return Paired(len(difference), float(np.median(difference)), *ends, wilcoxon_p(difference), below)


def wilcoxon_p(difference: Floats) -> float:
    """Return the p-value of Wilcoxon's signed-rank test that differences (n,), in any unit, are symmetric about
    zero."""
    from scipy.stats import wilcoxon

    return float(wilcoxon(difference).pvalue) if np.any(difference != 0.0) else 1.0


def plain(value: Any) -> Any:
    """Return a value as JSON holds it: of numpy's scalars Python's, NaN and infinity as None."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _rms(values: Floats, axis: int = -1) -> Any:
    return np.sqrt(np.mean(np.square(values), axis=axis))


def _mean_and_error(values: Floats) -> tuple[Any, Any]:
    return values.mean(axis=-1), values.std(axis=-1) / math.sqrt(values.shape[-1])


def _log_ratio_and_error(above: Floats, below: Floats) -> tuple[Any, Any]:
    mean_a, mean_b = (np.maximum(v.mean(axis=-1, keepdims=True), 1e-300) for v in (above, below))
    error = (above / mean_a - below / mean_b).std(axis=-1) / math.sqrt(above.shape[-1])
    return np.log(mean_a / mean_b)[..., 0], error


def _root_ratio(above: Floats, below: Floats, confidence: float) -> tuple[float, float]:
    """Return the interval of sqrt(mean above / mean below), none negative: bootstrap-t on the logarithm.

    It ends where every value above were as large as the largest: of one that outweighs all others, the bootstrap has no
    idea how often it happens. Where all values have the same ratio, as the bound to itself, it has no width.
    """
    value, error = _log_ratio_and_error(above, below)
    if error < 1e-12:
        return math.exp(0.5 * value), math.exp(0.5 * value)
    low, high = _bootstrap_t(_log_ratio_and_error, (above, below), confidence)
    most = math.log(max(float(above.max()), 1e-300) / max(float(below.mean()), 1e-300))
    return math.exp(0.5 * min(low, most)), math.exp(0.5 * min(high, most))


def _bootstrap_t(
    of: Callable[..., tuple[Any, Any]], samples: tuple[Floats, ...], confidence: float
) -> tuple[float, float]:
    """Return the bootstrap-t interval of what `of` says of samples (n,), with its standard error."""
    value, error = of(*samples)
    t = []
    for drawn in _resampled(len(samples[0])):
        values, errors = of(*(sample[drawn] for sample in samples))
        fine = errors > 1e-9 * error
        t.append((values[fine] - value) / errors[fine])
    low, high = np.quantile(np.concatenate(t), [(1 - confidence) / 2, (1 + confidence) / 2]).tolist()
    return float(value - high * error), float(value - low * error)


def _resampled(count: int) -> Iterator[NDArray[np.int64]]:
    """Yield which of `count` values each resample has, in batches (n, count).

    A resample of equal values says nothing about its error, and is left out of bootstrap-t.
    """
    rng, size = np.random.default_rng(0), max(1, _BATCH // count)
    for begin in range(0, RESAMPLES, size):
        yield rng.integers(0, count, (min(size, RESAMPLES - begin), count))
