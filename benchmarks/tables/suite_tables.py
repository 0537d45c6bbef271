"""The results of a suite as Markdown: a verdict and a table over all scenarios, and both for each; the leaderboard."""

from __future__ import annotations

from collections.abc import Collection
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.scores.metrics import COST_KEYS
from cellslam.benchmarks.scores.statistics import efficiency_ratio
from cellslam.benchmarks.scores.verdicts import POWER, Verdict
from cellslam.benchmarks.tables import rankings
from cellslam.benchmarks.tables.formats import Column, Grid, bracketed, cell, columns_of, markdown, marked, number
from cellslam.benchmarks.tables.suite_rows import SuiteRows
from cellslam.benchmarks.tables.summaries import BOUNDED, CONFIDENCE, EFFICIENCY, MERGED, OF_MAP, RATIO_OF, RATIOS
from cellslam.scenarios.suites import Suite, superseded_by

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = columns_of("suite", (BOUNDED, *RATIOS))
COSTS = [column for column in COLUMNS if column.metric in COST_KEYS]
RULES = """\
Position errors are horizontal, absolute, not aligned. Efficiency ratio: root mean square of the RMSE over that of the
bound, 1 at best, its 95 % interval by resampling trials; merging counted in: over that of the bound with merging as
an error that persists. Memory: what resident memory grew by at the most. A pair differs where Wilcoxon's
signed-rank test, corrected for all pairs by Holm's method, says so at 5 %. Ranks are over trials, 1 the best; by
Nemenyi's test those that differ by less than the critical difference may be equal. Over all scenarios a trial counts
once, with the geometric mean of its RMSEs, as its random draws are common to all of them. A drive that failed is worse
than any other. Oracles, which were shown the truth, are not ranked."""
RULES = " ".join(RULES.split("\n"))


def suite_markdown(some: SuiteRows, command: str, left: str, picture: str = "") -> str:
    """Return the whole page. `left`: what was left out, and why; `picture`: the file of the ranks' diagram, if any."""
    one, trials = some.suite, some.trials
    title = one.name if some.whole else f"{one.name}, a part: trials 0 to {trials - 1} of {', '.join(some.scenarios)}"
    title += f", with {', '.join(some.changed)}" if some.changed else ""
    judged, power = rankings.verdicts(some.panels, some.oracles), rankings.verdicts(rankings.map_builders(some.panels))
    versions = ", ".join(f"{name} {text}" for name, text in some.versions.items())
    lacking = [] if some.whole else ["all scenarios and trials"]
    lacking += ["the options that estimators have themselves"] if some.changed else []
    about = (
        f"Root seed {one.seed}, trials 0 to {trials - 1} of each scenario{_fewer(some)}. Medians over trials. {RULES}"
    )
    head = [
        f"# Accuracy: {title}",
        f"\nNot the suite's result: it takes {' and '.join(lacking)}.\n" if lacking else "",
        *([f"Superseded by `{newer}`.\n"] if (newer := superseded_by(one)) else []),
        _filled(about),
        _filled(f"Made with {versions}, on {some.machine}, by"),
        f"\n    {command}\n",
        left,
    ]
    parts = [
        _scenario(name, rows, some.oracles, judged.get(name), power.get(name)) for name, rows in some.panels.items()
    ]
    if len(some.scenarios) > 1:
        whole = ["\n## All scenarios\n", standings(some, judged)]
        whole += _judged(judged.get(rankings.ALL), power.get(rankings.ALL))
        whole += [f"\n![Mean ranks]({picture})"] if picture else []
        parts.insert(0, "\n".join(whole))
    return "\n".join([*head, *parts]).rstrip() + "\n"


def leaderboard_markdown(some: SuiteRows, made_with: dict[str, str], command: str, picture: str) -> str:
    """Return the page of a leaderboard. `made_with`: the version of cellslam by estimator; `picture`: the diagram."""
    one = some.suite
    judged, power = rankings.verdicts(some.panels, some.oracles), rankings.verdicts(rankings.map_builders(some.panels))
    scenarios = ", ".join(f"`{name}`" for name in one.scenarios)
    about = (
        f"How estimators compare on `{one.name}`: {one.trials} drives of each of {scenarios} (root seed {one.seed}"
        f"{_fewer(some)}), by the mean rank. Of each scenario the table has the median RMSE in metres. Times are of "
        f"the machine that made the entry. {RULES}"
    )
    return "\n".join([
        f"# Leaderboard: {one.name}\n",
        f"{_filled(about)}\n",
        standings(some, judged, made_with),
        *_judged(judged.get(rankings.ALL), power.get(rankings.ALL)),
        *_effects(power.get(rankings.ALL)),
        f"\n![Mean ranks and critical differences]({picture})\n",
        _yours(one),
        f"This page is made by\n\n    {command}",
    ]) + "\n"  # fmt: skip


def _filled(text: str) -> str:
    """Return a paragraph in lines as wide as those of the documentation's pages."""
    return fill(text, 119, break_long_words=False, break_on_hyphens=False)


def _fewer(some: SuiteRows) -> str:
    """Return which scenarios have fewer trials than the others, as in `, 0 to 4 of signal`."""
    counts = {name: some.suite.trials_of(name, some.trials) for name in some.scenarios}
    return "".join(f", 0 to {count - 1} of `{name}`" for name, count in counts.items() if count < some.trials)


def standings(some: SuiteRows, judged: dict[str, Verdict], made_with: dict[str, str] | None = None) -> str:
    """Return the table over all scenarios: a line an estimator, the best mean rank first, oracles last."""
    overall = judged.get(rankings.ALL)
    rank = dict(zip(overall.names, overall.mean_rank.tolist(), strict=True)) if overall else {}
    names = sorted(
        some.rows["estimator"].unique(), key=lambda name: (name in some.oracles, rank.get(name, np.inf), name)
    )
    lines = []
    for name in names:
        rows = some.rows[some.rows["estimator"] == name]
        fine = rows[rows["status"] == "ok"]
        medians = (cell(fine[fine["scenario"] == scenario], Column("position_rmse_m")) for scenario in some.scenarios)
        costs = (cell(fine, column) for column in COSTS)
        cells = (number(rank.get(name)), _overall_efficiency(fine), *medians, *costs, f"{len(fine)}/{len(rows)}")
        lines.append((marked(name, some.oracles), *cells, *([made_with[name]] if made_with else [])))
    heads = ("estimator", "mean rank", Column(EFFICIENCY, interval=True).heading, *some.scenarios)
    heads += (*(column.heading for column in COSTS), "ok", *(["cellslam"] if made_with else []))
    return markdown(Grid(heads, tuple(lines), 1)).rstrip()


def _scenario(
    name: str, rows: pd.DataFrame, oracles: Collection[str], judged: Verdict | None, power: Verdict | None
) -> str:
    needed = {MERGED: "bound_merged_m", OF_MAP: "bound_map_m"}
    columns = [c for c in COLUMNS if c.metric not in needed or rows[needed[c.metric]].notna().any()]
    lines = []
    for estimator, own in rows.groupby("estimator", sort=False):
        fine = own[own["status"] == "ok"]
        cells = (cell(fine, column) for column in columns)
        lines.append((marked(str(estimator), oracles), *cells, f"{len(fine)}/{len(own)}"))
    table = markdown(Grid(("estimator", *(column.heading for column in columns), "ok"), tuple(lines), 1)).rstrip()
    return "\n".join([f"\n## {name}\n", table, *_judged(judged, power)])


def _judged(one: Verdict | None, power: Verdict | None) -> list[str]:
    """Return a verdict in words and as a table, and its power: how many pairs of the built-in map builders differ."""
    if one is None:
        return []
    equal = "" if np.isnan(one.friedman_p) else f"; all equally good: p = {one.friedman_p:.2g} (Friedman)"
    summary = f"Significant differences: {rankings.significant_pairs(one)}. "
    summary += f"Critical difference of mean ranks: {one.critical_difference:.2f}{equal}."
    if power is not None:
        summary += f" Power: of the built-in map builders, tested by themselves, {rankings.significant_pairs(power)}."
    note = "Median difference of the RMSE on the same drives in m, row minus column; bold: significant.\n"
    return [f"\n{_filled(summary)}", note, rankings.verdict_table(one)]


def _effects(one: Verdict | None) -> list[str]:
    """Return the pairs of the built-in map builders, with what a smaller difference would take."""
    if one is None:
        return []
    about = (
        "The built-in map builders alone, pair by pair: median difference of the RMSE in m with its 95 % interval, "
        "p-value after Holm, and the number of trials in which Wilcoxon's test would find such a difference at 5 % "
        f"with a probability of {POWER:g}, if these {one.trials} trials are like all others."
    )
    return [f"\n{_filled(about)}\n", rankings.effects_table(one)]


def _yours(one: Suite) -> str:
    return f"""\
Yours is added by one command, which takes the time of its drives, and the file that it writes:

    cellslam bench accuracy --suite {one.name} --estimator my_module:MyEstimator --rows my-estimator.json

The file holds the rows, the versions and the suite's digest. Whoever has the estimator too can verify it:
`cellslam bench accuracy --check my-estimator.json` drives a sample of the drives again and compares.
"""


def _overall_efficiency(rows: pd.DataFrame) -> str:
    """Return the efficiency ratio over all scenarios; a trial's drives are resampled together."""
    known = rows.dropna(subset=list(RATIO_OF[:2]))
    squares = known[list(RATIO_OF[:2])].astype(float).pow(2).groupby(known["trial"]).sum()
    error, bound = (np.sqrt(squares[key].to_numpy()) for key in RATIO_OF[:2])
    return bracketed(*efficiency_ratio(error, bound, CONFIDENCE), EFFICIENCY)
