"""The table of results that a person reads: estimators and the bound; over several trials, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.scores.metrics import METRIC, shown_in
from cellslam.benchmarks.scores.statistics import LEAST_VALUES
from cellslam.benchmarks.tables.formats import Column, cell
from cellslam.benchmarks.tables.summaries import BOUND, EFFICIENCY, MERGED

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table

    from cellslam.benchmarks.bound.cramer_rao import BoundResult

LONGEST_NAME = len("oracle-association")
LOST_M = 2.0
LOST, OK = "lost", "trials ok"  # keys of columns that count
WITH_INTERVAL = ("position_rmse_m", EFFICIENCY, MERGED)
# In a narrow window these stay, these go last, in this order, and others before them, from the right.
STAY = ("position_rmse_m", LOST, EFFICIENCY, "realtime_factor")
GO_LAST = (OK, "position_max_m", "association_recall", "nees_mean", MERGED)


def bound_row(bound: BoundResult) -> dict[str, Any]:
    """Return the bound of a drive in the columns of the table."""
    std = bound.horizontal_std_m
    return {
        "estimator": BOUND,
        "status": "ok",
        "position_rmse_m": bound.position_rmse_m,
        "bound_position_rmse_m": bound.position_rmse_m,
        "bound_merged_m": bound.merged_m,
        "position_max_m": float(std.max()),
        "position_end_m": float(std[-1]),
        "clock_offset_rmse_m": float(np.sqrt(np.mean(bound.clock_offset_std_m[-1] ** 2))),
    }


def results_table(
    rows: Sequence[Mapping[str, Any]], title: str, oracles: frozenset[str], width: int | None = None
) -> Table:
    """Return the table of `rows`, one line an estimator in the order met; `oracles` are marked.

    Several trials give medians over those that are ok, the median error with its 95 % interval, how many drives were
    lost, and the efficiency ratio. Columns that do not fit into `width` characters are left out, and named.
    """
    import pandas as pd
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    frame = pd.DataFrame(list(rows), columns=["estimator", "status", *METRIC])
    lines = {str(name): own for name, own in frame.groupby("estimator", sort=False)}
    several = max(map(len, lines.values())) > 1
    columns = (*shown_in("trials"), LOST, OK) if several else shown_in("trial")
    keys = [key for key in columns if key != MERGED or frame["bound_merged_m"].notna().any()]
    cells = {_heading(key): [_text(own, key, several) for own in lines.values()] for key in keys}
    left_out = _too_many(cells, keys, width) if several and width is not None else []
    table = Table(
        title=escape(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, caption_justify="left",
        padding=(0, 0, 0, 1) if several else (0, 1),
    )  # fmt: skip
    table.add_column("estimator", overflow="fold", min_width=LONGEST_NAME)
    for heading in cells:
        table.add_column(heading, justify="right", no_wrap=True)
    for (name, own), *texts in zip(lines.items(), *cells.values(), strict=True):
        mark = " (oracle)" if name in oracles else "" if (own["status"] == "ok").any() else " (failed)"
        table.add_row(escape(f"{name}{mark}"), *map(escape, texts))
    notes = [_legend(cells)] if several else []
    notes += [f"in a wider window: {', '.join(heading.split()[0] for heading in left_out)}"] if left_out else []
    table.caption = "\n".join([*notes, *(["oracle: was shown the truth"] if oracles else [])]) or None
    return table


def _legend(cells: Mapping[str, Sequence[str]]) -> str:
    """Return what the columns of several trials mean, of those that are shown."""
    intervals = f"without intervals, which need {LEAST_VALUES} trials"
    if any("[" in text for texts in cells.values() for text in texts):
        intervals = "in brackets 95 % intervals"
    ratio = "efficiency ratio: root mean square error over that of the bound"
    if _heading(MERGED) in cells:
        ratio += ", merging counted in: over that of the bound with merging as an error that persists"
    return f"medians over the trials that are ok, {intervals}; {ratio}; lost: RMSE above {LOST_M:g} m, or failed"


def _heading(key: str) -> str:
    """Return the heading of a column, in two lines."""
    return "\n".join((METRIC[key].titled if key in METRIC else key).rsplit(" ", 1))


def _text(own: pd.DataFrame, key: str, several: bool) -> str:
    """Return what stands in a column for the rows of one estimator."""
    fine = own[own["status"] == "ok"]
    if key == OK:
        return f"{len(fine)}/{len(own)}"
    if key == LOST:
        return f"{len(own) - len(fine) + int((fine['position_rmse_m'] > LOST_M).sum())}/{len(own)}"
    return cell(fine, Column(key, interval=several and key in WITH_INTERVAL))


def _too_many(cells: dict[str, list[str]], keys: list[str], width: int) -> list[str]:
    """Take columns out of `cells`, the least important first, until they fit; return their headings."""
    out = []
    others = [key for key in reversed(keys) if key not in (*STAY, *GO_LAST)]
    for heading in map(_heading, (*others, *GO_LAST)):
        texts = [[*key.split("\n"), *values] for key, values in cells.items()]
        if LONGEST_NAME + 2 + sum(2 + max(map(len, lines)) for lines in texts) <= width:
            break
        if cells.pop(heading, None) is not None:
            out.append(heading)
    return out
