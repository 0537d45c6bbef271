"""The results of a suite as Markdown: how they were made, and a table a scenario."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellslam.benchmarks.scores.statistics import interval, statistic
from cellslam.benchmarks.sweeps.rows import provenance, results
from cellslam.benchmarks.tables.formats import comparison_grid, number
from cellslam.benchmarks.tables.summaries import EFFICIENCY, MERGED, RATIO_OF, comparison, efficiency, finite
from cellslam.scenarios.suites import Suite
from cellslam.slam.registry import oracles

if TYPE_CHECKING:
    import pandas as pd

CONFIDENCE = 0.95
REFERENCE = "fastslam"
# Columns: heading, metric, statistic, with an interval.
COLUMNS = (
    ("RMSE (m) [95 %]", "position_rmse_m", "median", True),
    ("efficiency ratio [95 %]", EFFICIENCY, "", True),
    ("merging counted in", MERGED, "", True),  # where a drive has that bound
    ("90 % (m)", "position_rmse_m", "q90", False),
    ("max (m)", "position_max_m", "median", False),
    ("end (m)", "position_end_m", "median", False),
    ("heading (rad)", "heading_rmse_rad", "median", False),
    ("offsets (m)", "clock_offset_rmse_m", "median", False),
    ("map GOSPA (m)", "map_gospa_m", "median", False),
    ("precision", "association_precision", "median", False),
    ("recall", "association_recall", "median", False),
    ("NEES", "nees_mean", "median", False),
    ("bound (m)", "bound_position_rmse_m", "median", False),
    ("x real time", "realtime_factor", "median", False),
)


def suite_markdown(folder: Path, one: Suite, scenarios: Sequence[str], trials: int, command: str, left: str) -> str:
    """Return the whole page. `trials`, `scenarios`: what was run of the suite; `left`: what was left out, and why."""
    whole = trials == one.trials and tuple(scenarios) == one.scenarios
    title = one.name if whole else f"{one.name}, a part: trials 0 to {trials - 1} of {', '.join(scenarios)}"
    versions = provenance(folder)[-1]["versions"]
    said = ", ".join(f"{name} {text}" for name, text in versions.items())
    head = [
        f"# Accuracy: {title}",
        "" if whole else "\nNot the suite's result: it takes all scenarios and trials.\n",
        f"Root seed {one.seed}, trials 0 to {trials - 1} of each scenario. Medians over trials; RMSE with its "
        f"{100 * CONFIDENCE:g} % interval by resampling; position errors are horizontal, absolute, not aligned. "
        "Efficiency ratio: root mean square of the RMSE over that of the bound, 1 at best; merging counted in: over "
        "that of the bound without merged measurements.",
        f"Made with {said}, on {platform.machine()}, by",
        f"\n    {command}\n",
        left,
    ]
    return "\n".join([*head, *(_scenario(folder, name, trials, one.seed) for name in scenarios)]).rstrip() + "\n"


def _scenario(folder: Path, name: str, trials: int, seed: int) -> str:
    metrics = [metric for _, metric, _, _ in COLUMNS if metric not in (EFFICIENCY, MERGED, *RATIO_OF)]
    frame = results(folder, ["scenario", "estimator", "trial", "seed", "status", *RATIO_OF, *metrics])
    own = frame[(frame["scenario"] == name) & (frame["trial"] < trials) & (frame["seed"] == seed)]
    marked = oracles(own["estimator"].unique())
    columns = [c for c in COLUMNS if c[1] != MERGED or own["bound_merged_m"].notna().any()]
    lines = ["| estimator | " + " | ".join(c[0] for c in columns) + " | ok |", "|---|" + "---:|" * (len(columns) + 1)]
    for estimator in own["estimator"].unique():
        rows = own[own["estimator"] == estimator]
        fine = rows[rows["status"] == "ok"]
        cells = [_cell(fine, metric, of, ends) for _, metric, of, ends in columns]
        shown = f"{estimator} (oracle)" if estimator in marked else estimator
        lines.append("| " + " | ".join([shown, *cells, f"{len(fine)}/{len(rows)}"]) + " |")
    return "\n".join([f"\n## {name}\n", *lines, *_compared(folder, name, list(own["estimator"].unique()))])


def _compared(folder: Path, scenario: str, estimators: Sequence[str]) -> list[str]:
    """Return the paired differences to the reference, in one scenario."""
    if REFERENCE not in estimators or len(estimators) < 2:
        return []
    out = [f"\nPaired with {REFERENCE}, on the same worlds (median difference of the RMSE, its interval, p of"
           " Wilcoxon's signed-rank test):\n"]  # fmt: skip
    body = []
    for name in estimators:
        if name == REFERENCE:
            continue
        tidy = comparison(folder, name, REFERENCE, rows=["scenario"], confidence=CONFIDENCE)
        grid = comparison_grid(tidy[tidy["scenario"] == scenario], [], name, REFERENCE, 100 * CONFIDENCE)
        body += [f"| {name} | " + " | ".join(cell for cell in line) + " |" for line in grid.lines]
    heads = ("estimator", "difference (m)", "95 % interval", "p", "better", "pairs", "left out")
    return [*out, "| " + " | ".join(heads) + " |", "|---|" + "---:|" * (len(heads) - 1), *body]


def _cell(rows: pd.DataFrame, metric: str, name: str, ends: bool) -> str:
    if metric in (EFFICIENCY, MERGED):
        value, low, high = efficiency(rows, CONFIDENCE, metric == MERGED)
    else:
        values, of = finite(rows[metric]), statistic(name)
        value = float(of.of(values)) if len(values) else float("nan")
        low, high = interval(values, of, CONFIDENCE) if ends else (float("nan"), float("nan"))
    text = number(value, metric)
    return text if np.isnan(low) else f"{text} [{number(low, metric)}, {number(high, metric)}]"
