"""What a report says: its tables, curves, distributions, worst trials and provenance, as plain data for the page."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Collection, Sequence
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cellslam.benchmarks.figures.style import Drawing, context, estimator_styles
from cellslam.benchmarks.figures.sweep import sweep_data
from cellslam.benchmarks.figures.sweep.critical_difference import draw_ranks
from cellslam.benchmarks.figures.sweep.stanford_diagram import draw_stanford
from cellslam.benchmarks.figures.sweep.sweep_data import Series, SweepData, shown
from cellslam.benchmarks.report.scene import rounded
from cellslam.benchmarks.report.worst_trials import Choice, failed_trials, trial_sections, worlds, worst_trials
from cellslam.benchmarks.scores.metrics import METRIC, METRIC_KEYS
from cellslam.benchmarks.scores.statistics import LEAST_VALUES
from cellslam.benchmarks.sweeps.rows import oracles, provenance
from cellslam.benchmarks.sweeps.store import reading
from cellslam.benchmarks.tables.formats import Column, columns_of
from cellslam.benchmarks.tables.rankings import significant_pairs
from cellslam.benchmarks.tables.summaries import CONFIDENCE, RATIOS, estimate
from cellslam.sim.progress import Progress

MOST_POINTS_OF_CURVES = 400
MOST_PANELS = 24
PLOTTED = {key: metric for key, metric in METRIC.items() if metric.axis}
DASHES = {"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot"}  # matplotlib's and plotly's names
RMSE, EQUAL = "position_rmse_m", 0.01  # differences of one in a hundred are none in a single trial
MORE_DIGITS = 1  # than in tables: figures are looked into
COLUMNS = columns_of("report", (*METRIC_KEYS, *RATIOS))
WITH_INTERVALS = f"Intervals: {100 * CONFIDENCE:g} %, by resampling the trials."
WITHOUT_INTERVALS = f"No confidence intervals: they need {LEAST_VALUES} trials."


def content(folder: Path, choice: Choice, progress: Progress) -> dict[str, Any]:
    """Return everything that the page shows. Raises InputError."""
    data = sweep_data.load(folder)
    chosen = worst_trials(data, choice)
    named = {series.label: series.estimator for series in data.series}
    marked = oracles(folder)
    styles = estimator_styles(data.labels)
    scenarios = sorted({str(scenario) for one in data.series for scenario in one.rows["scenario"]})
    sections, cities = trial_sections(folder, data, chosen, progress)
    single = len(data.panels) == 1 and all(len(one.rows) == 1 for one in data.panels[0].series)
    return {
        "title": f"Report: {', '.join(scenarios)}",
        "series": [
            {"label": label, "oracle": named[label] in marked, "colour": styles[label]["color"],
             "dash": DASHES[styles[label]["linestyle"]]}
            for label in data.labels
        ],
        "summary": _summary(data),
        "ranks": _ranks(data),
        "integrity": _image(lambda figure: draw_stanford(figure, data)),
        "curves": _curves(data),
        "panels": None if single else _distributions(data),
        "single": single,
        "lead": _who_did_best(data.panels[0].series, marked) if single else None,
        "columns": {metric: _heading(metric, known.heading) for metric, known in METRIC.items()},
        "metrics": {key: metric.label for key, metric in PLOTTED.items()},
        "worst": {"metric": choice.metric, "heading": METRIC[choice.metric].label or choice.metric},
        "heading": "Drive" if single else "Worst trials",
        "trials": sections,
        "cities": cities,
        "failed": failed_trials(folder),
        "provenance": _provenance(folder, data),
    }  # fmt: skip


def _who_did_best(series: Sequence[Series], marked: Collection[str]) -> str | None:
    """Return a sentence on who did best in a single trial, and by how much; None where fewer than two have a score."""
    scored = [(float(value), one.label) for one in series if one.estimator not in marked for value in one.values(RMSE)]
    if len(scored) < 2:
        return None
    (least, best), *others = sorted(scored)
    equal = [label for value, label in others if value <= (1.0 + EQUAL) * least]
    behind = [(value, label) for value, label in others if label not in equal]
    *first, last = best, *equal
    who = f"{', '.join(first)} and {last}" if first else last
    text = f"{who} did best: a position RMSE of {least:.2f} m{' each' if equal else ''}"
    if behind:
        text += f", where {behind[0][1]} has {behind[0][0]:.2f} m"
        farther = behind[-1][0] > (1.0 + EQUAL) * behind[0][0]
        text += f" and the worst, {behind[-1][1]}, {behind[-1][0]:.2f} m" if farther else ""
    return f"{text}. One drive says little."


def _summary(data: SweepData) -> dict[str, Any]:
    """Return the table: a line a panel and series, each value with its interval."""
    keys = list(data.series[0].settings)
    lines: list[dict[str, Any]] = []
    for one in data.series:
        cells = [_cell(one, column) for column in COLUMNS]
        counts = {"ok": len(one.ok), "all": len(one.rows)}
        settings = [_setting(one.settings.get(key)) for key in keys]
        lines.append({"settings": settings, "label": one.label, "cells": cells, **counts})
    headings = []
    for column in COLUMNS:
        over = "" if column.metric in RATIOS else f"; {column.statistic} over trials"
        headings.append(_heading(column.metric, column.name) | {"title": METRIC[column.metric].meaning + over})
    empty = [i for i in range(len(COLUMNS)) if all(line["cells"][i] is None for line in lines)]
    for line in lines:
        line["cells"] = [cell for i, cell in enumerate(line["cells"]) if i not in empty]
    there = any(cell is not None and cell[1] is not None for line in lines for cell in line["cells"])
    return {
        "keys": keys, "headings": [h for i, h in enumerate(headings) if i not in empty], "lines": lines,
        "note": WITH_INTERVALS if there else WITHOUT_INTERVALS,
    }  # fmt: skip


def _cell(one: Series, column: Column) -> list[float | None] | None:
    """Return value and ends of the interval; None where no trial has the metric."""
    found = estimate(one.ok, column.metric, column.statistic, CONFIDENCE if column.interval else None)
    digits = METRIC[column.metric].digits + (MORE_DIGITS if column.metric not in RATIOS else 0)
    return None if np.isnan(found[0]) else list(rounded(found, digits))


def _ranks(data: SweepData) -> dict[str, Any] | None:
    """Return the diagram of mean ranks, and how many pairs of each panel differ."""
    judged = sweep_data.verdicts_of(data)
    image = _image(lambda figure: draw_ranks(figure, judged))
    if image is None:
        return None
    pairs = [f"{title}: {significant_pairs(one)}" if title else significant_pairs(one) for title, one in judged.items()]
    return {"image": image, "significant_pairs": pairs}


def _image(drawing: Drawing) -> str | None:
    """Return a figure as an SVG in a data URI; None where it does not apply."""
    with context():
        figure = Figure(layout="constrained")
        if not drawing(figure):
            return None
        drawn = BytesIO()
        figure.savefig(drawn, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{b64encode(drawn.getvalue()).decode()}"


def _curves(data: SweepData) -> list[dict[str, Any]]:
    """Return for each numeric key that varies its lines: the median with its interval, of every metric."""
    out = []
    for key in (key for key, is_number in sweep_data.curve_keys(data).items() if is_number):
        lines, named = [], sweep_data.sweep_lines(data, key)
        styles = estimator_styles(named)
        for name, points in named.items():
            style = {"colour": styles[name]["color"], "dash": DASHES[styles[name]["linestyle"]]}
            line: dict[str, Any] = {"name": name, **style, "metrics": {}}
            for metric, known in PLOTTED.items():
                found = [(x, one.values(metric)) for x, one in points if not isinstance(x, str)]
                found = [(x, values) for x, values in found if len(values)]
                if found:
                    line["metrics"][metric] = _line(found, known.digits + MORE_DIGITS)
            lines.append(line)
        if 0 < sum(len(line["metrics"].get("position_rmse_m", [[]])[0]) for line in lines) <= MOST_POINTS_OF_CURVES:
            out.append({"key": key, "lines": lines})
    return out


def _line(found: Sequence[tuple[float | None, Any]], digits: int) -> list[list[float | None]]:
    """Return x, median, low and high of one line; x None: the same at every x."""
    columns = np.stack([sweep_data.CurveChoice().summed(values) for _, values in found], axis=1)
    return [[x for x, _ in found], *(rounded(column, digits) for column in columns)]


def _distributions(data: SweepData) -> list[dict[str, Any]]:
    """Return every trial's metrics by panel and series, for the distribution plots."""
    out = []
    for panel in data.panels[:MOST_PANELS]:
        series = []
        for one in panel.series:
            columns = {
                metric: rounded(np.asarray(one.ok[metric], np.float64), known.digits + MORE_DIGITS)
                for metric, known in PLOTTED.items()
            }
            kept = {metric: column for metric, column in columns.items() if any(v is not None for v in column)}
            names = [f"trial {trial}, seed {seed}" for trial, seed in one.ok[["trial", "seed"]].itertuples(index=False)]
            series.append({"label": one.label, "all": len(one.rows), "names": names, "values": kept})
        out.append({"title": panel.title or "all trials", "series": series})
    return out


def _provenance(folder: Path, data: SweepData) -> dict[str, Any]:
    seeds, trials = ({int(n) for one in data.series for n in one.rows[key]} for key in ("seed", "trial"))
    resolved = worlds(folder)
    return {
        "runs": provenance(folder), "rows": sum(len(one.rows) for one in data.series), "seeds": sorted(seeds),
        "trials": [min(trials), max(trials)], "worlds": resolved[:MOST_PANELS],
        "more_worlds": len(resolved[MOST_PANELS:]), "options": _options(folder), "cellslam": version("cellslam"),
    }  # fmt: skip


def _options(folder: Path) -> list[dict[str, Any]]:
    """Return the options of each estimator in a store."""
    query = "SELECT DISTINCT estimator, tables FROM rows JOIN options ON id = options ORDER BY estimator, tables"
    with reading(folder) as database:
        return [{"estimator": name, "options": json.loads(t)} for name, t in database.execute(query)]


def _heading(metric: str, text: str) -> dict[str, str]:
    known = METRIC[metric]
    return {"text": text, "unit": known.unit, "title": known.meaning}


def _setting(value: Any) -> Any:
    return value if isinstance(value, int | float) and not isinstance(value, bool) else shown(value)
