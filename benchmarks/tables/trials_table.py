"""The table of results that a person reads: estimators and the bound; over several trials, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.scores.metrics import METRIC
from cellslam.benchmarks.scores.statistics import efficiency_ratio, interval, statistic
from cellslam.benchmarks.tables.formats import TOO_WIDE
from cellslam.benchmarks.tables.summaries import BOUND
from cellslam.sim.recording import Floats

if TYPE_CHECKING:
    from rich.table import Table

    from cellslam.benchmarks.trials.trials import Trial

LONGEST_NAME = len("oracle-association")


def _column_of(key: str, digits: int | None = None) -> tuple[str, tuple[str, ...], int]:
    """Return the column of a metric: heading in two lines, keys, digits (None: those of the metric)."""
    metric = METRIC[key]
    return "\n".join(metric.titled.rsplit(" ", 1)), (key,), metric.digits if digits is None else digits


_ASSOCIATION = ("assoc.\nprec/rec", ("association_precision", "association_recall"), 2)
# Heading, keys and digits of a column, values joined by a slash; it all fits in 80 characters.
_COLUMNS = (
    _column_of("position_rmse_m"),
    _column_of("position_max_m"),
    _column_of("position_end_m"),
    _column_of("clock_offset_rmse_m"),
    _ASSOCIATION,
    _column_of("realtime_factor", 0),
)

# The same over several trials, for 120 characters. The first one is shown with its interval.
_SEVERAL = (
    ("RMSE (m)\n[95 %]", ("position_rmse_m",), 2),
    _column_of("position_max_m"),
    _column_of("heading_rmse_rad"),
    _column_of("clock_offset_rmse_m"),
    ("NEES\n(2)", ("nees_mean",), 1),
    _column_of("map_gospa_m", 1),
    _ASSOCIATION,
    _column_of("realtime_factor", 0),
)
MERGING = "merging\ncounted in"  # where a drive has that bound
_COUNTED = ("efficiency\nratio", MERGING, "lost", "trials\nok")
_FIRST_TO_GO = (
    "heading\n(rad)",
    "GOSPA\n(m)",
    "offset\n(m)",
    "trials\nok",
    "max\n(m)",
    "assoc.\nprec/rec",
    "NEES\n(2)",
    MERGING,
)
CONFIDENCE, LOST_M = 0.95, 2.0
LONG = 1e3  # without decimals
_LEGEND = (
    "medians over the trials that are ok; efficiency ratio: root mean square error over that of the bound, "
    "merging counted in: of the bound with merging as an error that persists; "
    f"lost: RMSE above {LOST_M:g} m, or failed"
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
        "bound_position_rmse_m": trial.bound.position_rmse_m,
        "bound_merged_m": trial.bound.merged_m,
        "position_max_m": float(std.max()),
        "position_end_m": float(std[-1]),
        "clock_offset_rmse_m": float(np.sqrt(np.mean(trial.bound.clock_offset_std_m[-1] ** 2))),
    }


def results_table(
    rows: Sequence[Mapping[str, Any]], title: str, oracles: frozenset[str], width: int | None = None
) -> Table:
    """Return the table of `rows`, one line an estimator in the order met; `oracles` are marked.

    Several trials give medians over those that are ok, the median error with its 95 % interval, how many drives were
    lost, and the efficiency ratio. Columns that do not fit into `width` characters are left out, and named.
    """
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    names = list(dict.fromkeys(row["estimator"] for row in rows))
    several = any(sum(row["estimator"] == name for row in rows) > 1 for name in names)
    table = Table(
        title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, caption_justify="left",
        padding=(0, 1) if not several else (0, 0, 0, 1),
    )  # fmt: skip
    columns = [_column([row for row in rows if row["estimator"] == name], several) for name in names]
    cells = {heading: [column[heading] for column in columns] for heading in columns[0]}
    if several and not any(row.get("bound_merged_m") is not None for row in rows):
        cells.pop(MERGING)
    left_out = _too_many(cells, width) if several and width is not None else []
    table.add_column("estimator", overflow="fold", min_width=LONGEST_NAME)
    for heading in cells:
        table.add_column(heading, justify="right", no_wrap=True)
    for line, name in enumerate(names):
        fine = any(row["estimator"] == name and row["status"] == "ok" for row in rows)
        mark = " (oracle)" if name in oracles else "" if fine else " (failed)"
        table.add_row(escape(f"{name}{mark}"), *(escape(values[line]) for values in cells.values()))
    notes = [_LEGEND] if several else []
    notes += [f"in a wider window: {', '.join(heading.split()[0] for heading in left_out)}"] if left_out else []
    table.caption = "\n".join([*notes, *(["oracle: was shown the truth"] if oracles else [])]) or None
    return table


def _column(own: Sequence[Mapping[str, Any]], several: bool) -> dict[str, str]:
    """Return what stands under each heading for the rows of one estimator."""
    fine = [row for row in own if row["status"] == "ok"]
    if not several:
        return {heading: _shown(fine, keys, digits) for heading, keys, digits in _COLUMNS}
    cells = {heading: _shown(fine, keys, digits) for heading, keys, digits in _SEVERAL}
    cells[_SEVERAL[0][0]] = _with_interval(fine)
    return {**cells, **dict(zip(_COUNTED, _counted(own, fine), strict=True))}


def _too_many(cells: dict[str, list[str]], width: int) -> list[str]:
    """Take columns out of `cells`, the least important first, until they fit; return their headings."""
    out = []
    for heading in _FIRST_TO_GO:
        texts = [[*key.split("\n"), *values] for key, values in cells.items()]
        if LONGEST_NAME + 2 + sum(2 + max(map(len, lines)) for lines in texts) <= width:
            break
        cells.pop(heading)
        out.append(heading)
    return out


def _with_interval(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the median of the position errors, with its interval where there are enough trials."""
    values = _values(rows, "position_rmse_m")
    if len(values) == 0:
        return "-"
    low, high = interval(values, statistic("median"), CONFIDENCE)
    return _bracketed(float(np.median(values)), low, high)


def _counted(own: Sequence[Mapping[str, Any]], fine: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the efficiency ratios, merging ignored and counted in, drives lost, and trials ok."""
    pairs = [row for row in fine if row.get("bound_position_rmse_m") is not None and row["position_rmse_m"] is not None]
    error, bound = _values(pairs, "position_rmse_m"), _values(pairs, "bound_position_rmse_m")
    merged = np.array([row.get("bound_merged_m") or row["bound_position_rmse_m"] for row in pairs], np.float64)
    ratios = [_bracketed(*efficiency_ratio(error, one, CONFIDENCE)) for one in (bound, merged)]
    lost = len(own) - len(fine) + int(np.sum(_values(fine, "position_rmse_m") > LOST_M))
    return [*ratios, f"{lost}/{len(own)}", f"{len(fine)}/{len(own)}"]


def _bracketed(value: float, low: float, high: float) -> str:
    if np.isnan(value):
        return "-"
    return f"{value:.2f}" + ("" if np.isnan(low) else f" [{low:.2f}, {high:.2f}]")


def _values(rows: Sequence[Mapping[str, Any]], key: str) -> Floats:
    return np.array([row[key] for row in rows if row.get(key) is not None], np.float64)


def _shown(rows: Sequence[Mapping[str, Any]], keys: Sequence[str], digits: int) -> str:
    columns = [[row[key] for row in rows if row.get(key) is not None] for key in keys]
    texts = [_number(median(values), digits) if values else "-" for values in columns]
    return "/".join(texts) if any(columns) else "-"


def _number(value: float, digits: int) -> str:
    if abs(value) >= TOO_WIDE:
        return f"{value:.0e}"
    return f"{value:.{digits if abs(value) < LONG else 0}f}"
