"""The table of results that a person reads: estimators and the bound, medians over trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rich.table import Table

    from cellslam.benchmarks.trials import Trial

BOUND = "bound"
# Heading and the keys of a column, values joined by a slash; it all fits in 80 characters.
_COLUMNS = (
    ("RMSE\n(m)", ("position_rmse_m",), 2),
    ("max\n(m)", ("position_max_m",), 2),
    ("end\n(m)", ("position_end_m",), 2),
    ("offset\n(m)", ("clock_offset_rmse_m",), 2),
    ("assoc.\nprec/rec", ("association_precision", "association_recall"), 2),
    ("x real\ntime", ("realtime_factor",), 0),
)


def bound_row(trial: Trial) -> dict[str, Any]:
    """Return the bound of a trial in the columns of the table; empty without a bound."""
    if trial.bound is None:
        return {}
    std = trial.bound.horizontal_std_m
    return {
        "estimator": BOUND,
        "status": "ok",
        "position_rmse_m": trial.bound.position_rmse_m,
        "position_max_m": float(std.max()),
        "position_end_m": float(std[-1]),
        "clock_offset_rmse_m": float(np.sqrt(np.mean(trial.bound.clock_offset_std_m[-1] ** 2))),
    }


def results_table(rows: Sequence[Mapping[str, Any]], title: str, oracles: frozenset[str]) -> Table:
    """Return the table of `rows`, one line an estimator in the order met; `oracles` are marked.

    Several trials give medians over those that are ok, and how many these are.
    """
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    names = list(dict.fromkeys(row["estimator"] for row in rows))
    several = any(sum(row["estimator"] == name for row in rows) > 1 for name in names)
    table = Table(
        title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, caption_justify="left"
    )
    table.add_column("estimator", overflow="fold")
    for heading in [*(column[0] for column in _COLUMNS), *(["trials\nok"] if several else [])]:
        table.add_column(heading, justify="right", no_wrap=True)
    for name in names:
        own = [row for row in rows if row["estimator"] == name]
        fine = [row for row in own if row["status"] == "ok"]
        values = [_shown(fine, keys, digits) for _, keys, digits in _COLUMNS]
        count = [f"{len(fine)}/{len(own)}"] if several else []
        mark = " (oracle)" if name in oracles else "" if fine else " (failed)"
        table.add_row(escape(f"{name}{mark}"), *values, *count)
    if oracles:
        table.caption = "oracle: was shown the truth"
    return table


def _shown(rows: Sequence[Mapping[str, Any]], keys: Sequence[str], digits: int) -> str:
    columns = [[row[key] for row in rows if row.get(key) is not None] for key in keys]
    texts = [f"{median(values):.{digits}f}" if values else "-" for values in columns]
    return "/".join(texts) if any(columns) else "-"
