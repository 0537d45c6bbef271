"""Summaries of a sweep: statistics of the rows, grouped by any scenario key, option or row key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.scores.metrics import METRIC, shown_in
from cellslam.benchmarks.scores.statistics import efficiency_ratio, interval, paired, plain, share_interval, statistic
from cellslam.benchmarks.sweeps.rows import results, varying_keys
from cellslam.sim.errors import InputError, unknown_name
from cellslam.sim.recording import Floats

if TYPE_CHECKING:
    import pandas as pd

# Of a group of rows, not of one.
RATIOS = EFFICIENCY, MERGED, OF_MAP = "efficiency_ratio", "efficiency_ratio_merged", "map_efficiency_ratio"
CONFIDENCE = 0.95
BOUND, BOUNDED = "bound", "position_rmse_m"  # the line of the bound, and the metric that it bounds
RATIO_OF = (BOUNDED, "bound_position_rmse_m", "bound_merged_m")
MAP_RATIO_OF = ("map_rmse_m", "bound_map_m")
_DRIVE = ("world", "seed", "trial")


@dataclass(frozen=True)
class Layout:
    """What a summary shows. `rows` None: the estimator and all that varies. `confidence` None: no intervals."""

    rows: Sequence[str] | None = None
    columns: str | None = None
    metrics: Sequence[str] = ()
    statistics: Sequence[str] = ("median",)
    confidence: float | None = None


def summary(folder: str | Path, layout: Layout | None = None) -> pd.DataFrame:
    """Return the statistics of a sweep's rows as a tidy DataFrame: one line a group, metric and statistic.

    Columns: the keys of rows and columns, `metric`, `statistic`, `value`, `low`, `high` (with a confidence),
    `values` (how many trials have the metric), `trials` (of status ok) and `failed`. The efficiency ratio, root mean
    square of the RMSE over that of the bound, is one number a group, of no statistic; so is the one against the bound
    that merging counts in. Beside the estimators stands the bound of their drives. Raises InputError.
    """
    import pandas as pd

    layout = layout or Layout()
    metrics = metrics_of(layout)
    for name in layout.statistics:
        statistic(name)
    check_confidence(layout.confidence)
    keys = list(dict.fromkeys([*row_keys(folder, layout), *([layout.columns] if layout.columns else [])]))
    frame = results(folder, [*keys, "status", *keys_of(metrics), *_DRIVE, *RATIO_OF, *MAP_RATIO_OF])
    if "estimator" in keys and BOUNDED in metrics:
        frame = _with_bounds(frame, keys)
    wanted = [(metric, name) for metric in metrics for name in ([""] if metric in RATIOS else layout.statistics)]
    lines = []
    for values, group in groups(frame, keys):
        fine = group[group["status"] == "ok"]
        for metric, name in wanted:
            value, low, high = estimate(fine, metric, name, layout.confidence)
            line = {**values, "metric": metric, "statistic": name, "value": value}
            line |= {} if layout.confidence is None else {"low": low, "high": high}
            known = fine[keys_of([metric])[:2]].notna().all(axis=1).sum()
            lines.append({**line, "values": int(known), "trials": len(fine), "failed": len(group) - len(fine)})
    return pd.DataFrame(lines)


def comparison(
    folder: str | Path,
    first: str,
    second: str,
    metric: str = "position_rmse_m",
    rows: Sequence[str] | None = None,
    confidence: float = CONFIDENCE,
) -> pd.DataFrame:
    """Return the paired differences `first` - `second` of two estimators on the same worlds and trials, by group.

    Each is a name, or one variant of an estimator whose options vary, as "fastslam[particles=100]".
    Columns: the row keys, `metric`, `pairs`, `median_difference`, `low`, `high`, `p_value` (Wilcoxon's signed-rank
    test, not corrected for the number of groups), `share_below`, `left_out` (a trial failed or lacks the metric).
    """
    import pandas as pd

    if metric in RATIOS:
        raise InputError(f"'{metric}' is of a group of drives, not of one: compare position_rmse_m")
    check_metric(metric)
    check_confidence(confidence)
    keys = [key for key in row_keys(folder, Layout(rows=rows)) if key != "estimator"]
    frame = results(folder, [*varying_keys(folder), *keys, "estimator", "options", *_DRIVE, "status", metric])
    own, fixed = _variant(frame, first)
    other, _ = _variant(frame, second)
    if other["options"].nunique() > 1:
        one = next(key for key in map(str, frame) if key.startswith(f"estimator.{second}."))
        value = _text(other[one].iloc[0])
        raise InputError(
            f"'{second}' has several options in this sweep: put it first, or say which, as "
            f"{second}[{one.rpartition('.')[2]}={value}]"
        )
    keys, same = [key for key in keys if key not in fixed], list(_DRIVE)
    joined = own.merge(other[[*same, "status", metric]], on=same, suffixes=("", " 2"))
    lines = []
    for values, group in groups(joined, keys):
        fine = group[(group["status"] == "ok") & (group["status 2"] == "ok")].dropna(subset=[metric, f"{metric} 2"])
        found = paired(finite(fine[metric]), finite(fine[f"{metric} 2"]), confidence)
        lines.append({**values, "metric": metric, **found._asdict(), "left_out": len(group) - len(fine)})
    return pd.DataFrame(lines)


def _variant(frame: pd.DataFrame, text: str) -> tuple[pd.DataFrame, set[str]]:
    """Return the rows of an estimator, or of one of its variants, and the keys whose values the variant fixes."""
    name, _, rest = text.removesuffix("]").partition("[")
    if name not in set(frame["estimator"]):
        raise unknown_name("estimator", name, set(frame["estimator"]))
    rows, fixed = frame[frame["estimator"] == name], set[str]()
    for part in rest.split(",") if rest else ():
        option, _, value = part.strip().partition("=")
        key = f"estimator.{name}.{option}"
        varying = [one.rpartition(".")[2] for one in map(str, frame) if one.startswith(f"estimator.{name}.")]
        if option not in varying:
            raise unknown_name(f"option of '{name}' that varies", option, varying)
        known = {_text(found): found for found in rows[key].unique()}
        if value not in known:
            raise unknown_name(f"value of {key}", value, known)
        rows, fixed = rows[rows[key] == known[value]], {*fixed, key}
    return rows, fixed


def _text(value: Any) -> str:
    """Return an option's value as it is written in a scenario; a column with gaps holds whole numbers as floats."""
    whole = isinstance(value, float) and value.is_integer()
    return str(int(value) if whole else plain(value))


def keys_of(metrics: Sequence[str]) -> list[str]:
    """Return the row keys that metrics are made of."""
    of = {EFFICIENCY: RATIO_OF, MERGED: RATIO_OF, OF_MAP: MAP_RATIO_OF}
    return [key for metric in metrics for key in of.get(metric, (metric,))]


def estimate(
    rows: pd.DataFrame, metric: str, name: str = "median", confidence: float | None = None
) -> tuple[float, float, float]:
    """Return statistic `name` of a metric over rows that are ok, and the ends of its interval; NaN: there is none.

    An efficiency ratio is of the rows that have RMSE and bound, and of no statistic; the merged one is against the
    bound that merging counts in, where a row has it.
    """
    if metric in RATIOS:
        of_error, of_bound, *_ = of_ratio = keys_of([metric])
        known = rows.dropna(subset=of_ratio[:2]).astype(dict.fromkeys(of_ratio, np.float64))
        bound = known["bound_merged_m"].fillna(known[of_bound]) if metric == MERGED else known[of_bound]
        return efficiency_ratio(known[of_error].to_numpy(), bound.to_numpy(), confidence or CONFIDENCE)
    values, of = finite(rows[metric]), statistic(name)
    if not len(values):
        return np.nan, np.nan, np.nan
    if confidence is None:
        return float(of.of(values)), np.nan, np.nan
    limits = share_interval(values, confidence) if METRIC[metric].share and name == "mean" else None
    return float(of.of(values)), *(limits or interval(values, of, confidence))


def ok_rows(folder: str | Path, keys: Sequence[str]) -> pd.DataFrame:
    """Return `keys` of the rows of a sweep that are ok, and the `key` under which their trajectories are kept."""
    frame = results(folder, [*keys, "key", "status"])
    return frame[frame["status"] == "ok"]


def row_keys(folder: str | Path, layout: Layout) -> list[str]:
    """Return the keys that group the rows of a summary."""
    if layout.rows is not None:
        return list(layout.rows)
    varied = [name for name in varying_keys(folder) if name != layout.columns]
    return [*varied, *(["estimator"] if layout.columns != "estimator" else [])]


def metrics_of(layout: Layout) -> list[str]:
    """Return the metrics of a layout, checked: those asked for, or the usual ones."""
    for name in layout.metrics:
        check_metric(name)
    return list(layout.metrics or ((BOUNDED,) if layout.columns else shown_in("summary")))


def check_metric(name: str) -> None:
    """Raise InputError unless there is a metric of that name."""
    if name not in METRIC:
        raise unknown_name("metric", name, METRIC)


def check_confidence(confidence: float | None) -> None:
    """Raise InputError unless a confidence is between one half and one."""
    if confidence is not None and not 0.5 <= confidence < 1:
        raise InputError(f"interval = {100 * confidence:g} %: must be 50 to 99.9")


def groups(frame: pd.DataFrame, keys: Sequence[str]) -> Iterator[tuple[dict[str, Any], pd.DataFrame]]:
    """Yield the groups of rows that agree in `keys`, null included, in the order of the rows."""
    if not keys:
        yield {}, frame
        return
    for values, group in frame.groupby(list(keys), dropna=False, sort=False):
        yield {key: plain(value) for key, value in zip(keys, values, strict=True)}, group


def _with_bounds(frame: pd.DataFrame, keys: Sequence[str]) -> pd.DataFrame:
    """Return rows with the bound of each drive as one more estimator's, after those of the same settings."""
    import pandas as pd

    limit = RATIO_OF[1]
    bounds = frame.dropna(subset=[limit]).drop_duplicates(list(_DRIVE))
    bounds["estimator"], bounds["status"], bounds[BOUNDED] = BOUND, "ok", bounds[limit]
    for key in map(str, frame):
        if key.startswith("estimator.") or (key in METRIC and key not in RATIO_OF):
            bounds[key] = None
    both = pd.concat([frame, bounds.astype(frame.dtypes)], ignore_index=True) if len(bounds) else frame
    settings = [key for key in keys if key.partition(".")[0] != "estimator"]
    if not settings:
        return both
    place = both.groupby(settings, dropna=False, sort=False).ngroup()
    return both.iloc[np.argsort(place, kind="stable")]


def finite(column: Any) -> Floats:
    """Return the values (n,) of a column that are there."""
    values = np.asarray(column, np.float64)
    return values[np.isfinite(values)]
