"""Which trials a report looks at: the worst of an estimator, and those that failed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellslam.benchmarks.report.choice import Choice
from cellslam.benchmarks.sweeps.store import reading
from cellslam.benchmarks.tables.summaries import Layout, metrics_of
from cellslam.sim.errors import InputError, unknown_name
from cellslam.slam.registry import oracles

if TYPE_CHECKING:
    from cellslam.benchmarks.figures.sweep.sweep_data import Panel, Series, SweepData

MOST_WORST = 12
MOST_FAILED = 100
# Metrics of which more is better.
RISING = ("association_precision", "association_recall", "realtime_factor")


@dataclass(frozen=True)
class Worst:
    """A trial to look at: its panel, the series it is worst of, its value there."""

    panel: Panel
    label: str
    trial: int
    seed: int
    value: float


def worst_trials(data: SweepData, choice: Choice) -> list[Worst]:
    """Return the worst trials of each chosen estimator, the worst first. Raises InputError."""
    metrics_of(Layout(metrics=(choice.metric,)))
    if not 0 <= choice.worst <= MOST_WORST:
        raise InputError(f"--worst {choice.worst}: must be 0 to {MOST_WORST}")
    known = {str(name) for panel in data.panels for one in panel.series for name in one.rows["estimator"]}
    for name in choice.estimators:
        if name not in known:
            raise unknown_name("estimator", name, known)
    out: list[Worst] = []
    for name in choice.estimators or _best(data, choice.metric):
        sign = -1.0 if choice.metric in RISING else 1.0
        found = [w for panel in data.panels for one in panel.series for w in _trials(panel, one, name, choice.metric)]
        found.sort(key=lambda worst: (-sign * worst.value, worst.trial))
        out += _distinct(found, choice.worst)
    return out


def failed_trials(folder: Path) -> dict[str, Any]:
    """Return how many rows failed, and the first of them with what was said."""
    keys = ("estimator", "trial", "seed", "error", "traceback")
    with reading(folder) as database:
        count = database.execute("SELECT count(*) FROM rows WHERE status = 'failed'").fetchone()[0]
        query = f"SELECT {', '.join(keys)} FROM rows WHERE status = 'failed' ORDER BY estimator, trial, key LIMIT ?"
        rows = [dict(zip(keys, row, strict=True)) for row in database.execute(query, (MOST_FAILED,))]
    return {"count": count, "rows": rows}


def _best(data: SweepData, metric: str) -> list[str]:
    """Return the estimator with the lowest median; dead reckoning or an oracle only where there is nothing else."""
    values: dict[str, list[float]] = {}
    for panel in data.panels:
        for one in panel.series:
            values.setdefault(one.estimator, []).extend(one.values(metric).tolist())
    medians = {name: float(np.median(v)) for name, v in values.items() if v}
    marked = {*oracles(medians), "dead-reckoning"}
    plain = {name: value for name, value in medians.items() if name not in marked} or medians
    sign = -1.0 if metric in RISING else 1.0
    return sorted(plain, key=lambda name: sign * plain[name])[:1]


def _trials(panel: Panel, one: Series, name: str, metric: str) -> list[Worst]:
    fine = one.rows[(one.rows["status"] == "ok") & (one.rows["estimator"] == name)]
    rows = zip(fine["trial"], fine["seed"], fine[metric].astype(float), strict=True)
    return [Worst(panel, one.label, int(t), int(s), float(v)) for t, s, v in rows if np.isfinite(v)]


def _distinct(found: list[Worst], count: int) -> list[Worst]:
    """Return the first ones, each trial once, where it is worst: variants of a world share most of their draws."""
    kept: dict[tuple[int, int], Worst] = {}
    for one in found:
        kept.setdefault((one.trial, one.seed), one)
    return list(kept.values())[:count]
