"""Who beats whom over the drives of a sweep: a verdict for each of its worlds, and one over all of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import reduce
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.scores.verdicts import LEAST_TRIALS, Verdict, verdict
from cellslam.benchmarks.tables.formats import Grid, bracketed, markdown, number
from cellslam.slam import registry

if TYPE_CHECKING:
    import pandas as pd

METRIC = "position_rmse_m"
ALL = "overall"
MOST_PANELS = 12
MOST_TRIALS = 10_000  # what is needed beyond is not worth a number: 20 trials do not tell it


def verdicts(
    panels: Mapping[str, pd.DataFrame], oracles: Collection[str] = (), label: str = "estimator"
) -> dict[str, Verdict]:
    """Return the verdict on the position RMSE in each panel of rows, and, if there are several, over `ALL` of them.

    Compared are the values of column `label`, those of `oracles` aside, on the drives that all of them met; a drive
    that failed is worse than any other. Over all panels a trial counts once, with the geometric mean of its RMSEs:
    trials of one number have random draws in common in every world, so that they are no further evidence. Of more than
    twelve panels that verdict stands alone. A panel of too few drives for a verdict has no part in it.
    """
    tables = {title: _scores(rows[~rows["estimator"].isin(oracles)], label) for title, rows in panels.items()}
    tables = {title: table for title, table in tables.items() if len(table) >= LEAST_TRIALS}
    if len(tables) > 1:
        with np.errstate(divide="ignore"):
            logs = [table.apply(np.log) for table in tables.values()]
        mean = reduce(lambda one, other: one + other, logs) / len(logs)
        tables[ALL] = mean.apply(np.exp).dropna(axis=1, how="all").dropna()
    if len(tables) > MOST_PANELS:
        tables = {ALL: tables[ALL]}
    found = {title: verdict({str(name): table[name].to_numpy() for name in table}) for title, table in tables.items()}
    return {title: one for title, one in found.items() if one is not None}


def map_builders(panels: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the rows of the built-in estimators that build a map and are no oracles: what a suite's power is of."""
    own = {entry.name for entry in registry.BUILT_IN if not entry.oracle}
    building = {name for rows in panels.values() for name in rows.loc[rows["map_gospa_m"].notna(), "estimator"]}
    return {title: rows[rows["estimator"].isin(own & building)] for title, rows in panels.items()}


def verdict_table(one: Verdict) -> str:
    """Return a verdict as a Markdown table: mean ranks, and median differences, bold where they are significant."""
    lines = []
    for i, name in enumerate(one.names):
        texts = [number(value, METRIC) for value in one.difference[i].tolist()]
        cells = (f"**{text}**" if one.differ[i, j] else text if i != j else "" for j, text in enumerate(texts))
        lines.append((name, f"{one.mean_rank[i]:.2f}", *cells))
    return markdown(Grid(("estimator", "mean rank", *one.names), tuple(lines), 1)).rstrip()


def effects_table(one: Verdict) -> str:
    """Return the pairs of a verdict as a Markdown table: their median difference with its interval, its p-value, and
    how many trials would show it; those that differ least come last."""
    pairs = sorted(combinations(range(len(one.names)), 2), key=lambda pair: one.trials_needed[pair])
    lines = []
    for pair in pairs:
        first, second = (one.names[i] for i in pair)
        effect = bracketed(one.difference[pair], one.low[pair], one.high[pair], METRIC)
        needed = f"{one.trials_needed[pair]:.0f}" if one.trials_needed[pair] < MOST_TRIALS else f"> {MOST_TRIALS}"
        lines.append((f"{first}, {second}", effect, f"{one.p_value[pair]:.2g}", needed))
    return markdown(Grid(("pair", "difference [95 %]", "p", "trials needed"), tuple(lines), 1)).rstrip()


def significant_pairs(one: Verdict) -> str:
    """Return how many pairs of a verdict differ significantly, as in `12 of 15 pairs (80 %)`."""
    apart, pairs = one.pairs
    return f"{apart} of {pairs} pairs ({100 * apart / pairs:.0f} %)"


def _scores(rows: pd.DataFrame, label: str) -> pd.DataFrame:
    """Return the errors in m by drive and column `label`, infinite where it failed."""
    score = rows[METRIC].astype(float).where(rows["status"] == "ok", np.inf)
    return score.groupby([rows["seed"], rows["trial"], rows[label]]).mean().unstack().dropna()
